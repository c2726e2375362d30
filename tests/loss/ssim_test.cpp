// SPDX-License-Identifier: Apache-2.0
#include <rye/loss/ssim.hpp>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>

#include "../support/random.hpp"

using namespace rye;

namespace {

using B = ScalarBackend<>;
const Columns<double> no_mask;

/// The published formula, window by window, with the window's own mean taken off first.
double plain_ssim(const Image<double>& a, const Image<double>& b, int x0, int y0, int channel) {
    double w[11], norm = 0;
    for (int i = 0; i < 11; ++i) norm += w[i] = std::exp(-(i - 5) * (i - 5) / (2 * 1.5 * 1.5));
    double mx = 0, my = 0, xx = 0, yy = 0, xy = 0;
    const auto each = [&](const auto& f) {
        for (int j = 0; j < 11; ++j)
            for (int i = 0; i < 11; ++i)
                f(w[i] * w[j] / (norm * norm), a.at(x0 + i, y0 + j)(channel),
                  b.at(x0 + i, y0 + j)(channel));
    };
    each([&](double k, double p, double q) { mx += k * p, my += k * q; });
    each([&](double k, double p, double q) {
        xx += k * (p - mx) * (p - mx), yy += k * (q - my) * (q - my), xy += k * (p - mx) * (q - my);
    });
    return (2 * mx * my + 1e-4) * (2 * xy + 9e-4) / ((mx * mx + my * my + 1e-4) * (xx + yy + 9e-4));
}

} // namespace

TEST_CASE("ssim: equals the published formula over all windows inside") {
    const Image<double> a = random_photograph(20, 17, 3, 1);
    Image<double> b = random_photograph(20, 17, 3, 2);
    b.pixels = 0.7 * a.pixels + 0.3 * b.pixels;
    double sum = 0;
    for (int y = 0; y < 7; ++y)
        for (int x = 0; x < 10; ++x)
            for (int c = 0; c < 3; ++c) sum += plain_ssim(a, b, x, y, c);
    CHECK(ssim(B{}, a, b, no_mask) == doctest::Approx(sum / 210).epsilon(1e-12));
    Columns<double> mask = Columns<double>::Zero(1, a.size());
    mask((3 + 5) * 20 + 4 + 5) = 0.5;
    const double one =
        (plain_ssim(a, b, 4, 3, 0) + plain_ssim(a, b, 4, 3, 1) + plain_ssim(a, b, 4, 3, 2)) / 3;
    CHECK(ssim(B{}, a, b, mask) == doctest::Approx(one).epsilon(1e-12));
}

TEST_CASE("ssim: equal images give exactly 1, nothing gives more") {
    for (const double offset : {0.0, 0.5, 100.0}) {
        Image<double> a = random_photograph(40, 30, 3, 1);
        a.pixels = (1e-3 * a.pixels.array() + offset).matrix();
        CHECK(ssim(B{}, a, a, no_mask) == 1.0);
        Image<double> b = a;
        b.pixels.array() += 1e-9;
        CHECK(ssim(B{}, a, b, no_mask) <= 1.0);
    }
    CHECK(ssim(B{}, Image<float>(11, 11, 1, 0.3f), Image<float>(11, 11, 1, 0.3f), {}) == 1.0);
    CHECK(ssim(B{}, Image<float>(11, 11, 1, 1.0f), Image<float>(11, 11, 1, 0.0f), {}) ==
          doctest::Approx(1e-4 / (1 + 1e-4)));
    CHECK(ssim(B{}, random_photograph(12, 12, 1, 1), random_photograph(12, 12, 1, 2),
               Columns<double>::Zero(1, 144)) == 1.0);
}

TEST_CASE("ssim: symmetric, and the same bits with any kind of threads") {
    const Image<double> a = random_photograph(60, 50, 3, 1), b = random_photograph(60, 50, 3, 2);
    CHECK(ssim(B{}, a, b, no_mask) == ssim(B{}, b, a, no_mask));
    CHECK(ssim(B{}, a, b, no_mask) == ssim(ScalarBackend<Serial>{}, a, b, no_mask));
}

TEST_CASE("ssim: images too small or of different shapes are refused") {
    CHECK_THROWS_AS(ssim(B{}, Image<float>(10, 20, 3), Image<float>(10, 20, 3), {}), Error);
    CHECK_THROWS_AS(ssim(B{}, Image<float>(20, 20, 3), Image<float>(20, 21, 3), {}), Error);
    CHECK_THROWS_AS(
        ssim(B{}, Image<float>(20, 20, 3), Image<float>(20, 20, 3), Columns<float>(1, 9)), Error);
}
