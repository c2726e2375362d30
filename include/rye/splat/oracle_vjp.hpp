// SPDX-License-Identifier: Apache-2.0
/// rye/splat/oracle_vjp.hpp: the true gradient that accuracy policies are measured against: by hand
/// through the sums over pixels, in double, and by duals through the ellipses, in long double. It
/// shares no formula with the rasterizer's vjp, and the projection's derivative is nobody's but the
/// duals'. Slow by intent.
#pragma once

#include <array>

#include <rye/autodiff/dual.hpp>
#include <rye/core/error.hpp>
#include <rye/splat/oracle.hpp>

namespace rye {

/// Cotangents of the image and, if not empty, of alpha.
struct OracleCotangent {
    Columns<double> feature;       ///< C x pixels
    Columns<double> alpha = {};    ///< 1 x pixels, or empty
};

namespace detail {

/// Sums over pixels of the cotangents of one ellipse.
struct EllipseCotangent {
    std::array<double, 5> part{};  ///< of u, v, a, b, c
    double opacity = 0;
};

/// One pixel: every alpha near to far, then the recursion far to near.
inline void oracle_pixel_vjp(const OracleScene& scene, const VecX<double>& background,
                             const OracleCotangent& w, int x, int y,
                             std::vector<EllipseCotangent>& sums, Columns<double>& g_feature) {
    std::vector<OracleScene::PixelContribution<double>> hits;
    scene.pixel(x, y, hits);
    std::vector<double> before;                        // transmittance in front of each hit
    double t = 1;
    for (const auto& h : hits) {
        before.push_back(t);
        t *= 1 - h.alpha;
    }
    const Index p = Index(y) * scene.camera.width + x;
    const VecX<double> wp = w.feature.col(p);
    double behind = wp.dot(background);
    const double extra = w.alpha.size() > 0 ? w.alpha(0, p) : 0.0;
    double behind_alpha = 0;                           // of alpha, composited likewise
    for (auto h = hits.rbegin(); h != hits.rend(); ++h) {
        const OracleEllipse<long double>& e = scene.ellipses[h->k];
        const double mine = wp.dot(scene.g.feature.col(e.index));
        const double more = mine - behind + extra * (1 - behind_alpha);
        t = before.back();
        before.pop_back();
        g_feature.col(e.index) += t * h->alpha * wp;
        behind += h->alpha * (mine - behind);
        behind_alpha += h->alpha * (1 - behind_alpha);
        const double g_alpha = t * more;
        EllipseCotangent& s = sums[h->k];
        s.opacity += g_alpha * h->bell;
        const double g_form = -0.5 * g_alpha * h->alpha;
        const double a = static_cast<double>(e.a), b = static_cast<double>(e.b),
                     c = static_cast<double>(e.c);
        const double dx = static_cast<double>(h->dx), dy = static_cast<double>(h->dy);
        s.part[0] -= g_form * 2 * (a * dx + b * dy);
        s.part[1] -= g_form * 2 * (b * dx + c * dy);
        s.part[2] += g_form * dx * dx;
        s.part[3] += g_form * 2 * dx * dy;
        s.part[4] += g_form * dy * dy;
    }
}

} // namespace detail

/// Gradients of everything in `g` for a cotangent of the image.
inline Gaussians<double> oracle_vjp(const Gaussians<double>& g, const Pinhole<double>& camera,
                                    const VecX<double>& background,
                                    const std::vector<std::uint32_t>& order,
                                    const OracleCotangent& w, const OracleModel& model = {}) {
    using D = Dual<long double, 10>;
    require(!model.rays, "oracle_vjp", "got a model of rays, expected one of ellipses");
    const OracleScene scene(g, camera, order, model);
    const auto& ellipses = scene.ellipses;
    std::vector<detail::EllipseCotangent> sums(ellipses.size());
    Gaussians<double> out = zeros_like(g);
    for (int y = 0; y < camera.height; ++y)
        for (int x = 0; x < camera.width; ++x)
            detail::oracle_pixel_vjp(scene, background, w, x, y, sums, out.feature);
    const Pinhole<D> lens = camera.cast<long double>().cast<D>();
    for (std::size_t k = 0; k < ellipses.size(); ++k) {
        const Index i = ellipses[k].index;
        int n = 0;
        const auto lift = [&](double x) { return D::variable(static_cast<long double>(x), n++); };
        Vec3<D> mean, scale;
        Vec4<D> q;
        for (int j = 0; j < 3; ++j) mean[j] = lift(g.mean(j, i));
        for (int j = 0; j < 4; ++j) q[j] = lift(g.rotation(j, i));
        for (int j = 0; j < 3; ++j) scale[j] = lift(g.scale(j, i));
        const OracleEllipse<D> e = oracle_ellipse<D>(i, mean, q, scale, lens, model);
        const std::array<const D*, 5> parts{&e.u, &e.v, &e.a, &e.b, &e.c};
        std::array<long double, 10> sum{};
        for (std::size_t part = 0; part < 5; ++part)
            for (std::size_t j = 0; j < 10; ++j)
                sum[j] += static_cast<long double>(sums[k].part[part]) * parts[part]->d[j];
        for (std::size_t j = 0; j < 10; ++j) {
            const auto row = static_cast<Index>(j);
            double& to = j < 3   ? out.mean(row, i)
                         : j < 7 ? out.rotation(row - 3, i)
                                 : out.scale(row - 7, i);
            to = static_cast<double>(sum[j]);
        }
        out.opacity(0, i) = sums[k].opacity;
    }
    return out;
}

} // namespace rye
