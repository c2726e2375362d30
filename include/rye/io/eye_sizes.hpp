// SPDX-License-Identifier: Apache-2.0
/// rye/io/eye_sizes.hpp: the sizes of an eyeball from a capture, and the shape that training
/// gives it. Lengths in canonical units.
#pragma once

#include <cmath>
#include <string>

#include <rye/io/capture.hpp>
#include <rye/core/error.hpp>
#include <rye/rig/eyeball.hpp>

namespace rye {

/// An eyeball's measures in the head frame [canonical units].
struct EyeSizes {
    double radius, limbus_radius, iris_plane;  ///< iris_plane: z of the iris' middle
};

/// Returns sizes with textbook proportions for missing values; `scale` is the frame's, head to
/// world.
inline EyeSizes eye_sizes(const CaptureEye& eye, double scale, double default_radius) {
    EyeSizes s;
    s.radius = eye.radius ? *eye.radius / scale : default_radius;
    s.limbus_radius = eye.limbus_radius ? *eye.limbus_radius / scale : 0.49 * s.radius;
    s.iris_plane = eye.iris_plane ? *eye.iris_plane / scale : 0.87 * s.radius;
    return s;
}

/// Surface of an eyeball that the iris lies on: one behind the cornea, where a measured iris is, or
/// the cornea itself, the paper's bulge (rye/rig/eyeball.hpp).
enum class IrisSurface { plane, bulge };

/// Returns rye's eyeball of these sizes for an avatar with the effects E.
template <EffectSet E = PaperEffects>
BasicEyeballShape<E> eyeball_shape(const EyeSizes& sizes, IrisSurface iris = IrisSurface::plane) {
    BasicEyeballShape<E> shape =
        BasicEyeballShape<E>{}.with_radius(sizes.radius).with_limbus(sizes.limbus_radius);
    if (iris == IrisSurface::plane) shape.iris_plane = sizes.iris_plane;
    return shape;
}

/// Throws an Error, with `who` first, if these sizes make no eyeball.
inline void require_eyeball(const EyeSizes& sizes, const std::string& who) {
    try {
        for (const double x : {sizes.radius, sizes.limbus_radius, sizes.iris_plane})
            require(
                std::isfinite(x) && x > 1e-6 && x < 1e6, "sizes", "got ",
                [&] { return std::to_string(x); }, ", expected a length above 1e-6 and below 1e6");
        EyeballShape shape = eyeball_shape(sizes);
        shape.iris_rings = 2;
        shape.sclera_rings = shape.back_rings = 1;
        eyeball_template<double>(shape);
    } catch (const Error& e) {
        throw Error(who + ": eye_radius " + std::to_string(sizes.radius) + ", limbus_radius " +
                    std::to_string(sizes.limbus_radius) + " and iris_plane " +
                    std::to_string(sizes.iris_plane) + " make no eyeball (in canonical units): " +
                    e.what());
    }
}

} // namespace rye
