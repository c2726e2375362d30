// SPDX-License-Identifier: Apache-2.0
#include <rye/loss/photometric.hpp>

#include <doctest/doctest.h>

#include <rye/autodiff/dual.hpp>
#include <rye/backend/scalar.hpp>

#include "../support/random.hpp"

using namespace rye;

using B = ScalarBackend<>;

namespace {

const Columns<double> no_mask;

} // namespace

TEST_CASE("l1: divides by all pixels and channels, whatever the mask") {
    Columns<double> a(2, 2), b(2, 2), mask(1, 2);
    a << 1, 2, 3, 4;
    b << 0, 2, 5, 0;
    mask << 1, 0.5;
    const LossGradient<double> loss = masked_l1(B{}, a, b, mask);
    CHECK(loss.value == doctest::Approx((1 + 0 + 2 + 2) / 4.0));
    Columns<double> expected(2, 2);
    expected << 0.25, 0, -0.25, 0.125;
    CHECK(loss.gradient == expected);
    CHECK(masked_l1(B{}, a, b, no_mask).value == doctest::Approx((1 + 0 + 2 + 4) / 4.0));
}

TEST_CASE("l1: the gradient is that of duals") {
    const Columns<double> a = random_pixels(3, 500, 1), b = random_pixels(3, 500, 2);
    const Columns<double> mask = random_pixels(1, 500, 3), da = random_pixels(3, 500, 4);
    using D = Dual<double, 1>;
    const Columns<D> ad = a.binaryExpr(da, [](double x, double dx) {
        D d(x);
        d.d[0] = dx;
        return d;
    });
    const auto constant = [](double x) { return D(x); };
    const Columns<D> md = mask.unaryExpr(constant);
    const D value = masked_l1(B{}, ad, b.unaryExpr(constant), md).value;
    const LossGradient<double> loss = masked_l1(B{}, a, b, mask);
    CHECK(value.value == doctest::Approx(loss.value).epsilon(1e-14));
    CHECK(value.d[0] == doctest::Approx(loss.gradient.cwiseProduct(da).sum()).epsilon(1e-13));
}

TEST_CASE("l1: float stays near double over many pixels, and an empty image is 0") {
    const Columns<double> a = random_pixels(3, 200000, 1), b = random_pixels(3, 200000, 2);
    const double exact = masked_l1(B{}, a, b, no_mask).value;
    const float value = masked_l1(B{}, a.cast<float>(), b.cast<float>(), Columns<float>()).value;
    CHECK(value == doctest::Approx(exact).epsilon(1e-5));
    CHECK(masked_l1(B{}, Columns<double>(3, 0), Columns<double>(3, 0), no_mask).value == 0);
}

TEST_CASE("psnr: a known error, equal images, and pixels out of the mask") {
    const Columns<double> a = random_pixels(3, 400, 1);
    Columns<double> b = a.array() + 0.1;
    CHECK(psnr(a, b, no_mask) == doctest::Approx(20.0));
    CHECK(psnr(a, b, no_mask, 255.0) == doctest::Approx(20.0 + 20.0 * std::log10(255.0)));
    CHECK(psnr(a, a, no_mask) == std::numeric_limits<double>::infinity());
    Columns<double> mask = Columns<double>::Ones(1, 400);
    mask(7) = 0;
    b.col(7).setConstant(NAN);
    CHECK(psnr(a, b, mask) == doctest::Approx(20.0));
    CHECK(mean_squared_error(a, b, Columns<double>(Columns<double>::Zero(1, 400))) == 0);
}

TEST_CASE("photometric: images of different shapes are refused") {
    const Columns<double> a(3, 4), b(3, 5);
    CHECK_THROWS_AS(masked_l1(B{}, a, b, no_mask), Error);
    CHECK_THROWS_AS(psnr(a, a, b), Error);
}
