// SPDX-License-Identifier: Apache-2.0
/// drawing/shown.hpp: pictures, eyes and Gaussians of a run's avatar, driven and drawn on the host.
#pragma once

#include <array>

#include <rye/geometry/camera.hpp>

#include "model/run.hpp"

namespace rye::trainer {

/// Radii of the left and the right pupil over those at rest (rye/rig/pupil.hpp).
using PupilRatios = std::array<float, 2>;

/// Picture to be drawn: its drivers, whose gazes are of the run's gaze_axis, the camera of the
/// full-size image, and the dilation of its render [px^2].
struct DrawnFrame {
    Drivers<float> drivers;
    Pinhole<float> camera;
    double dilation = trained_dilation;
    PupilRatios pupil{1, 1};
};

/// Returns all drivers of a frame, with the camera that sees it.
Drivers<float, TrainEffects> all_drivers(const DrawnFrame& frame, const Pinhole<float>& camera);

/// Pictures of an avatar: the feature renders, and the image after super-resolution on white.
struct AvatarView {
    Image<float> final, face, eyes; ///< the last two if streams were asked for
    Image<float> high;              ///< RGB
};

/// Returns the pictures. Here and below the state is a drawn one (model/run.hpp).
AvatarView render_avatar(const TrainState& state, const DrawnFrame& frame, bool streams = false);

/// Returns the RGB image of driven Gaussians after super-resolution, on white, as render_avatar's.
Image<float> picture_of(const TrainState& state, const Gaussians<float>& driven,
                        const Pinhole<float>& camera, double dilation);

/// Eyeballs as an avatar's own rig places and shows them.
struct PosedEyes {
    std::array<Vec3<double>, 2> centre; ///< world
    /// Share of eyeball e's Gaussians in the pixel's colour, with the face in front of them, as
    /// channel e; of the camera's size.
    Image<float> area;
};
PosedEyes posed_eyes(const TrainState& state, const DrawnFrame& frame);
/// Returns the centres alone, world units.
std::array<Vec3<double>, 2> posed_centres(const TrainState& state, const Drivers<float>& drivers);

/// Picture as render_avatar's and eyes as posed_eyes', of an avatar driven once.
struct ShownAvatar {
    Image<float> picture;
    PosedEyes eyes;
};
ShownAvatar shown_avatar(const TrainState& state, const DrawnFrame& frame);

/// Returns a picture of whole blocks of super-resolution, cropped to the camera's size.
Image<float> of_camera(Image<float> picture, const Pinhole<float>& camera);

/// Returns the driven Gaussians of both streams in the world, the face's first.
Gaussians<float> driven_gaussians(const TrainState& state,
                                  const Drivers<float, TrainEffects>& drivers);
/// The same without highlights, refraction and colours by the view, which no camera sees.
Gaussians<float> driven_gaussians(const TrainState& state, const Drivers<float>& drivers);

/// Returns the RGB of a feature render (its first three channels).
Image<float> rgb_of(const Image<float>& feature);

/// Returns SSIM over an area (1 x pixels).
double masked_ssim(const Image<float>& a, const Image<float>& b, const Columns<float>& area);

} // namespace rye::trainer
