// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_refraction.hpp: the points of an eye as a camera sees them through its cornea
/// (rig/cornea.hpp), point by point, and back to the camera and the refractive index. Functions of
/// a point run on the host (backend/each.hpp) and on a device (backend/cuda/each.hpp). The points
/// themselves are not trained.
/// Frame: the eyeball's, canonical units.
#pragma once

#include <rye/avatar/eye_lights.hpp>

namespace rye::detail {

/// Sets point i of an eye as it is seen. Arrays begin at that eye's first point.
template <class T>
struct RefractEyePoint {
    static constexpr const char* name = "eyes, refraction";
    const T* position; ///< as its pupil moves them, 3 x P
    const T* cornea;   ///< that eye's, cornea_numbers
    const T* index;    ///< that eye's
    Vec3<T> camera;
    T* seen; ///< 3 x P

    RYE_HD RefractingCornea<T> refracting() const { return {cornea_in(cornea, 0), *index}; }
    RYE_HD void operator()(Index i) const {
        put_column<3>(seen_through<T>(refracting(), camera, column3(position, i)), seen, i);
    }
};

/// Adds what point i of an eye gives to the cotangents of the camera (3) and of the index.
template <class T>
struct RefractEyePointVjp {
    using Number = T;
    static constexpr const char* name = "eyes, refraction, reverse";
    static constexpr int camera_at = 0, index_at = 3;
    static constexpr int sums = index_at + 1;
    RefractEyePoint<T> point;
    const T* g_seen; ///< 3 x P

    template <class Sums>
    RYE_HD void operator()(Index i, Sums& sum) const {
        SeenThroughGradient<T> g{Vec3<T>(T(0), T(0), T(0)), T(0)};
        seen_through_vjp<T>(point.refracting(), point.camera, column3(point.position, i),
                            column3(g_seen, i), g);
        for (int k = 0; k < 3; ++k) sum[std::size_t(camera_at + k)] += g.camera[k];
        sum[std::size_t(index_at)] += g.index;
    }
};

} // namespace rye::detail
