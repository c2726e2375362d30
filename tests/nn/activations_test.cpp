// SPDX-License-Identifier: Apache-2.0
#include <rye/avatar/field.hpp>

#include <doctest/doctest.h>

#include "../support/laws.hpp"

using namespace rye;

TEST_CASE_TEMPLATE("activations: a squash of one number is that of an array, and so its slope", T,
                   float, double) {
    const Columns<T> v = T(4) * random_columns<T>(3, 40, 1), ones = Columns<T>::Ones(3, 40);
    for (const Squash squash : {Squash::none, Squash::tanh, Squash::sigmoid}) {
        Columns<T> y = v, slope = ones;
        detail::squash_in_place(squash, y);
        detail::squash_vjp(squash, y, slope);
        T worst(0), worst_slope(0);
        for (Index i = 0; i < v.size(); ++i) {
            worst = std::max(worst, std::abs(detail::squash_value(squash, v(i)) - y(i)));
            worst_slope =
                std::max(worst_slope, std::abs(detail::squash_slope(squash, y(i)) - slope(i)));
        }
        CHECK(worst <= 4 * std::numeric_limits<T>::epsilon());  // Eigen's vectors of float tanh
        CHECK(worst_slope <= 2 * std::numeric_limits<T>::epsilon());
    }
}

TEST_CASE("activations: a squash has the slope that duals have") {
    for (const double v : {-3.0, -0.1, 0.0, 0.7, 5.0})
        for (const Squash squash : {Squash::none, Squash::tanh, Squash::sigmoid}) {
            const auto y = detail::squash_value(squash, Dual<double, 1>::variable(v));
            CHECK(detail::squash_slope(squash, y.value) == doctest::Approx(y.d[0]).epsilon(1e-14));
        }
}
