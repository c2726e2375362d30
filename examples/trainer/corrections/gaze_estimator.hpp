// SPDX-License-Identifier: Apache-2.0
/// corrections/gaze_estimator.hpp: estimate of an eye's direction from its picture, without learned
/// weights: the iris is found as a disc on the eyeball, and the gaze is the ray from the eyeball's
/// centre to the middle of that disc.
///
/// The rim of the iris is a circle around the gaze, so it lies on a sphere around the eyeball's
/// centre, whose radius is the distance of the rim and not that of the sclera. Each pixel of the
/// visible eye is projected along its camera ray to that sphere, which gives a direction from the
/// centre. A gaze g splits these directions by their angle from g into iris and sclera; the pupil
/// is a smaller disc in the plane of the rim. The estimate is the g for which three such levels of
/// brightness and of two tints, and a light that varies linearly across the eye, are likeliest,
/// with the iris darker than the sclera or of another colour. Errors of brightness and of each tint are
/// normal, of sizes that are not known, so that each counts as far as it tells iris from sclera.
/// This fits a disc of known size, seen in perspective, to all pixels at once, so it is accurate to
/// a fraction of a pixel and does not need the whole iris. No gaze is preferred.
///
/// Pixels at the rim of an exact area of the eye, except its lower rim, are ignored: lashes and the
/// shadow of the upper lid darken them as an iris would. If the area is not exact, such as that of
/// a run's own eyeballs on a photograph, pixels beside it may be eye and pixels in it may be skin,
/// lid or lashes. The estimate is then the g of the most likely mixture, in which each pixel is
/// either eye, with the disc's brightness, or something else, with a probability by its likeness to
/// the surrounding skin, and uneven light is unlikely, which would explain lids and lashes as well
/// as the iris does. If that finds no iris, or one that explains much less, the estimate is the g
/// of the first kind, with pixels weighted by how much less they look like that skin than like
/// anything else. Frame: world. Units: world units, [rad].
#pragma once

#include <optional>

#include <rye/core/columns.hpp>
#include <rye/geometry/camera.hpp>

namespace rye::trainer {

/// Known geometry of one eyeball.
struct EyeballGeometry {
    Vec3<double> centre;        ///< world
    double radius;              ///< sclera
    double limbus_radius;       ///< rim of the iris
    Mat3<double> head_rotation; ///< world from head: the search is around the head's +z
    /// Distance of the rim's plane from the centre; 0: the plane where the sclera is as wide as the
    /// rim.
    double iris_plane = 0;
};

struct GazeEstimate {
    Vec3<double> gaze; ///< unit, head frame
    double contrast;   ///< share of the weighted variance that the disc explains, at most 1
    int pixels;        ///< number of usable pixels of the eye
};

/// Smallest number of usable pixels of an exact area that determine a direction.
inline constexpr int min_eye_pixels = 40;
/// Contrast that is always sufficient: the iris varies most in the area that is searched.
inline constexpr double min_contrast = 0.3;
/// Required darkening of iris and pupil, relative to the sclera's brightness: noise, shadow or an
/// edge of skin cause less.
inline constexpr double min_darkening = 0.2;
/// Tint, towards blue or green, of an iris that is not as dark.
inline constexpr double min_tint = 0.2;
/// Largest error of the rim of a run's own eyes [radii of the eyeball].
inline constexpr double own_area_error = 0.3;

/// Returns the smallest contrast of an iris among so many pixels: noise explains a smaller share of
/// more pixels. min_contrast for 23 pixels or fewer.
double least_contrast(double pixels);

/// Returns the number of pixels that the estimate uses: those of the visible eye whose left, right
/// and upper neighbours are inside, too. `eye`: 1 x pixels of an image of this width.
int usable_eye_pixels(const Columns<float>& eye, int width);

/// Returns the estimate; nothing if too little of the eye is seen or no dark disc is found.
/// `image`: RGB in [0, 1]; `eye`: 1 x pixels, 0.5 or more where this eyeball is visible, with a rim
/// that is off by up to `area_error` radii of the eyeball (0: exact).
std::optional<GazeEstimate> estimate_gaze(const Image<float>& image, const Columns<float>& eye,
                                          const Pinhole<double>& camera,
                                          const EyeballGeometry& eyeball, double area_error = 0);

} // namespace rye::trainer
