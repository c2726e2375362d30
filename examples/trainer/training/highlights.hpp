// SPDX-License-Identifier: Apache-2.0
/// training/highlights.hpp: the highlights of lights on the corneas in a picture: small spots that
/// are brighter, in every channel, than the iris and the pupil around them.
#pragma once

#include <optional>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/rig/cornea.hpp>
#include <rye/rig/eye_transform.hpp>

namespace rye::trainer {

/// A highlight in a picture.
struct Highlight {
    Vec2<double> at;      ///< its middle [px], a pixel's centre at .5
    Vec3<double> amount;  ///< colour above the surroundings, summed over its pixels
    double spread;        ///< its standard deviation along an axis [px]
    int pixels;
    bool whole;           ///< false if it reaches a lid or the rim of the iris
};

/// A cornea before a camera.
struct CorneaInPicture {
    Pinhole<double> camera;
    EyeTransform<double> eye; ///< to the world
    Cornea<double> cornea;    ///< in the eyeball's frame
    double limbus_radius;     ///< of the iris, eyeball's frame

    /// Returns where the camera's ray through a point of the picture meets the cornea, in the
    /// eyeball's frame; none where it misses the part over the iris.
    std::optional<Vec3<double>> under(const Vec2<double>& at) const;
    /// Returns the point of the picture that shows a point of the eyeball's frame.
    Vec2<double> shown(const Vec3<double>& at) const;
};

/// Returns the highlights of an eye in a picture, brightest first. `area`, 1 x pixels: above 0
/// where the picture shows that eye. Empty where the iris is too small or hidden.
std::vector<Highlight> find_highlights(const Image<float>& picture, const Columns<float>& area,
                                       const CorneaInPicture& of);

/// Returns true if a point of the picture, and the pixels beside it, show the eye over its iris.
bool shows_cornea(const Columns<float>& area, const CorneaInPicture& of, const Vec2<double>& at);

} // namespace rye::trainer
