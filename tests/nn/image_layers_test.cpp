// SPDX-License-Identifier: Apache-2.0
#include <rye/nn/bilinear.hpp>
#include <rye/nn/instance_norm.hpp>

#include <doctest/doctest.h>

#include <rye/backend/lanes.hpp>
#include <rye/backend/scalar.hpp>

#include "../support/laws.hpp"

using namespace rye;

using B = XsimdBackend<>;

TEST_CASE("bilinear: doubling a ramp gives a ramp between the same corners") {
    Image<double> in(5, 3, 2);
    for (int y = 0; y < 3; ++y)
        for (int x = 0; x < 5; ++x) in.at(x, y) << x, 10 * y;
    const Image<double> out = doubled(B{}, in);
    REQUIRE(out.width == 10);
    REQUIRE(out.height == 6);
    for (int y = 0; y < 6; ++y)
        for (int x = 0; x < 10; ++x) {
            CHECK(out.at(x, y)(0) == doctest::Approx(x * 4.0 / 9.0));
            CHECK(out.at(x, y)(1) == doctest::Approx(10 * y * 2.0 / 5.0));
        }
}

TEST_CASE("bilinear: one pixel becomes four of the same, and no pixels none") {
    CHECK(doubled(B{}, Image<float>(1, 1, 3, 0.7f)).pixels == Columns<float>::Constant(3, 4, 0.7f));
    CHECK(doubled(B{}, Image<float>(0, 0, 3)).pixels.size() == 0);
}

TEST_CASE("bilinear: the vjp is the adjoint") {
    for (const auto& [w, h] : {std::pair(5, 4), {1, 6}, {1, 1}, {37, 19}}) {
        Image<double> in(w, h, 3), g(2 * w, 2 * h, 3);
        in.pixels = random_columns<double>(3, in.size(), 1);
        g.pixels = random_columns<double>(3, g.size(), 2);
        DotProducts dots;
        dots.add_forward(doubled(B{}, in).pixels, g.pixels);
        dots.add_reverse(doubled_vjp(B{}, g).pixels, in.pixels);
        CHECK(dots.error() < 1e-15);
    }
}

TEST_CASE("instance norm: mean 0 and variance 1, whatever the offset; constants become 0") {
    Columns<float> x = random_columns<float>(3, 5000, 1);
    x.row(1).array() += 100.0f;
    x.row(2).setConstant(5.0f);
    const VecX<float> gain = instance_norm(B{}, x);
    const Columns<double> y = x.cast<double>();
    CHECK(y.rowwise().mean().cwiseAbs().maxCoeff() < 1e-4);
    CHECK(y.row(0).cwiseAbs2().mean() == doctest::Approx(1).epsilon(1e-4));
    CHECK(y.row(1).cwiseAbs2().mean() == doctest::Approx(1).epsilon(1e-4));
    CHECK(y.row(2).isZero(0));
    CHECK(gain(2) == doctest::Approx(1 / std::sqrt(1e-5)));
}

TEST_CASE_TEMPLATE("instance norm: the vjp is the adjoint of the forward derivative", T, float,
                   double) {
    for (const double spread : {1.0, 1e-3, 100.0}) {
        const Columns<T> x = T(spread) * random_columns<T>(4, 600, 1),
                         dx = random_columns<T>(4, 600, 2);
        const Columns<T> g = random_columns<T>(4, 600, 3);
        Columns<Dual<T, 1>> xd = lifted(x, dx);
        instance_norm(ScalarBackend<>{}, xd);
        Columns<T> y = x, gx = g;
        const VecX<T> gain = instance_norm(B{}, y);
        instance_norm_vjp(B{}, y, gain, gx);
        DotProducts dots;
        dots.add_forward(tangents(xd), g);
        dots.add_reverse(gx, dx);
        CHECK(dots.error() < (std::is_same_v<T, double> ? 1e-14 : 2e-6));
    }
}
