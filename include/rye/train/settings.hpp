// SPDX-License-Identifier: Apache-2.0
/// rye/train/settings.hpp: weights of the losses and learning rates of both stages, and settings of
/// density control. Every default is the paper's (sections 4.1, 4.2) or, if the paper gives none,
/// GHA's; see docs/deviations.md.
#pragma once

#include <string>

namespace rye {

/// Unit of the lengths in the Laplacian term of stage 1, on which its weight depends. Metre: a unit
/// of the head frame counts as a decimetre, whatever the world's unit is. GHA takes the world as it
/// is, with its data in metres; rye's captures are in decimetres.
enum class LaplacianUnit { metre, world };

/// Weights of stage 1, eq. (12).
struct MeshLossConfig {
    double rgb = 0.1;
    double silhouette = 0.1;
    double deform = 1.0;
    double offset = 0.01;
    double landmark = 0.1;
    double laplacian = 100;
    LaplacianUnit laplacian_unit = LaplacianUnit::metre;
    double eye_offset = 0.1;
};

/// Learning rates of the first stage, by parameter name.
struct MeshRates {
    double networks = 1e-3;
    double landmarks = 1e-4;

    double operator()(const std::string& name) const {
        return name == "landmarks_3d_neutral" ? landmarks : networks;
    }
};

/// Weights of the terms of the second stage's objective.
struct AvatarLossConfig {
    double high_resolution = 1.0;
    double low_resolution = 1.0;   ///< lambda_lr of the image loss
    double perceptual = 0.1;       ///< lambda_vgg
    double dssim = 0;              ///< 1 - SSIM of the final image; not in the paper
    double eye_low = 0.5;          ///< lambda_lr of the eyeball loss
    double eye_high = 0.5;         ///< lambda_hr of the eyeball loss
    double blank = 1.0;            ///< lambda_blank
    /// The face alone must show the picture outside the eyes (over the blank's background), so that
    /// eyeballs do not learn to paint skin. Not in the paper; see docs/deviations.md.
    double face_alone = 0.0;
    /// Weight of the smoothness of colours on an eyeball (loss/smoothness.hpp). Not in the paper.
    double eye_smooth = 0;
    /// Weights of the smoothness of the face's features over neighbours on its initial surface, and
    /// of their likeness on both sides of the head (train/face_smoothness.hpp); 0: off. For parts
    /// that no picture shows. Not in the paper; see docs/deviations.md.
    double face_smooth = 0, face_mirror = 0;
    /// Steps per high-resolution eye term, which costs a second super-resolution and counts this
    /// many times.
    int eye_high_every = 1;
};

/// Learning rates of stage 2.
struct AvatarRates {
    double upsampler = 1e-4, networks = 1e-4, opacity = 1e-4, scale = 3e-5;
    double position = 1e-5, feature = 1e-5, rotation = 1e-5, delta_pose = 1e-5;
    double eye_feature = 1e-4;  ///< free colours or latents of the eyeballs; GHA has none
    double eye_offset = 1e-4;   ///< 0 keeps the eyeball centres learned in stage 1
    double kappa = 1e-4;        ///< for avatars with Kappa; 0 keeps the angles [rad]
    double delta_gaze = 0;      ///< of each frame's gaze angles, if an avatar has them [rad]
    double delta_view = 0;      ///< of each camera's pose, if an avatar has them
    int delta_view_from = 0;    ///< steps before those move: the head is found first [steps]
    double shading = 1e-3;      ///< for avatars with HeadShading: light and normals
    double view_color = 5e-7;   ///< for avatars with ViewColor: a 20th of `feature`
    double light_intensity = 1e-3; ///< of highlights, for avatars with lights
    double light_position = 0;  ///< of the lights, in world units; 0 keeps them where they are
    double lid_shadow = 3e-2;   ///< of the lids' shadows, for avatars with them
    double refractive_index = 0; ///< of each cornea, for avatars that refract; 0 keeps it
    double deform = 1e-4;       ///< displacement networks of the face

    /// Returns the number of the optimiser's steps in which a parameter rests at first.
    std::int64_t first_step(const std::string& name) const {
        return name == "delta_views" ? delta_view_from : 0;
    }
    /// Returns the rate of a parameter, by its name in fields(). What no name here fits, such as a
    /// parameter of a part of one's own, has `networks`.
    double operator()(const std::string& name) const {
        if (name.starts_with("upsampler.")) return upsampler;
        if (name == "delta_poses") return delta_pose;
        if (name == "delta_gazes") return delta_gaze;
        if (name == "delta_views") return delta_view;
        if (name == "eyes.feature" || name == "eyes.latent") return eye_feature;
        if (name.starts_with("eyes.eye_offset_mlp.")) return eye_offset;
        if (name == "eyes.kappa") return kappa;
        if (name.starts_with("shading.")) return shading;
        if (name.starts_with("view_color.")) return view_color;
        if (name == "eyes.light_intensity") return light_intensity;
        if (name == "eyes.light_position") return light_position;
        if (name == "eyes.lid_shadow") return lid_shadow;
        if (name == "eyes.refractive_index") return refractive_index;
        if (name.find("_deform") != std::string::npos) return deform;
        const std::string last = name.substr(name.rfind('.') + 1);
        if (last == "xyz") return position;
        if (last == "feature") return feature;
        if (last == "scales") return scale;
        if (last == "rotation") return rotation;
        if (last == "opacity") return opacity;
        return networks;
    }
};

/// Splitting and pruning of the face's Gaussians during stage 2 (train/density.hpp): after those
/// steps from `first` to `last` that `every` divides. Not in the paper; see docs/deviations.md.
struct DensityConfig {
    int every = 0;                 ///< steps between two changes; 0 for none
    int first = 500, last = 1'000'000; ///< [steps]
    double grow = 0.05;            ///< largest share of the face's Gaussians that split at once
    int most = 100'000;            ///< largest number of the face's Gaussians after splits
    double prune = 0.005;          ///< opacity at rest below which one is removed; 0 for none
    /// Factor of the criterion at an eye or lip landmark, and the distance at which it has fallen
    /// to 1 [canonical unit].
    double prefer = 3, reach = 0.3;
};

} // namespace rye
