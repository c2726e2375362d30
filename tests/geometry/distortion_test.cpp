// SPDX-License-Identifier: Apache-2.0
#include <rye/geometry/distortion.hpp>

#include <doctest/doctest.h>

#include <rye/autodiff/check.hpp>
#include <rye/autodiff/dual.hpp>
#include <rye/geometry/camera.hpp>

using namespace rye;

namespace {

using Lens64 = BrownConrady<double>;

constexpr Lens64 barrel{-0.28, 0.07, -0.008, 1.2e-3, -7e-4};
constexpr Lens64 pincushion{0.2, 0.05, 0.0, -2e-3, 1e-3};

static_assert(sizeof(Pinhole<float>) ==
              sizeof(float) * (5 + 12) + 2 * sizeof(int));  // a pinhole stores no lens

Pinhole<double> plain() {
    Pinhole<double> c;
    c.fx = 320, c.fy = 310, c.cx = 162, c.cy = 118, c.width = 320, c.height = 240;
    c.camera_from_world.translation = Vec3<double>(0.1, -0.2, 3);
    return c;
}

} // namespace

TEST_CASE("distortion: a golden slope, of OpenCV's formula term by term") {
    const Lens64 d{0.1, 0.02, -0.003, 0.004, -0.005};
    const double x = 0.5, y = -0.25, r2 = x * x + y * y;
    const double radial = 1 + 0.1 * r2 + 0.02 * r2 * r2 - 0.003 * r2 * r2 * r2;
    const Vec2<double> at = d.distort(Vec2<double>(x, y)).at;
    CHECK(at[0] == doctest::Approx(x * radial + 2 * 0.004 * x * y - 0.005 * (r2 + 2 * x * x))
                       .epsilon(1e-15));
    CHECK(at[1] == doctest::Approx(y * radial + 0.004 * (r2 + 2 * y * y) - 2 * 0.005 * x * y)
                       .epsilon(1e-15));
}

TEST_CASE("distortion: Jacobian and its cotangent against duals") {
    using D = Dual<double, 2>;
    const Random random{3, 0};
    std::uint64_t k = 0;
    double worst = 0;
    for (int trial = 0; trial < 2000; ++trial) {
        const auto draw = [&] { return 0.5 * random.normal(k++); };
        const Lens64 d{draw(), draw(), draw(), draw(), draw()};
        const Vec2<double> s(draw(), draw());
        const Sym2<double> g{draw(), draw(), draw()};
        const Vec2<D> t(D::variable(s[0], 0), D::variable(s[1], 1));
        const Distorted<D> b = d.cast<D>().distort(t);
        const Sym2<double> j = d.distort(s).slope;
        const double size = 1 + std::abs(j.xx) + std::abs(j.xy) + std::abs(j.yy);
        for (const double gap : {b.at[0].d[0] - j.xx, b.at[0].d[1] - j.xy, b.at[1].d[0] - j.xy,
                                 b.at[1].d[1] - j.yy})
            worst = std::max(worst, std::abs(gap) / size);
        const Vec2<double> r = d.slope_vjp(s, g);
        for (int i = 0; i < 2; ++i) {
            const auto at = static_cast<std::size_t>(i);
            const double a = g.xx * b.slope.xx.d[at], c = g.xy * b.slope.xy.d[at],
                         e = g.yy * b.slope.yy.d[at];
            worst = std::max(worst, std::abs(a + c + e - r[i]) /
                                        (1 + std::abs(a) + std::abs(c) + std::abs(e)));
        }
    }
    CHECK(worst < 1e-13);
}

TEST_CASE("distortion: without coefficients nothing is bent, to the bit") {
    const BrownConrady<float> none;
    for (const float x : {0.0F, 1e-30F, 0.3F, -7.5F}) {
        const Distorted<float> b = none.distort(Vec2<float>(x, 0.7F * x));
        CHECK(b.at[0] == x);
        CHECK(b.at[1] == 0.7F * x);
        CHECK(b.slope.xx == 1);
        CHECK(b.slope.xy == 0);
        CHECK(b.slope.yy == 1);
    }
    CHECK(std::isinf(none.fold()));
}

TEST_CASE("distortion: the fold is the first root of the radial slope") {
    CHECK(Lens64{-1.0 / 3, 0, 0, 0, 0}.fold() == doctest::Approx(1).epsilon(1e-14));
    CHECK(std::isinf(pincushion.fold()));
    // Of three roots the first: (1 - t)(1 - t / 2)(1 - t / 3) = 1 - 11/6 t + t^2 - t^3 / 6.
    const Lens64 three{-11.0 / 18, 1.0 / 5, -1.0 / 42, 0, 0};
    CHECK(three.fold() == doctest::Approx(1).epsilon(1e-12));
    const Random random{4, 0};
    std::uint64_t k = 0;
    for (int trial = 0; trial < 500; ++trial) {
        const auto draw = [&] { return random.normal(k++); };
        const Lens64 d{0.3 * draw(), 0.2 * draw(), 0.1 * draw(), 0, 0};
        const auto rise = [&](double t) {
            return 1 + t * (3 * d.k1 + t * (5 * d.k2 + t * 7 * d.k3));
        };
        const double fold = d.fold(), end = std::min(fold, 1e3);
        double least = 1;
        for (int i = 0; i < 20000; ++i) least = std::min(least, rise(end * i / 20000.0));
        CHECK(least > -1e-9);
        if (fold < 1e6) CHECK(rise(fold * (1 + 1e-9)) <= 1e-6 * (1 + fold * fold * fold));
    }
}

TEST_CASE("distortion: unbending is the inverse, up to the fold") {
    for (const Lens64& d : {barrel, pincushion, Lens64{-0.4, 0, 0, 0, 0}, Lens64{}}) {
        const double reach = std::min(1.5, std::sqrt(d.fold()));
        for (double r = 0; r < 0.995; r += 0.033)
            for (double a = 0; a < 6.28; a += 0.37) {
                const Vec2<double> s(r * reach * std::cos(a), r * reach * std::sin(a));
                const Distorted<double> b = d.distort(s);
                if (!(b.slope.determinant() > 0.02)) continue;
                const Undistorted<double> u = undistort(d, b.at);
                CHECK(u.reached);
                CHECK((u.slope - s).norm() < 1e-11);
            }
    }
    const Lens64 fold{-1.0 / 3, 0, 0, 0, 0};  // turns back at 1, where D is 2/3
    CHECK(undistort(fold, Vec2<double>(0.6666, 0)).reached);
    for (const double far : {0.6668, 1.0, 50.0})
        CHECK_FALSE(undistort(fold, Vec2<double>(0, far)).reached);
    // Its derivative is the inverse Jacobian.
    using D = Dual<double, 2>;
    const Vec2<double> at(0.3, -0.2);
    const Undistorted<D> u =
        undistort(barrel.cast<D>(), Vec2<D>(D::variable(at[0], 0), D::variable(at[1], 1)));
    const Sym2<double> j = barrel.distort(undistort(barrel, at).slope).slope;
    CHECK(u.slope[0].d[0] == doctest::Approx(j.yy / j.determinant()).epsilon(1e-12));
    CHECK(u.slope[0].d[1] == doctest::Approx(-j.xy / j.determinant()).epsilon(1e-12));
    CHECK(u.slope[1].d[1] == doctest::Approx(j.xx / j.determinant()).epsilon(1e-12));
}

TEST_CASE("distortion: a camera's ray goes through the points that project to its pixel") {
    for (const Lens64& d : {barrel, pincushion}) {
        const auto c = with_lens(plain(), d);
        for (const double u : {3.0, 162.0, 317.5})
            for (const double v : {1.5, 120.0}) {
                const Vec3<double> x = c.centre() + 2.5 * c.ray(Vec2<double>(u, v));
                const Vec3<double> p = c.project_point(x);
                CHECK(p[0] == doctest::Approx(u).epsilon(1e-11));
                CHECK(p[1] == doctest::Approx(v).epsilon(1e-11));
            }
        CHECK(scaled(c, 0.5).project_point(Vec3<double>(0.3, 0.2, 0))[0] ==
              doctest::Approx(c.project_point(Vec3<double>(0.3, 0.2, 0))[0] / 2).epsilon(1e-13));
    }
    const auto folds = with_lens(plain(), Lens64{-1.0 / 3, 0, 0, 0, 0});
    CHECK(std::isnan(folds.project_point(Vec3<double>(3.2, 0.2, 0))[0]));
    CHECK(folds.project_point(Vec3<double>(3.2, 0.2, 0))[2] == 3);
    CHECK(std::isnan(folds.ray(Vec2<double>(162 + 0.7 * 320, 118))[0]));
}
