// SPDX-License-Identifier: Apache-2.0
// Projection of one Gaussian: needles, near plane, limits of the Jacobian, and the hand-written
// reverse derivative against duals, on random and hard cases.
#include <rye/gaussian/project.hpp>

#include <doctest/doctest.h>

#include <rye/backend/lanes.hpp>
#include <rye/core/random.hpp>

#include "../support/projection_law.hpp"

using namespace rye;
using namespace rye::test;

namespace {

Pinhole<double> tilted_camera() {
    Pinhole<double> c;
    c.fx = 300, c.fy = 320, c.cx = 90, c.cy = -20;
    c.width = 128, c.height = 100;
    const Vec3<double> turn(0.3, -0.2, 0.5);
    c.camera_from_world.rotation = so3_exp(turn);
    c.camera_from_world.translation = Vec3<double>(0.1, 0.2, 4);
    return c;
}

} // namespace

TEST_CASE("project: dot-product test, thousands of random shapes inside and outside the image") {
    Draws d{{1, 1}};
    const auto camera = tilted_camera();
    double worst = 0;
    for (int i = 0; i < 4000; ++i) worst = std::max(worst, gap(random_shape(d), camera, 0.3, d));
    CHECK(worst < 1e-12);
}

TEST_CASE("project, mip: dot-product test, random shapes, specks and needles") {
    Draws d{{4, 1}};
    const auto camera = tilted_camera();
    double worst = 0;
    for (int i = 0; i < 4000; ++i) {
        Shape<double> s = random_shape(d);
        if (i % 3 == 0) s.scale *= 1e-4;
        if (i % 3 == 1) s.scale[i % 2] *= 1e-3;
        worst = std::max(worst, gap<Antialias::mip>(s, camera, 0.3, d));
    }
    CHECK(worst < 1e-12);
}

TEST_CASE("project, mip: large Gaussians keep their opacity, specks their light, flat ones none") {
    Draws d{{5, 1}};
    const Pinhole<double> camera = tilted_camera();
    const Projector<double> lens(camera, 0.3, 0.3), plain(camera, 0.3, 0.0);
    double large = 0, light = 0;
    for (int i = 0; i < 500; ++i) {
        Shape<double> s = random_shape(d);
        s.scale = Vec3<double>(0.9, 1.0, 1.1);
        if (!project(s, lens).drawable) continue;
        s.scale *= 1e4;
        large = std::max(large, std::abs(project<Antialias::mip>(s, lens).share - 1));
        // Without dilation the share is exactly 1.
        CHECK(project<Antialias::mip>(s, plain).share == 1);
        // The integrated contribution of a Gaussian, opacity times sqrt(det), is unchanged by mip.
        s.scale *= 1e-8;
        const auto p = project<Antialias::mip>(s, lens);
        const double full = std::sqrt(project(s, plain).determinant);
        light = std::max(light, std::abs(p.share * std::sqrt(p.determinant) / full - 1));
        CHECK(p.share < 0.1);
        CHECK(detail::kept_opacity(p, 0.5) == 0.5 * p.share);
        // The screen Gaussian itself is the dilated one.
        CHECK(p.determinant == project(s, lens).determinant);
        CHECK(detail::kept_opacity(project(s, lens), 0.5) == 0.5);
    }
    CHECK(large < 1e-6);
    CHECK(light < 1e-12);
    Shape<double> flat = random_shape(d);
    flat.scale.setZero();
    const auto gone = project<Antialias::mip>(flat, lens);
    CHECK(gone.share == 0);
    const Shape<double> r = project_vjp<Antialias::mip>(
        flat, lens, {Vec2<double>(0, 0), {0, 0, 0}, 0}, 1.0);
    CHECK(r.scale.allFinite());
    CHECK(r.mean.allFinite());
}

TEST_CASE("project: dot-product test on both sides of the Jacobian's limits and on needles") {
    Draws d{{2, 1}};
    Pinhole<double> camera = tilted_camera();
    camera.camera_from_world = Rigid<double>();
    const Projector<double> lens(camera, 0.3, 0.3);
    for (const double limit : {lens.x_low, lens.x_high})
        for (const double nudge : {1 - 1e-3, 1 - 1e-7, 1 + 1e-7, 1 + 1e-3, 2.0}) {
            Shape<double> s = random_shape(d);
            s.mean = Vec3<double>(2 * limit * nudge, 2 * lens.y_high * nudge, 2);
            CHECK(gap(s, camera, 0.3, d) < 1e-12);
        }
    for (const double length : {0.1, 1.0, 10.0, 100.0}) {
        Shape<double> s = random_shape(d);
        s.mean = Vec3<double>(0.1, 0.1, 2);
        s.scale = Vec3<double>(length, 1e-3, 1e-3);
        CHECK(gap(s, camera, 0.3, d) < 1e-9);              // u length / sqrt(dilation)
        s.scale = Vec3<double>(0.1, 0.0, length);     // a flat one
        CHECK(gap(s, camera, 0.3, d) < 1e-9);
    }
}

TEST_CASE("project: determinant and exponent of needles in float") {
    Draws d{{3, 1}};
    double worst_det = 0, worst_power = 0;
    for (const double sigma : {10.0, 100.0, 1000.0, 30000.0})
        for (int i = 0; i < 2000; ++i) {
            const double a = 6.3 * d.uniform(), e = 1e-3;
            const Vec3<float> x(float(sigma * std::cos(a)), float(-e * std::sin(a)), 0);
            const Vec3<float> y(float(sigma * std::sin(a)), float(e * std::cos(a)), 0);
            const Vec3<double> xd = x.cast<double>(), yd = y.cast<double>();
            const double truth = detail::gram_determinant(xd, yd, double(0.3F));
            const double det = double(detail::gram_determinant(x, y, 0.3F));
            worst_det = std::max(worst_det, std::abs(det / truth - 1));
            if (sigma > 1000) continue;
            const auto f = detail::precision_factor(x, y, 0.3F);
            const auto g = detail::precision_factor(xd, yd, double(0.3F));
            const double u = 3 * (2 * d.uniform() - 1), v = d.normal();
            const float dx = float(u * sigma * std::cos(a) - 0.5 * v * std::sin(a));
            const float dy = float(u * sigma * std::sin(a) + 0.5 * v * std::cos(a));
            const double exact = g.quadratic(double(dx), double(dy));
            const double gap = std::abs(0.5 * (double(f.quadratic(dx, dy)) - exact));
            worst_power = std::max(worst_power, gap / (sigma / std::sqrt(0.3)));
        }
    CHECK(worst_det < 4e-7);
    CHECK(worst_power < 2 * 6e-8 * 20);
}

TEST_CASE("project: what cannot be drawn is said so") {
    Pinhole<float> camera = tilted_camera().cast<float>();
    camera.camera_from_world = Rigid<float>();
    camera.near_depth = 0.5F;
    const Projector<float> lens(camera, 0.3, 0.3);
    const auto drawable = [&](float x, float z, float scale) {
        const Shape<float> s{Vec3<float>(x, 0, z), Quat<float>(1, 0, 0, 0),
                             Vec3<float>(scale, scale, scale)};
        return project(s, lens).drawable;
    };
    CHECK(drawable(0, 0.5001F, 0.1F));
    for (const float z : {0.5F, 0.1F, 1e-6F, 0.0F, -2.0F}) CHECK_FALSE(drawable(0, z, 0.1F));
    CHECK(drawable(0, 1, 0));
    CHECK(drawable(0, 1, 1e-30F));
    CHECK_FALSE(drawable(0, 1, 1e18F));
    CHECK_FALSE(drawable(1e30F, 1, 1));
    const float nan = std::numeric_limits<float>::quiet_NaN();
    CHECK_FALSE(drawable(nan, 1, 1));
    CHECK_FALSE(drawable(0, nan, 1));
    CHECK_FALSE(drawable(0, 1, nan));
}

TEST_CASE("project: lanes hold what one scalar at a time does") {
    using V = XsimdBackend<>::batch<float>;
    constexpr std::size_t lanes = V::size;
    Draws d{{4, 1}};
    const Pinhole<float> camera = tilted_camera().cast<float>();
    const Projector<float> lens(camera, 0.3, 0.3);
    const Projector<V> wide(lens);
    for (int trial = 0; trial < 50; ++trial) {
        std::array<Shape<float>, lanes> one;
        alignas(64) float rows[10][lanes];
        for (std::size_t i = 0; i < lanes; ++i) {
            const Shape<double> s = random_shape(d);
            one[i] = {s.mean.cast<float>(), s.rotation.cast<float>(), s.scale.cast<float>()};
            for (int k = 0; k < 3; ++k) rows[k][i] = one[i].mean[k];
            for (int k = 0; k < 4; ++k) rows[3 + k][i] = one[i].rotation[k];
            for (int k = 0; k < 3; ++k) rows[7 + k][i] = one[i].scale[k];
        }
        const auto at = [&](int k) { return V::load_aligned(rows[k]); };
        const Shape<V> all{Vec3<V>(at(0), at(1), at(2)), Quat<V>(at(3), at(4), at(5), at(6)),
                           Vec3<V>(at(7), at(8), at(9))};
        const ScreenGaussian<V> s = project(all, wide);
        const ScreenCotangent<V> c{Vec2<V>(V(0.3F), V(-0.2F)), {V(1.0F), V(-0.4F), V(0.7F)},
                                   V(0.1F)};
        const Shape<V> g = project_vjp(all, wide, c);
        for (std::size_t i = 0; i < lanes; ++i) {
            const ScreenGaussian<float> t = project(one[i], lens);
            CHECK(s.centre[0].get(i) == doctest::Approx(t.centre[0]).epsilon(1e-5));
            CHECK(s.determinant.get(i) == doctest::Approx(t.determinant).epsilon(1e-4));
            CHECK(s.drawable.get(i) == t.drawable);
            const ScreenCotangent<float> one_c{Vec2<float>(0.3F, -0.2F), {1.0F, -0.4F, 0.7F}, 0.1F};
            const Shape<float> h = project_vjp(one[i], lens, one_c);
            if (!t.drawable) continue;
            for (int k = 0; k < 3; ++k)
                CHECK(std::abs(g.mean[k].get(i) - h.mean[k]) <= 1e-4F * (1 + h.mean.norm()));
            for (int k = 0; k < 4; ++k)
                CHECK(std::abs(g.rotation[k].get(i) - h.rotation[k]) <=
                      1e-4F * (1 + h.rotation.norm()));
        }
    }
}
