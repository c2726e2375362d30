// SPDX-License-Identifier: Apache-2.0
/// rye/train/samples.hpp: inputs of one step of each stage. Images are sRGB in [0, 1].
#pragma once

#include <vector>

#include <rye/avatar/drivers.hpp>
#include <rye/avatar/head_pose.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/train/augment.hpp>

namespace rye {

/// Photograph of the first stage, with its masks and camera.
template <class T>
struct MeshView {
    Pinhole<real_t<T>> camera;
    Image<T> truth;      ///< RGB over black
    Columns<T> mask;     ///< 1 x pixels, the subject
    Columns<T> visible;  ///< 1 x pixels, 0 for padding
};

/// One frame and some of its views.
template <class T, EffectSet E = PaperEffects>
struct MeshSample {
    [[no_unique_address]] Drivers<T, E> drivers;
    Columns<T> landmarks;         ///< of this frame, canonical, 3 x L
    Columns<T> eye_displacement;  ///< of the eyeball centres since neutral, canonical, 3 x 2
    std::vector<MeshView<T>> views;
};

/// Pictures of one frame from one camera, and their masks. "Small" is the size of the feature
/// render.
template <class T>
struct AvatarImages {
    Index frame = 0;              ///< column of delta_pose; -1 for none
    SeenBy<T> view;               ///< column of delta_view, if an avatar has it
    Pinhole<T> camera;            ///< of the small image
    Image<T> truth, truth_small;  ///< RGB on the final background
    Columns<T> visible, visible_small;  ///< 1 x pixels, 0 for padding
    Columns<T> eyes, eyes_small;        ///< 1 x pixels, M_e of both eyes
    Columns<T> mask_small;              ///< 1 x pixels, the subject
    bool eyes_high = true;              ///< true if this step takes the high-resolution eye term
    Augmentation scale;           ///< random scale of the final image's super-resolution
    VecX<T> background;           ///< of the final render and the eyes alone, one per channel
    VecX<T> blank;                ///< background c of the face alone
};

/// Returns the camera that shows a head as `camera` shows it after the motion of a column of
/// delta_view about a pivot.
template <class T>
Pinhole<T> seen_camera(Pinhole<T> camera, const Vec<T, 6>& motion, const Vec3<T>& pivot) {
    const Mat3<T> turn = so3_exp(Vec3<T>(motion.template head<3>()));
    Rigid<T>& pose = camera.camera_from_world;
    pose.translation += pose.rotation * (pivot - turn * pivot + motion.template tail<3>());
    pose.rotation = pose.rotation * turn;
    return camera;
}

namespace detail {

/// Returns the images of a picture of the size of the render, all of whose pixels count, also for
/// the eyes.
template <class T>
AvatarImages<T> whole_picture(const Image<T>& truth, const Pinhole<T>& camera,
                              const VecX<T>& background) {
    AvatarImages<T> s;
    s.frame = -1;
    s.camera = camera;
    s.truth = s.truth_small = truth;
    s.visible = s.visible_small = s.eyes = s.eyes_small = s.mask_small =
        Columns<T>::Ones(1, truth.size());
    s.background = s.blank = background;
    return s;
}

} // namespace detail

/// One frame seen from one camera.
template <class T, EffectSet E = PaperEffects>
struct AvatarSample : AvatarImages<T> {
    [[no_unique_address]] Drivers<T, E> drivers; ///< as tracked; the frame's delta pose is added
};

} // namespace rye
