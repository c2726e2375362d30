// SPDX-License-Identifier: Apache-2.0
#include <rye/math/scalar.hpp>

#include <doctest/doctest.h>

#include <limits>

#include <rye/autodiff/dual.hpp>
#include <rye/backend/lanes.hpp>

#include "../support/flush_to_zero.hpp"

using namespace rye;

TEST_CASE("scalar: sigmoid and softplus over the whole range of floats (F1, F2)") {
    const double least = flushed() ? 0x1p-126 : 1e-45;  // below it: 0, or the nearest denormal
    for (float x = -100; x <= 100; x += 0.0937f) {
        const double truth = 1 / (1 + std::exp(-double(x)));
        CHECK(std::abs(double(sigmoid(x)) - truth) <= 2.4e-7 * truth + least);
        const double plus = std::log1p(std::exp(-std::abs(double(x)))) + std::max(double(x), 0.);
        CHECK(std::abs(double(softplus(x)) - plus) <= 2.4e-7 * plus + least);
    }
    CHECK(sigmoid(-200.0f) == 0.0f);
    CHECK(sigmoid(200.0f) == 1.0f);
    CHECK(softplus(-20.0f) > 0.0f);
}

TEST_CASE("scalar: logit undoes sigmoid") {
    for (double x = -15; x <= 15; x += 0.37)
        CHECK(logit(sigmoid(x)) == doctest::Approx(x).epsilon(1e-9));
}

TEST_CASE("scalar: duals of sigmoid and softplus, at 0 too") {
    using D = Dual<double, 1>;
    for (const double x : {-30., -1., 0., 1e-9, 2., 30.}) {
        const double s = sigmoid(x);
        CHECK(sigmoid(D::variable(x)).d[0] == doctest::Approx(s * sigmoid(-x)).epsilon(1e-12));
        CHECK(softplus(D::variable(x)).d[0] == doctest::Approx(s).epsilon(1e-12));
    }
}

TEST_CASE("scalar: clamp has half a derivative at its ends") {
    using D = Dual<double, 1>;
    const D lo(0), hi(1);
    CHECK(clamp_value(D::variable(0.5), lo, hi).d[0] == 1);
    CHECK(clamp_value(D::variable(1.5), lo, hi).d[0] == 0);
    CHECK(clamp_value(D::variable(-2.0), lo, hi).d[0] == 0);
    CHECK(clamp_value(D::variable(1.0), lo, hi).d[0] == 0.5);
    CHECK(clamp_value(D::variable(0.0), lo, hi).d[0] == 0.5);
}

TEST_CASE("scalar: the same in lanes") {
    using Batch = XsimdBackend<>::batch<float>;
    for (float x = -30; x < 30; x += 1.7f) {
        CHECK(std::abs(sigmoid(Batch(x)).get(1) - sigmoid(x)) <= 2e-7f);
        CHECK(std::abs(softplus(Batch(x)).get(1) - softplus(x)) <= 4e-7f * (1 + softplus(x)));
    }
    static_assert(constant<float>(0.1) == 0.1f);
}
