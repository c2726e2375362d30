// SPDX-License-Identifier: Apache-2.0
/// training/gaze_estimator.hpp: the direction of an eye from its picture, without learned
/// weights: the iris is found as a disc on the eyeball, and the gaze is the ray from the eyeball's
/// centre to the middle of that disc.
///
/// Each pixel of the visible eye is sent along its camera ray to the eyeball's sphere, which gives a
/// direction from the centre. A gaze g splits these directions by their angle from g into pupil,
/// iris and sclera; the estimate is the g whose split leaves the least variance of brightness, with
/// the iris darker than the sclera. That is a fit of a dark disc of known size, seen in perspective,
/// to all pixels at once, so it is good to a fraction of a pixel and needs no whole iris. Pixels at
/// the rim of the visible eye, but for its lower rim, are left out: lashes and the shadow of the
/// upper lid darken them as an iris would.
/// Frame: world. Units: world units, [rad].
#pragma once

#include <optional>

#include <rye/core/columns.hpp>
#include <rye/geometry/camera.hpp>

namespace rye::trainer {

/// The known geometry of one eyeball.
struct EyeballGeometry {
    Vec3<double> centre;        ///< world
    double radius;              ///< sclera
    double limbus_radius;       ///< rim of the iris
    Mat3<double> head_rotation; ///< world from head: the search is around the head's +z
};

struct GazeEstimate {
    Vec3<double> gaze;  ///< unit, head frame
    double contrast;    ///< share of the brightness' variance that the disc explains, 0 to 1
    int pixels;         ///< usable ones of the eye
};

/// Fewer usable pixels than this do not determine a direction.
inline constexpr int min_eye_pixels = 40;
/// Below this contrast no iris was found: a part of the lids may lie in the area that is searched,
/// but the iris must be what varies most in it.
inline constexpr double min_contrast = 0.3;
/// By how much of the sclera's brightness iris and pupil must be darker: what noise, shadow or an
/// edge of skin leave below that is no iris.
inline constexpr double min_darkening = 0.2;

/// How many pixels of the visible eye the estimate rests on: those of which no neighbour on the left,
/// on the right or above is outside. `eye`: 1 x pixels of an image of this width.
int usable_eye_pixels(const Columns<float>& eye, int width);

/// `image`: RGB in [0, 1]; `eye`: 1 x pixels, 1 where this eyeball is visible. Nothing where too
/// little of the eye is seen or no dark disc is found.
std::optional<GazeEstimate> estimate_gaze(const Image<float>& image, const Columns<float>& eye,
                                          const Pinhole<double>& camera,
                                          const EyeballGeometry& eyeball);

} // namespace rye::trainer
