// SPDX-License-Identifier: Apache-2.0
/// rye/splat/ray_peak.hpp: the depth at which a Gaussian is densest along the ray of a pixel, for
/// policies that blend by it. With m the mean in the camera's frame, d the ray (z = 1), axes r_i of
/// standard deviations s_i, the whitened distance |S^-1 R' (t d - m)| is least at
///     t = sum_i (b_i m) (b_i d) / sum_i (b_i d)^2,    b_i = (min s / s_i) r_i',
/// which stays finite where s_i is 0: flat Gaussians peak where the ray meets their plane.
/// Camera frame: z forward; t is a depth [world units]. It orders; no derivative goes through it.
/// Source: Radl et al., "StopThePop", 2024.
#pragma once

#include <type_traits>

#include <rye/gaussian/project.hpp>
#include <rye/gaussian/view.hpp>

namespace rye::detail {

/// A Gaussian's densest point along rays, by the formula above.
template <Real R>
struct RayPeak {
    Mat3<R> axes;            ///< rows b_i, of which columns 0 and 1 are per pixel
    Vec3<R> along;           ///< b_i m [world units]
    R depth;                 ///< depth of the centre, for rays in the plane of a flat Gaussian

    /// Returns the peak's depth at a pixel, given from the principal point [px].
    RYE_HD R at(R px, R py) const {
        R sum(0), square(0);
        for (int i = 0; i < 3; ++i) {
            const R step = axes(i, 0) * px + axes(i, 1) * py + axes(i, 2);
            sum += along[i] * step;
            square += step * step;
        }
        return square > R(0) ? sum / square : depth;
    }
};

/// Returns the peak of a Gaussian by its mean, rotation and scale, for a camera's pose and focal
/// lengths [px].
template <Real R>
RYE_HD RayPeak<R> ray_peak(const Shape<R>& g, const Rigid<R>& pose, R fx, R fy) {
    const Mat3<R> r = quat_matrix(quat_normalized(g.rotation));
    const Vec3<R> m = pose.apply(g.mean);
    const R least = min(min(g.scale[0], g.scale[1]), g.scale[2]);
    RayPeak<R> p;
    for (int a = 0; a < 3; ++a) {
        const R weight = g.scale[a] > least ? least / g.scale[a] : R(1);
        const Vec3<R> axis = pose.turn(Vec3<R>(r(0, a), r(1, a), r(2, a)));
        p.axes(a, 0) = weight * axis[0] / fx;
        p.axes(a, 1) = weight * axis[1] / fy;
        p.axes(a, 2) = weight * axis[2];
        p.along[a] = weight * dot(axis, m);
    }
    p.depth = m[2];
    return p;
}

/// Returns the peak of Gaussian i; duals give their values.
template <class T>
RayPeak<real_t<T>> ray_peak(const std::type_identity_t<GaussianView<T>>& g,
                            const Pinhole<T>& camera, Index i) {
    using R = real_t<T>;
    const auto value = [](const T& x) { return static_cast<R>(value_of(x)); };
    Rigid<R> pose;
    Shape<R> shape;
    for (int k = 0; k < 3; ++k) {
        for (int j = 0; j < 3; ++j)
            pose.rotation(k, j) = value(camera.camera_from_world.rotation(k, j));
        pose.translation[k] = value(camera.camera_from_world.translation[k]);
        shape.mean[k] = value(g.mean(i)[k]);
        shape.scale[k] = value(g.scale(i)[k]);
    }
    for (int k = 0; k < 4; ++k) shape.rotation[k] = value(g.rotation(i)[k]);
    return ray_peak(shape, pose, value(camera.fx), value(camera.fy));
}

} // namespace rye::detail
