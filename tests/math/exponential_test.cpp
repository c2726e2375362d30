// SPDX-License-Identifier: Apache-2.0
#include <rye/math/exponential.hpp>

#include <doctest/doctest.h>

#include <limits>

#include <rye/autodiff/dual.hpp>
#include <rye/backend/lanes.hpp>

using namespace rye;


TEST_CASE_TEMPLATE("exponential: the stated error holds, and is not stated too high (B17)", E,
                   Exp2Poly<3>, Exp2Poly<4>, Exp2Poly<5>, Exp2Poly<6>) {
    const E exp2;
    double worst = 0;
    // Every 97th float from -126 to -2^-30, and every 1009th above 0.
    for (std::uint32_t bits = 0xB0800000u; bits < 0xC2FC0000u; bits += 97) {
        const float x = std::bit_cast<float>(bits);
        const double truth = std::exp2(double(x));
        worst = std::max(worst, std::abs(double(exp2(x)) / truth - 1));
    }
    for (std::uint32_t bits = 0x30800000u; bits < 0x42FC0000u; bits += 1009) {
        const float x = std::bit_cast<float>(bits);
        worst = std::max(worst, std::abs(double(exp2(x)) / std::exp2(double(x)) - 1));
    }
    CHECK(worst <= E::max_relative_error);
    CHECK(worst >= 0.75 * E::max_relative_error);  // with fused products it is a fifth smaller
}

TEST_CASE("exponential: what is not a number is transparent, on every backend (B9)") {
    using Batch = XsimdBackend<>::batch<float>;
    const Exp2Poly<5> exp2;
    const float inf = std::numeric_limits<float>::infinity();
    for (const float x : {std::numeric_limits<float>::quiet_NaN(), -inf, -1000.0f, -126.5f}) {
        CHECK(exp2(x) == doctest::Approx(0x1p-126).epsilon(1e-6));
        CHECK(exp2(Batch(x)).get(0) == exp2(x));
    }
    for (float x = -20; x < 20; x += 0.37f)
        CHECK(std::abs(exp2(Batch(x)).get(3) / exp2(x) - 1) <= 2.4e-7f);
}

TEST_CASE("exponential: whole powers, doubles and duals") {
    CHECK(Exp2Poly<6>{}(0.0f) == 1.0f);
    CHECK(Exp2Poly<6>{}(-10.0f) == 0x1p-10f);
    CHECK(Exp2Poly<6>{}(-3.7) == doctest::Approx(std::exp2(-3.7)).epsilon(1e-7));
    using D = Dual<double, 1>;
    const D y = Exp2Poly<5>{}(D::variable(-1.3));
    CHECK(y.value == Exp2Poly<5>{}(-1.3));
    CHECK(y.d[0] == doctest::Approx(ln_2 * y.value).epsilon(1e-15));
    CHECK(Exp2Library{}(-1.5) == std::exp2(-1.5));
}
