// SPDX-License-Identifier: Apache-2.0
/// data/config.hpp: the settings of a training run, its presets, and its JSON form.
/// A run's effective configuration is printed, stored with every checkpoint and loaded from it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <rye/avatar/config.hpp>
#include <rye/nn/upsampler.hpp>
#include <rye/rig/gaze.hpp>
#include <rye/train/settings.hpp>

namespace rye::trainer {

struct GridConfig {
    double half_side = 1.75;  ///< of the cube around the head, canonical units
    double cell = 3.5 / 52;   ///< edge of a lattice cell, canonical units
    bool subdivide = true;    ///< once more for stage 2, as GHA does
};

/// The items of an epoch: the training frames, each by cameras drawn at random, or all their
/// pictures.
enum class EpochsOver { frames, pictures };

struct MeshTrainConfig {
    int steps = 0; ///< 0: `epochs` over frames, or over pictures, of which a step has `views`
    int epochs = 50;
    EpochsOver epochs_over = EpochsOver::frames; ///< GHA's; the paper says nothing of stage 1
    int views = 4;            ///< cameras per step
    int image_size = 256;     ///< width of the rasterised image [px]
    int pretrain_steps = 300; ///< of the sphere
    double rate_decay = 1;    ///< final learning rates, relative to the first
    bool landmarks_follow_gaze = false;  ///< L_def also deforms by the gaze fields
    int fit_steps = 0;  ///< steps of fit_deformation, after the last step
    double fit_rate = 2e-3;  ///< first learning rate of fit_deformation
    double fit_mixed = 0;    ///< share of fit_deformation's frames that are mixed_frame
    double fit_lids = 1;     ///< weight of landmarks at the lids in fit_deformation, of others 1
    bool fit_regions = false; ///< true: mixed frames respect the regions of named coefficients
    bool fit_shapes = false;  ///< true: ... and the shapes of the capture's face model, if any
    MeshLossConfig weights;
    MeshRates rates;
};

struct EyeballConfig {
    int points = 1500;          ///< target number of Gaussians per eyeball
    double radius = 0.12;       ///< of the sclera unless given by the capture, canonical units
    double opacity = 0.9;       ///< initial
    double thickness = 1;       ///< along the normal, times the width
    double max_growth = 0;      ///< of scales, times the template's spacing; 0: no bound
    bool bulge = true;          ///< false: the iris lies on a plane behind the cornea
};

struct AvatarTrainConfig {
    int steps = 0; ///< 0: `epochs` over frames or pictures, `views` of them a step
    int epochs = 500;
    /// Pictures of a step, over which losses and gradients are averaged; ranks share them. Learning
    /// rates are multiplied by its root.
    int views = 1;
    EpochsOver epochs_over = EpochsOver::pictures;
    int mouth_points = 3000;
    /// Edges of the neutral surface longer than spacing + spacing_slope * (distance to the nearest
    /// eye or lip landmark) are halved, canonical units; spacing 0: none.
    double spacing = 0, spacing_slope = 0.1;
    /// Spacing of Gaussians on the lids' margins and at the corners by the nose, canonical units;
    /// 0: none.
    double lid_margin = 0;
    double opacity = 0.3;       ///< initial
    /// Initial thickness of the face's Gaussians along the normal, times their width; 1: round.
    double thickness = 1;
    double rate_decay = 1;
    bool augment = true;        ///< true: random scale before super-resolution
    int checkpoint_every = 1000;
    int panel_every = 1000;
    EyeballConfig eyeball;
    AvatarLossConfig weights;
    AvatarRates rates;
    /// True if the mean over frames is subtracted from the corrections of head poses after each
    /// step, so that they do not move the head's frame.
    bool centre_corrections = false;
    int lid_steps = 0;          ///< of fit_lids, when stage 2 ends
    DensityConfig density;      ///< off in every preset
    UpsamplerShape upsampler;   ///< in_channels follows from the avatar
    /// True if choose_doublings is to set upsampler.doublings; JSON: "auto".
    bool auto_doublings = true;
    /// bf16 planes per float in the networks' products on a device: 1 for 8 bits of each factor, 3
    /// for 24. The CPU computes in floats.
    int planes = 1;
};

/// Axis of an eye that the gazes of a run refer to. With visual axes stage 2 trains an avatar with
/// the effect Kappa, which learns their difference to the optical ones from 0.
using rye::GazeAxis;

/// Dependence of an eye on its gaze: the paper's rotation of the eyeball, and mechanisms to compare
/// it with (rye/rig/gaze_mechanisms.hpp, rye/rig/gaze_features.hpp). With `none` the eyeballs do
/// not follow the gaze; the surrounding skin always does.
enum class GazeMechanismName {
    rotation,           ///< ExplicitRotation
    feature_rotation,   ///< RotatedFeatures
    condition,          ///< ConditionedFeatures
    latent_rotation,    ///< RotatedCode
    learned_quaternion, ///< LearnedQuaternion
    none                ///< FixedEye
};

/// Features of the eyes' Gaussians: trained constants, or driven by gaze, head rotation and
/// expression (rye/rig/driven_features.hpp), which the paper calls a dynamic generator.
enum class EyeAppearanceName { free, driven };
/// Effect of light on the head: none, or colours that depend on the head's rotation under fixed
/// lights (rye/avatar/head_shading.hpp). Not in the paper; `cpu` and `gpu` have it.
enum class ShadingName { none, head_pose };

/// Returns the words of a configuration for the names.
const std::string& word_of(GazeMechanismName mechanism);
const std::string& word_of(EyeAppearanceName appearance);
const std::string& word_of(ShadingName shading);

/// Settings of a training. Every default is the paper's, or GHA's where the paper gives none.
struct TrainConfig {
    std::string preset;
    std::uint64_t seed = 1;
    GazeAxis gaze_axis = GazeAxis::optical;
    bool measured_eyes = true;  ///< eyeball centres and radii from gaze.npz if it has them, else
                                ///< from the landmarks around the eyes, as in the paper
    bool correct_labels = false; ///< for training frames (corrections/labels.hpp)
    bool correct_colours = false; ///< for cameras (corrections/camera_colours.hpp)
    bool correct_cameras = false; ///< for poses and focal lengths (corrections/cameras.hpp)
    AvatarConfig avatar;
    GazeMechanismName gaze_mechanism = GazeMechanismName::rotation; ///< JSON: avatar.gaze_mechanism
    EyeAppearanceName eye_appearance = EyeAppearanceName::driven;   ///< JSON: avatar.eye_appearance
    ShadingName shading = ShadingName::none;                     ///< JSON: avatar.shading
    bool highlights = false; ///< lights found in the photographs (corrections/lights.hpp); JSON:
                             ///< avatar.highlights
    bool lid_shadow = false; ///< shadows of the upper lids on the eyeballs; JSON: avatar.lid_shadow
    bool refraction = false; ///< irises lie behind corneas, whatever eyeball.bulge says, which
                             ///< refract; JSON: avatar.refraction
    int view_color = 0; ///< degree of the colours by the view (rye/avatar/view_color.hpp), 0: off;
                        ///< JSON: avatar.view_color
    GridConfig grid;
    MeshTrainConfig mesh;
    AvatarTrainConfig gaussians;
};

/// Returns the names of the presets.
const std::vector<std::string>& preset_names();

/// Returns the preset of a name; throws an Error for one that is not in preset_names(). A
/// configuration that was written before a field existed has the field of "paper-literal".
TrainConfig preset(const std::string& name);

/// Longer side [px] that choose_doublings leaves of a render, at least.
inline constexpr int least_render_side = 512;

/// Sets gaussians.upsampler.doublings, if "auto", for photographs of this size [px]: as many, up to
/// 4, as leave renders with a longer side of least_render_side or more.
void choose_doublings(TrainConfig& config, int width, int height);

nlohmann::ordered_json to_json(const TrainConfig& config);

/// Overwrites the fields that `json` names; throws an Error with source and field for unknown
/// fields, wrong types and values out of range.
void from_json(const nlohmann::ordered_json& json, const std::string& source, TrainConfig& config);

} // namespace rye::trainer
