// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/check_camera.hpp: the check of a camera that comes from outside.
#pragma once

#include <cmath>
#include <string>

#include <rye/geometry/camera.hpp>
#include <rye/math/linalg.hpp>

namespace rye {

namespace detail {

/// Largest side of a picture that is accepted from outside [px].
inline constexpr int most_picture_side = 16384;

} // namespace detail

/// Throws Error("who: ...") unless the camera is one that can draw: focal lengths and near depth
/// positive, sides of 1 to 16384 pixels, all numbers finite, and a rotation (orthonormal to 1e-3,
/// right-handed).
template <Real T>
void check_camera(const std::string& who, const Pinhole<T>& c) {
    const auto positive = [&](const char* name, T x) {
        if (!(std::isfinite(x) && x > T(0)))
            throw Error(who + ": camera: '" + name + "' is " + number_text(x) +
                        ", expected a positive number");
    };
    positive("fx", c.fx);
    positive("fy", c.fy);
    positive("near_depth", c.near_depth);
    require(std::isfinite(c.cx) && std::isfinite(c.cy), who,
            "camera: the principal point is not finite");
    if (c.width < 1 || c.height < 1 || c.width > detail::most_picture_side ||
        c.height > detail::most_picture_side)
        throw Error(who + ": camera: the picture has " + std::to_string(c.width) + " x " +
                    std::to_string(c.height) + " pixels, expected sides of 1 to " +
                    std::to_string(detail::most_picture_side));
    const auto& t = c.camera_from_world.translation;
    require(std::isfinite(t[0]) && std::isfinite(t[1]) && std::isfinite(t[2]), who,
            "camera: 'translation' is not finite");
    const Mat3<T>& r = c.camera_from_world.rotation;
    const T apart = (r.transpose() * r - Mat3<T>::Identity()).cwiseAbs().maxCoeff();
    const T volume = r.col(0).dot(cross(Vec3<T>(r.col(1)), Vec3<T>(r.col(2))));
    if (!(apart <= T(1e-3) && volume > T(0)))
        throw Error(who + ": camera: 'rotation' is no rotation: R^T R differs from 1 by " +
                    number_text(apart) + ", its determinant is " + number_text(volume));
}

} // namespace rye
