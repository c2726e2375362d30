// SPDX-License-Identifier: Apache-2.0
#include <rye/nn/encoding.hpp>

#include <doctest/doctest.h>

#include "../support/laws.hpp"

using namespace rye;

TEST_CASE("encoding: the value written out for one number, and 27 values for a point") {
    const Columns<double> x = Columns<double>::Constant(1, 1, 0.5);
    const Columns<double> y = positional_encoding(x);
    const double expected[] = {0.5,           std::sin(0.5), std::cos(0.5),
                               std::sin(1.0), std::cos(1.0), std::sin(2.0),
                               std::cos(2.0), std::sin(4.0), std::cos(4.0)};
    REQUIRE(y.size() == 9);
    for (Index i = 0; i < 9; ++i) CHECK(y(i) == doctest::Approx(expected[i]).epsilon(1e-15));
    CHECK(positional_encoding(random_columns<float>(3, 4, 1)).rows() == 27);
    CHECK(positional_encoding(random_columns<float>(6, 1, 1)).rows() == 54);
    CHECK(positional_encoding(random_columns<float>(3, 4, 1), 0) == random_columns<float>(3, 4, 1));
}

TEST_CASE("encoding: blocks hold the whole vector") {
    const Columns<double> x = random_columns<double>(3, 5, 1);
    const Columns<double> y = positional_encoding(x, 2);
    CHECK(y.middleRows(3, 3).isApprox(x.array().sin().matrix(), 1e-15));
    CHECK(y.middleRows(12, 3).isApprox((2 * x).array().cos().matrix(), 1e-15));
}

TEST_CASE("encoding: float agrees with double to 1e-6 up to frequency 2^10 and |x| = 4") {
    const Columns<float> x = 4.0f * random_columns<float>(1, 20000, 1);
    const Columns<float> y = positional_encoding(x, 11);
    const Columns<double> exact = positional_encoding(x.cast<double>().eval(), 11);
    CHECK((y.cast<double>() - exact).cwiseAbs().maxCoeff() < 1e-6);
}

TEST_CASE_TEMPLATE("encoding: the vjp is the adjoint of the forward derivative", T, float, double) {
    for (const double size : {1.0, 1e-8, 1e3}) {
        const Columns<T> x = T(size) * random_columns<T>(6, 40, 1),
                         dx = random_columns<T>(6, 40, 2);
        const Columns<Dual<T, 1>> y = positional_encoding(lifted(x, dx));
        const Columns<T> w = random_columns<T>(y.rows(), y.cols(), 3);
        DotProducts dots;
        dots.add_forward(tangents(y), w);
        dots.add_reverse(positional_encoding_vjp(positional_encoding(x), w), dx);
        CHECK(dots.error() < (std::is_same_v<T, double> ? 1e-14 : 2e-6));
    }
}

TEST_CASE_TEMPLATE("encoding: number by number as by whole arrays, and so the vjp", T, float, double,
                   Dual<double, 1>) {
    using R = real_t<T>;
    const Columns<T> x = (R(3) * random_columns<R>(3, 50, 1)).template cast<T>();
    const Columns<T> y = positional_encoding(x), g = random_columns<R>(y.rows(), 50, 2)
                                                         .template cast<T>();
    const Columns<T> gx = positional_encoding_vjp(y, g);
    Columns<T> one(y.rows(), 50);
    double worst = 0, worst_vjp = 0;
    for (Index j = 0; j < 50; ++j)
        for (Index i = 0; i < 3; ++i) {
            detail::encode_number(x(i, j), detail::default_frequencies, 3, &one(i, j));
            const T vjp =
                detail::encode_number_vjp(&y(i, j), &g(i, j), detail::default_frequencies, 3);
            worst_vjp = std::max(worst_vjp, double(std::abs(value_of(T(vjp - gx(i, j))))));
        }
    for (Index i = 0; i < y.size(); ++i)
        worst = std::max(worst, double(std::abs(value_of(T(one(i) - y(i))))));
    const double epsilon = double(std::numeric_limits<R>::epsilon());
    CHECK(worst <= 2 * epsilon);      // Eigen's vectors of float sines round differently
    CHECK(worst_vjp <= 32 * epsilon); // products may be fused
}
