// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/corneal_ray.hpp: a camera's ray through the cornea of a rendered eyeball, to
/// the plane of its iris. Frame: the eyeball's, looking along +z.
#pragma once

#include <algorithm>
#include <cmath>

#include "synthetic_capture/head_model.hpp"

namespace rye::trainer {

/// Returns how far the centre of the corneal sphere is in front of the eyeball's.
inline double cornea_ahead(const Eyeball& eye) {
    return eye.iris_plane() -
           std::sqrt(eye.cornea_radius * eye.cornea_radius - eye.limbus_radius * eye.limbus_radius);
}

/// Returns the point of the iris' disc that a ray from outside sees, bent by Snell's law where it
/// enters the corneal sphere. at: where it meets the eyeball's mesh, in front of the iris' plane;
/// d: its unit direction; index: of what is behind the cornea, over that of air, at least 1, so
/// that no ray is reflected totally on its way in. A ray that grazes the sphere, or passes it
/// between mesh and sphere, enters along the tangent plane. One that would leave the cornea again
/// before it meets the plane sees the limbus there.
inline Vec3<double> seen_on_iris(const Eyeball& eye, const Vec3<double>& at, const Vec3<double>& d,
                                 double index) {
    using V3 = Vec3<double>;
    const V3 centre(0, 0, cornea_ahead(eye)), from = at - centre;
    const V3 off = from - from.dot(d) * d;
    const double inside = eye.cornea_radius * eye.cornea_radius - off.squaredNorm();
    const V3 out = inside > 0 ? V3(off - std::sqrt(inside) * d) : off;
    const V3 n = out.normalized(), enters = centre + eye.cornea_radius * n;
    const double facing = std::clamp(-d.dot(n), 0.0, 1.0);
    const double bent = std::sqrt(1 - (1 - facing * facing) / (index * index));
    const V3 t = (d + facing * n) / index - bent * n;
    const double plane = eye.iris_plane();
    V3 seen = t; // straight aside, or away from the plane
    if (t.z() < 0) seen = enters + t * (std::min(plane - enters.z(), 0.0) / t.z());
    const double r = seen.head<2>().norm();
    seen.z() = plane;
    if (t.z() < 0 && r <= eye.limbus_radius) return seen;
    seen.head<2>() *= r > 0 ? eye.limbus_radius / r : 0;
    return seen;
}

} // namespace rye::trainer
