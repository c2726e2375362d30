// SPDX-License-Identifier: Apache-2.0
// Renders through a lens with distortion: both backends, forward and vjp, against the pinhole,
// duals and rays through every pixel.
#include <rye/splat/lanes.hpp>

#include <doctest/doctest.h>

#include "../support/render_law.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using Plain = ScalarBackend<>;
using Lanes = XsimdBackend<>;
using Lens64 = BrownConrady<double>;
constexpr Lens64 barrel{-0.3, 0.08, -0.01, 2e-3, -1e-3};

template <class B, class A, class T, class D>
Raster<T> draw(const Scenery<T>& s, const Pinhole<T, D>& c) {
    return Rasterizer<A>{}.forward(B{}, s.gaussians, c, s.background);
}

template <class T>
double most(const Columns<T>& a, const Columns<T>& b) {
    return static_cast<double>((a - b).cwiseAbs().maxCoeff());
}

} // namespace

TEST_CASE_TEMPLATE("a lens without coefficients draws the pinhole's picture", T, float, double) {
    const auto s = random_scene<T>(60, 3, 31);
    const auto bent = with_lens(s.camera, BrownConrady<T>{});
    // Plain loops project both in the same way: equal to the bit.
    CHECK(draw<Plain, Balanced>(s, bent).feature.pixels ==
          draw<Plain, Balanced>(s, s.camera).feature.pixels);
    // Lanes project the pinhole's Gaussians with fused products.
    CHECK(most(draw<Lanes, Balanced>(s, bent).feature.pixels,
               draw<Lanes, Balanced>(s, s.camera).feature.pixels) <
          (std::is_same_v<T, float> ? 2e-4 : 1e-12));
    CHECK(most(draw<Plain, Balanced>(s, with_lens(s.camera, barrel.cast<T>())).feature.pixels,
               draw<Plain, Balanced>(s, s.camera).feature.pixels) > 0.05);
}

TEST_CASE("a bent render: lanes agree with the plain walk, forward and vjp, on hard scenes too") {
    for (const Scenery<float>& s : hard_scenes<float>(4)) {
        INFO(s.name);
        const auto c = with_lens(s.camera, barrel.cast<float>());
        const Raster<float> a = draw<Plain, Balanced>(s, c), b = draw<Lanes, Balanced>(s, c);
        CHECK(most(a.feature.pixels, b.feature.pixels) < 2e-4);
        const Columns<float> w = noise<float>(4, a.feature.size(), 5);
        const Gaussians<float> g =
            Rasterizer<Balanced>{}.vjp(Plain{}, s.gaussians, c, s.background, a, w);
        const Gaussians<float> h =
            Rasterizer<Balanced>{}.vjp(Lanes{}, s.gaussians, c, s.background, b, w);
        Gaussians<float>::fields([](const std::string& name, const auto& x, const auto& y) {
            INFO(name);
            CHECK(x.allFinite());
            CHECK((x - y).norm() <= 2e-3f * (1e-3f + x.norm()));
        }, g, h);
    }
}

TEST_CASE("a bent render's vjp is the transpose of its duals") {
    const auto s = random_scene<double>(30, 3, 32);
    CHECK(render_law_gap<Plain>(s, with_lens(s.camera, barrel), Exact64(), 6) < 1e-11);
}

TEST_CASE("a bent render against rays through every pixel: as near as the pinhole's") {
    // One Gaussian at a time; the reference is its density at the peak along a ray.
    const auto by_rays = [](const Gaussians<double>& g, const auto& camera) {
        Columns<double> alpha(1, Index(camera.width) * camera.height);
        const Mat3<double> r = quat_matrix(quat_normalized(Quat<double>(g.rotation.col(0))));
        const Mat3<double> whiten(g.scale.col(0).cwiseInverse().asDiagonal() * r.transpose());
        const Vec3<double> m(whiten * (g.mean.col(0) - camera.centre()));
        for (int y = 0; y < camera.height; ++y)
            for (int x = 0; x < camera.width; ++x) {
                const Vec3<double> d(whiten * camera.ray(Vec2<double>(x + 0.5, y + 0.5)));
                const double form = cross(m, d).squaredNorm() / d.squaredNorm();
                alpha(0, Index(y) * camera.width + x) = g.opacity(0, 0) * std::exp(-0.5 * form);
            }
        return alpha;
    };
    struct Undilated : Exact64 {
        constexpr Undilated() { dilation = 0; }
    };
    double straight = 0, bent = 0, wrong = 0;
    for (std::uint64_t seed = 1; seed <= 30; ++seed) {
        auto s = random_scene<double>(1, 3, seed, 0.1);
        s.gaussians.opacity.setConstant(0.9);
        s.gaussians.mean.row(0).array() += 0.4;  // off the axis, where the lens distorts
        const auto c = with_lens(s.camera, barrel);
        const Columns<double> truth = by_rays(s.gaussians, c);
        straight = std::max(straight, most(by_rays(s.gaussians, s.camera),
                                           draw<Plain, Undilated>(s, s.camera).alpha.pixels));
        bent = std::max(bent, most(truth, draw<Plain, Undilated>(s, c).alpha.pixels));
        wrong = std::max(wrong, most(truth, draw<Plain, Undilated>(s, s.camera).alpha.pixels));
    }
    MESSAGE("alpha against rays: pinhole " << straight << ", bent " << bent
                                           << ", bent drawn by a pinhole " << wrong);
    CHECK(bent < 1.5 * straight);
    CHECK(wrong > 2 * bent);
}
