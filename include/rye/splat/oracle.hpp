// SPDX-License-Identifier: Apache-2.0
/// rye/splat/oracle.hpp: the truth that accuracy policies are measured against: every Gaussian at
/// every pixel in double, with no cut-off, clamp or stop, written from the covariances themselves
/// and sharing no formula with the rasterizer. The ellipses, whose entries cancel for needles, are
/// in long double. Slow by intent.
/// Source: Zwicker et al., "EWA Splatting", 2002, eq. 26-35.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <vector>

#include <rye/gaussian/gaussians.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/math/rotation.hpp>

namespace rye {

/// The part of a policy that is the model, not an approximation of it.
struct OracleModel {
    double dilation = 0.3;         ///< [px^2]
    double frustum_margin = 0.3;   ///< [half-images]
};

struct OracleImages {
    Image<double> feature, alpha, depth;
};

/// Indices near to far by z in the precision of T, ties by index: the order is part of the model.
template <Real T>
std::vector<std::uint32_t> depth_order(const Gaussians<T>& g, const Pinhole<T>& camera) {
    std::vector<T> z(static_cast<std::size_t>(g.count()));
    for (Index i = 0; i < g.count(); ++i)
        z[static_cast<std::size_t>(i)] = camera.camera_from_world.apply(
            Eigen::Map<const Vec3<T>>(g.mean.data() + 3 * i))[2];
    std::vector<std::uint32_t> order(z.size());
    std::iota(order.begin(), order.end(), 0U);
    std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) { return z[a] < z[b]; });
    return order;
}

/// A Gaussian on the screen, by its covariances.
template <Scalar R>
struct OracleEllipse {
    Index index;
    R u, v, z, a, b, c;        ///< centre [px], depth, inverse covariance [a b; b c]
    bool in_front;
};

/// Of a mean, a quaternion of any norm and three scales.
template <Scalar R>
OracleEllipse<R> oracle_ellipse(Index index, const Vec3<R>& mean, const Vec4<R>& q,
                                const Vec3<R>& s, const Pinhole<R>& lens,
                                const OracleModel& model) {
    using std::sqrt;
    const auto limited = [](const R& x, const R& lo, const R& hi) {
        return x < lo ? lo : x > hi ? hi : x;
    };
    const R half_x = R(0.5 * lens.width * model.frustum_margin);
    const R half_y = R(0.5 * lens.height * model.frustum_margin);
    const Vec3<R> x = lens.camera_from_world.apply(mean);
    if (!(x[2] > lens.near_depth)) return {index, R(0), R(0), R(0), R(0), R(0), R(0), false};
    const R n = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    const Mat3<R> r = quat_matrix(Vec4<R>(q[0] / n, q[1] / n, q[2] / n, q[3] / n));
    Mat3<R> axes = r;
    for (int k = 0; k < 3; ++k)
        for (int i = 0; i < 3; ++i) axes(i, k) = r(i, k) * s[k] * s[k];
    const Mat3<R> world = axes * r.transpose();
    const R tx = limited(x[0] / x[2], (-lens.cx - half_x) / lens.fx,
                         (R(lens.width) - lens.cx + half_x) / lens.fx);
    const R ty = limited(x[1] / x[2], (-lens.cy - half_y) / lens.fy,
                         (R(lens.height) - lens.cy + half_y) / lens.fy);
    Mat<R, 2, 3> j;
    j << lens.fx / x[2], R(0), -lens.fx * tx / x[2], R(0), lens.fy / x[2], -lens.fy * ty / x[2];
    const Mat<R, 2, 3> jw = j * lens.camera_from_world.rotation;
    const Mat<R, 2, 3> half = jw * world;
    Mat<R, 2, 2> cov = half * jw.transpose();
    cov(0, 0) += R(model.dilation);
    cov(1, 1) += R(model.dilation);
    const R det = cov(0, 0) * cov(1, 1) - cov(0, 1) * cov(1, 0);
    return {index, lens.fx * x[0] / x[2] + lens.cx, lens.fy * x[1] / x[2] + lens.cy, x[2],
            cov(1, 1) / det, -cov(0, 1) / det, cov(0, 0) / det, true};
}

/// The ellipses of the Gaussians before the camera, in the given order.
inline std::vector<OracleEllipse<long double>> oracle_ellipses(
    const Gaussians<double>& g, const Pinhole<double>& camera,
    const std::vector<std::uint32_t>& order, const OracleModel& model) {
    using R = long double;
    std::vector<OracleEllipse<R>> ellipses;
    const Pinhole<R> lens = camera.cast<R>();
    for (const std::uint32_t i : order) {
        const Vec3<R> mean = g.mean.col(i).cast<R>(), s = g.scale.col(i).cast<R>();
        const Vec4<R> q = g.rotation.col(i).cast<R>();
        const auto e = oracle_ellipse<R>(i, mean, q, s, lens, model);
        if (e.in_front) ellipses.push_back(e);
    }
    return ellipses;
}

/// T is the scalar of the sums: double, or long double to check the sums themselves.
template <Real T = double>
OracleImages oracle(const Gaussians<double>& g, const Pinhole<double>& camera,
                    const VecX<double>& background, const std::vector<std::uint32_t>& order,
                    const OracleModel& model = {}) {
    using R = long double;
    const auto ellipses = oracle_ellipses(g, camera, order, model);
    const int channels = static_cast<int>(g.channels());
    OracleImages out{{camera.width, camera.height, channels},
                     {camera.width, camera.height, 1},
                     {camera.width, camera.height, 1}};
    for (int y = 0; y < camera.height; ++y)
        for (int x = 0; x < camera.width; ++x) {
            T t = 1, depth = 0;
            VecX<T> feature = VecX<T>::Zero(channels);
            for (const OracleEllipse<R>& e : ellipses) {
                const R dx = x + R(0.5) - e.u, dy = y + R(0.5) - e.v;
                const R form = e.a * dx * dx + 2 * e.b * dx * dy + e.c * dy * dy;
                if (form > 1500) continue;             // exp of it is 0 in double
                const T alpha = T(g.opacity(0, e.index)) * std::exp(T(-0.5) * static_cast<T>(form));
                feature += t * alpha * g.feature.col(e.index).cast<T>();
                depth += t * alpha * static_cast<T>(e.z);
                t *= 1 - alpha;
            }
            feature += t * background.cast<T>();
            out.feature.at(x, y) = feature.template cast<double>();
            out.alpha.at(x, y)[0] = static_cast<double>(1 - t);
            out.depth.at(x, y)[0] = static_cast<double>(depth);
        }
    return out;
}

} // namespace rye
