// SPDX-License-Identifier: Apache-2.0
#include <rye/loss/perceptual.hpp>

#include <doctest/doctest.h>

#include <rye/autodiff/dual.hpp>

#include "../support/random.hpp"

using namespace rye;

namespace {

struct ValueOnly {
    template <class T>
    T operator()(const Image<T>&, const Image<T>&) const {
        return T(0);
    }
};
static_assert(!PerceptualLoss<ValueOnly>);

} // namespace

TEST_CASE("pyramid gradient: constants do not count, and an edge counts on every level") {
    const PyramidGradientLoss loss;
    Image<double> a(16, 16, 1, 0.7);
    const Image<double> b(16, 16, 1, 0.2);
    CHECK(loss(ScalarBackend{}, a, b).value == 0);
    CHECK(loss(ScalarBackend{}, a, b).gradient.isZero(0));
    for (int y = 0; y < 16; ++y)
        for (int x = 8; x < 16; ++x) a.at(x, y).array() += 0.3;
    // One of w - 1 differences of each row, on widths 16, 8 and 4.
    CHECK(loss(ScalarBackend{}, a, b).value ==
          doctest::Approx(0.3 * (1.0 / 15 + 1.0 / 7 + 1.0 / 3)));
    const PyramidGradientLoss coarse{{0, 0, 2}};
    CHECK(coarse(ScalarBackend{}, a, b).value == doctest::Approx(2 * 0.3 / 3));
}

TEST_CASE("pyramid gradient: the gradient is that of duals, also for odd and thin images") {
    using D = Dual<double, 1>;
    for (const auto& [w, h] : {std::pair(37, 50), {16, 16}, {5, 3}, {1, 9}, {1, 1}}) {
        const Image<double> a = random_photograph(w, h, 3, 1), b = random_photograph(w, h, 3, 2);
        const Image<double> da = random_photograph(w, h, 3, 3);
        Image<D> ad(w, h, 3), bd(w, h, 3);
        ad.pixels = a.pixels.binaryExpr(da.pixels, [](double x, double dx) {
            D d(x);
            d.d[0] = dx;
            return d;
        });
        bd.pixels = b.pixels.unaryExpr([](double x) { return D(x); });
        const D value = PyramidGradientLoss()(ScalarBackend{}, ad, bd).value;
        const LossGradient<double> loss = PyramidGradientLoss()(ScalarBackend{}, a, b);
        const double reverse = loss.gradient.cwiseProduct(da.pixels).sum();
        CHECK(value.value == doctest::Approx(loss.value).epsilon(1e-13));
        CHECK(std::abs(value.d[0] - reverse) <= 1e-13 * (1 + std::abs(reverse)));
    }
}

TEST_CASE("pyramid gradient: the same bits with any kind of threads") {
    const Image<double> a = random_photograph(90, 70, 3, 1), b = random_photograph(90, 70, 3, 2);
    const auto serial = PyramidGradientLoss()(ScalarBackend<Serial>{}, a, b);
    const auto parallel = PyramidGradientLoss()(ScalarBackend<DefaultThreads>{}, a, b);
    CHECK(serial.value == parallel.value);
    CHECK(serial.gradient == parallel.gradient);
}

TEST_CASE("pyramid gradient: images of different shapes are refused") {
    CHECK_THROWS_AS(
        PyramidGradientLoss()(ScalarBackend{}, random_photograph(4, 4, 3, 1), random_photograph(4, 5, 3, 1)),
        Error);
}
