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
    std::array<double, 5> part{};  ///< cotangents of u, v, a, b, c
    double opacity = 0;
};

/// Sums of all ellipses, and of the Gaussians' features.
struct OracleSums {
    std::vector<EllipseCotangent> ellipses;
    Columns<double>& feature;
};

/// Adds the cotangents of one pixel: every alpha near to far, then the recursion far to near.
inline void oracle_pixel_vjp(const OracleScene& scene, const VecX<double>& background,
                             const OracleCotangent& w, Index p, OracleSums& sums) {
    std::vector<OracleScene::PixelContribution<double>> hits;
    const Index width = scene.camera.width;
    scene.pixel(static_cast<int>(p % width), static_cast<int>(p / width), hits);
    std::vector<double> before;                        // transmittance in front of each hit
    double t = 1;
    for (const auto& h : hits) {
        before.push_back(t);
        t *= 1 - h.alpha;
    }
    const VecX<double> wp = w.feature.col(p);
    double behind = wp.dot(background);
    const double extra = w.alpha.size() > 0 ? w.alpha(0, p) : 0.0;
    double behind_alpha = 0;                           // the same of alpha
    for (auto h = hits.rbegin(); h != hits.rend(); ++h) {
        const OracleEllipse<long double>& e = scene.ellipses[h->k];
        const double mine = wp.dot(scene.g.feature.col(e.index));
        const double more = mine - behind + extra * (1 - behind_alpha);
        t = before.back();
        before.pop_back();
        sums.feature.col(e.index) += t * h->alpha * wp;
        behind += h->alpha * (mine - behind);
        behind_alpha += h->alpha * (1 - behind_alpha);
        const double g_alpha = t * more;
        EllipseCotangent& s = sums.ellipses[h->k];
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

/// Returns the gradients of everything in the scene's Gaussians for a cotangent of the image.
inline Gaussians<double> oracle_vjp(const detail::OracleScene& scene,
                                    const VecX<double>& background, const OracleCotangent& w) {
    using D = Dual<long double, 10>;
    const Gaussians<double>& g = scene.g;
    const Pinhole<double>& camera = scene.camera;
    require(!scene.model.rays, "oracle_vjp", "got a model of rays, expected one of ellipses");
    const auto& ellipses = scene.ellipses;
    Gaussians<double> out = zeros_like(g);
    detail::OracleSums sums{std::vector<detail::EllipseCotangent>(ellipses.size()), out.feature};
    for (Index p = 0; p < Index(camera.width) * camera.height; ++p)
        detail::oracle_pixel_vjp(scene, background, w, p, sums);
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
        const detail::OracleEllipse<D> e =
            detail::oracle_ellipse<D>({i, mean, q, scale}, lens, scene.model);
        const std::array<const D*, 5> parts{&e.u, &e.v, &e.a, &e.b, &e.c};
        std::array<long double, 10> sum{};
        for (std::size_t part = 0; part < 5; ++part)
            for (std::size_t j = 0; j < 10; ++j)
                sum[j] += static_cast<long double>(sums.ellipses[k].part[part]) * parts[part]->d[j];
        for (std::size_t j = 0; j < 10; ++j) {
            const auto row = static_cast<Index>(j);
            double& to = j < 3   ? out.mean(row, i)
                         : j < 7 ? out.rotation(row - 3, i)
                                 : out.scale(row - 7, i);
            to = static_cast<double>(sum[j]);
        }
        out.opacity(0, i) = sums.ellipses[k].opacity;
    }
    return out;
}

} // namespace rye
