// SPDX-License-Identifier: Apache-2.0
/// rye/splat/oracle.hpp: the truth that accuracy policies are measured against: every Gaussian at
/// every pixel in double, with no cut-off, clamp or stop, written from the covariances themselves
/// and sharing no formula with the rasterizer. The ellipses, whose entries cancel for needles, are
/// in long double. Slow by intent. There are two truths: of the same model as the rasterizer's,
/// which leaves only numbers to differ; and the physical one, of rays through the Gaussians in
/// space, in the order in which each ray meets them.
/// Source: Zwicker et al., "EWA Splatting", 2002, eq. 26-35; Keselman and Hebert, "Approximate
/// Differentiable Rendering with Algebraic Surfaces", 2022, for the peak along a ray.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <vector>

#include <rye/gaussian/gaussians.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/math/rotation.hpp>
#include <rye/splat/accuracy.hpp>

namespace rye {

/// The part of a policy that is the model, not an approximation of it.
struct OracleModel {
    double dilation = 0.3;         ///< [px^2]
    double frustum_margin = 0.3;   ///< [half-images]
    BlendOrder order = BlendOrder::by_centre;
    /// Takes alpha from the whitened distance of the pixel's ray to the mean, before the camera,
    /// and not from the ellipse on the screen; without dilation or margin.
    bool rays = false;
};

/// The physical truth.
inline constexpr OracleModel physical_model{
    .dilation = 0, .order = BlendOrder::by_peak, .rays = true};

/// Images of the oracle: C channels, opacity and depth.
struct OracleImages {
    Image<double> feature, alpha, depth;
};

/// Returns indices near to far by z in the precision of T, ties by index: the order is part of the
/// model.
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

namespace detail {

/// A Gaussian on the screen, by its covariances.
template <Scalar R>
struct OracleEllipse {
    Index index;
    R u, v, z, a, b, c;        ///< centre [px], depth, inverse covariance [a b; b c]
    bool in_front;
};

/// A Gaussian as a ray from the camera sees it: whitened by S^-1 R', S no less than 1e-9.
struct OracleSolid {
    Mat3<double> whiten;       ///< whitens a ray's direction in the camera's frame
    Vec3<double> mean;         ///< whitened

    /// A Gaussian's densest point along a ray.
    struct Meeting {
        double depth, form;    ///< depth of the point; its squared distance to the mean, whitened
    };
    /// Returns the ray through (d[0], d[1]) at depth 1.
    Meeting meet(const Vec3<double>& d) const {
        const Vec3<double> w(whiten * d), miss(cross(mean, w));
        const double square = w.squaredNorm();
        return {dot(mean, w) / square, miss.squaredNorm() / square};
    }
};

/// Returns Gaussian i of a cloud as the rays of a camera see it.
inline OracleSolid oracle_solid(const Gaussians<double>& g, const Pinhole<double>& camera,
                                Index i) {
    const Vec4<double> q = g.rotation.col(i);
    const double n = q.norm();
    const Mat3<double> axes =
        n > 0 ? quat_matrix(Vec4<double>(q / n)) : Mat3<double>(Mat3<double>::Identity());
    const Mat3<double> r(camera.camera_from_world.rotation * axes);
    const Vec3<double> inverse = g.scale.col(i).cwiseMax(1e-9).cwiseInverse();
    const Mat3<double> whiten(inverse.asDiagonal() * r.transpose());
    return {whiten, Vec3<double>(whiten * camera.camera_from_world.apply(g.mean.col(i)))};
}

/// The Gaussians before the camera, and, if the model asks for rays, their solids.
struct OracleScene {
    const Gaussians<double>& g;
    const Pinhole<double>& camera;
    OracleModel model;
    std::vector<OracleEllipse<long double>> ellipses;
    std::vector<OracleSolid> solids;

    OracleScene(const Gaussians<double>&, const Pinhole<double>&,
                const std::vector<std::uint32_t>& order, const OracleModel&);

    /// A contribution to a pixel: ellipse k, off its centre by (dx, dy) [px].
    template <Real T>
    struct PixelContribution {
        std::size_t k;
        long double dx, dy;
        T bell, alpha, depth;
        double peak;
    };
    /// Finds the hits of a pixel, near to far.
    template <Real T>
    void pixel(int x, int y, std::vector<PixelContribution<T>>& hits) const;
};

/// A Gaussian as it is given: a quaternion of any norm.
template <Scalar R>
struct OracleGaussian {
    Index index;
    Vec3<R> mean;
    Vec4<R> rotation;
    Vec3<R> scale;
};

/// Returns a Gaussian's ellipse on the screen, by the model's rules.
template <Scalar R>
OracleEllipse<R> oracle_ellipse(const OracleGaussian<R>& g, const Pinhole<R>& lens,
                                const OracleModel& model) {
    using std::sqrt;
    const Index index = g.index;
    const Vec3<R>&mean = g.mean, &s = g.scale;
    const Vec4<R>& q = g.rotation;
    const auto limited = [](const R& x, const R& lo, const R& hi) {
        return x < lo ? lo : x > hi ? hi : x;
    };
    const R half_x = R(0.5 * lens.width * model.frustum_margin);
    const R half_y = R(0.5 * lens.height * model.frustum_margin);
    const Vec3<R> x = lens.camera_from_world.apply(mean);
    if (!(x[2] > lens.near_depth)) return {index, R(0), R(0), R(0), R(0), R(0), R(0), false};
    const R n = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    const Mat3<R> r = n > R(0) ? quat_matrix(Vec4<R>(q[0] / n, q[1] / n, q[2] / n, q[3] / n))
                               : Mat3<R>(Mat3<R>::Identity());
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

/// Returns the ellipses of the Gaussians before the camera, in the given order.
inline std::vector<OracleEllipse<long double>> oracle_ellipses(
    const Gaussians<double>& g, const Pinhole<double>& camera,
    const std::vector<std::uint32_t>& order, const OracleModel& model) {
    using R = long double;
    std::vector<OracleEllipse<R>> ellipses;
    const Pinhole<R> lens = camera.cast<R>();
    for (const std::uint32_t i : order) {
        const auto at = static_cast<Index>(i);
        const Vec3<R> mean = g.mean.col(at).cast<R>(), s = g.scale.col(at).cast<R>();
        const Vec4<R> q = g.rotation.col(at).cast<R>();
        const auto e = oracle_ellipse<R>({at, mean, q, s}, lens, model);
        if (e.in_front) ellipses.push_back(e);
    }
    return ellipses;
}

} // namespace detail

inline detail::OracleScene::OracleScene(const Gaussians<double>& gaussians,
                                        const Pinhole<double>& lens,
                                        const std::vector<std::uint32_t>& order,
                                        const OracleModel& m)
    : g(gaussians),
      camera(lens),
      model(m),
      ellipses(detail::oracle_ellipses(g, camera, order, m)) {
    if (model.rays || model.order == BlendOrder::by_peak)
        for (const auto& e : ellipses) solids.push_back(detail::oracle_solid(g, camera, e.index));
}

template <Real T>
void detail::OracleScene::pixel(int x, int y, std::vector<PixelContribution<T>>& hits) const {
    using R = long double;
    hits.clear();
    const Vec3<double> ray((x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy,
                           1.0);
    for (std::size_t k = 0; k < ellipses.size(); ++k) {
        const detail::OracleEllipse<R>& e = ellipses[k];
        const R dx = x + R(0.5) - e.u, dy = y + R(0.5) - e.v;
        R form = e.a * dx * dx + 2 * e.b * dx * dy + e.c * dy * dy;
        T depth = static_cast<T>(e.z);
        double peak = 0;
        if (!model.rays && form > 1500) continue;      // exp of it is 0 in double
        if (!solids.empty()) {
            const detail::OracleSolid::Meeting m = solids[k].meet(ray);
            peak = m.depth;
            if (model.rays) {
                if (!(m.depth > 0) || m.form > 1500) continue;
                form = m.form;
                depth = static_cast<T>(m.depth);
            }
        }
        const T bell = std::exp(T(-0.5) * static_cast<T>(form));
        hits.push_back({k, dx, dy, bell, T(g.opacity(0, e.index)) * bell, depth, peak});
    }
    if (model.order == BlendOrder::by_peak)
        std::stable_sort(hits.begin(), hits.end(),
                         [](const auto& a, const auto& b) { return a.peak < b.peak; });
}

/// Returns the true images. T is the scalar of the sums: double, or long double to check the sums
/// themselves.
template <Real T = double>
OracleImages oracle(const Gaussians<double>& g, const Pinhole<double>& camera,
                    const VecX<double>& background, const std::vector<std::uint32_t>& order,
                    const OracleModel& model = {}) {
    const detail::OracleScene scene(g, camera, order, model);
    const int channels = static_cast<int>(g.channels());
    OracleImages out{{camera.width, camera.height, channels},
                     {camera.width, camera.height, 1},
                     {camera.width, camera.height, 1}};
    std::vector<detail::OracleScene::PixelContribution<T>> hits;
    for (int y = 0; y < camera.height; ++y)
        for (int x = 0; x < camera.width; ++x) {
            T t = 1, depth = 0;
            VecX<T> feature = VecX<T>::Zero(channels);
            scene.pixel(x, y, hits);
            for (const auto& h : hits) {
                const Index i = scene.ellipses[h.k].index;
                feature += t * h.alpha * g.feature.col(i).template cast<T>();
                depth += t * h.alpha * h.depth;
                t *= 1 - h.alpha;
            }
            feature += t * background.cast<T>();
            out.feature.at(x, y) = feature.template cast<double>();
            out.alpha.at(x, y)[0] = static_cast<double>(1 - t);
            out.depth.at(x, y)[0] = static_cast<double>(depth);
        }
    return out;
}

} // namespace rye
