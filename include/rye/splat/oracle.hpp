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

inline OracleImages oracle(const Gaussians<double>& g, const Pinhole<double>& camera,
                           const VecX<double>& background,
                           const std::vector<std::uint32_t>& order, const OracleModel& model = {}) {
    using R = long double;
    struct Ellipse {
        Index index;
        R u, v, z, a, b, c;        ///< centre [px], depth, inverse covariance
    };
    std::vector<Ellipse> ellipses;
    const Pinhole<R> lens = camera.cast<R>();
    const R half_x = R(0.5) * lens.width * R(model.frustum_margin);
    const R half_y = R(0.5) * lens.height * R(model.frustum_margin);
    for (const std::uint32_t i : order) {
        const Vec3<R> mean = g.mean.col(i).cast<R>(), s = g.scale.col(i).cast<R>();
        const Vec4<R> q = g.rotation.col(i).cast<R>();
        const Vec3<R> x = lens.camera_from_world.apply(mean);
        if (!(x[2] > lens.near_depth)) continue;
        const Mat3<R> r = quat_matrix(Vec4<R>(q / q.norm()));
        const Mat3<R> world = r * s.cwiseAbs2().asDiagonal() * r.transpose();
        const R tx = std::clamp(x[0] / x[2], (-lens.cx - half_x) / lens.fx,
                                (R(lens.width) - lens.cx + half_x) / lens.fx);
        const R ty = std::clamp(x[1] / x[2], (-lens.cy - half_y) / lens.fy,
                                (R(lens.height) - lens.cy + half_y) / lens.fy);
        Mat<R, 2, 3> j;
        j << lens.fx / x[2], 0, -lens.fx * tx / x[2], 0, lens.fy / x[2], -lens.fy * ty / x[2];
        const Mat<R, 2, 3> jw = j * lens.camera_from_world.rotation;
        Mat<R, 2, 2> cov = jw * world * jw.transpose();
        cov(0, 0) += R(model.dilation);
        cov(1, 1) += R(model.dilation);
        const R det = cov(0, 0) * cov(1, 1) - cov(0, 1) * cov(1, 0);
        ellipses.push_back({i, lens.fx * x[0] / x[2] + lens.cx, lens.fy * x[1] / x[2] + lens.cy,
                            x[2], cov(1, 1) / det, -cov(0, 1) / det, cov(0, 0) / det});
    }

    const int channels = static_cast<int>(g.channels());
    OracleImages out{{camera.width, camera.height, channels},
                     {camera.width, camera.height, 1},
                     {camera.width, camera.height, 1}};
    for (int y = 0; y < camera.height; ++y)
        for (int x = 0; x < camera.width; ++x) {
            double t = 1;
            for (const Ellipse& e : ellipses) {
                const R dx = x + R(0.5) - e.u, dy = y + R(0.5) - e.v;
                const R form = e.a * dx * dx + 2 * e.b * dx * dy + e.c * dy * dy;
                const double alpha =
                    g.opacity(0, e.index) * std::exp(-0.5 * static_cast<double>(form));
                out.feature.at(x, y) += t * alpha * g.feature.col(e.index);
                out.depth.at(x, y)[0] += t * alpha * static_cast<double>(e.z);
                t *= 1 - alpha;
            }
            out.feature.at(x, y) += t * background;
            out.alpha.at(x, y)[0] = 1 - t;
        }
    return out;
}

} // namespace rye
