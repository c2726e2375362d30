// SPDX-License-Identifier: Apache-2.0
// rye/math/levenberg.hpp: least squares by damped Gauss-Newton steps.
#include <cmath>
#include <limits>
#include <string>

#include <doctest/doctest.h>

#include <rye/math/levenberg.hpp>

using namespace rye;

namespace {

/// Sums of squares of residuals r(x) with the Jacobian J(x).
template <class T, class R, class J>
auto squares_of(R residuals, J jacobian) {
    const auto linearized = [=](const VecX<T>& x) {
        const VecX<T> r = residuals(x);
        const Columns<T> j = jacobian(x);
        return NormalEquations<T>{r.squaredNorm(), j.transpose() * j, j.transpose() * r};
    };
    const auto cost = [=](const VecX<T>& x) -> T { return residuals(x).squaredNorm(); };
    return std::pair(linearized, cost);
}

template <class T>
VecX<T> vector_of(T a, T b) {
    VecX<T> x(2);
    x << a, b;
    return x;
}

/// Rosenbrock's valley: (1 - x)^2 + 100 (y - x^2)^2, least at (1, 1).
template <class T>
auto valley() {
    return squares_of<T>(
        [](const VecX<T>& x) { return vector_of<T>(T(1) - x[0], T(10) * (x[1] - x[0] * x[0])); },
        [](const VecX<T>& x) {
            Columns<T> j(2, 2);
            j << T(-1), T(0), T(-20) * x[0], T(10);
            return j;
        });
}

} // namespace

TEST_CASE_TEMPLATE("levenberg: a quadratic is solved in one step without damping", T, float,
                   double) {
    Columns<T> a(3, 2);
    a << T(1), T(2), T(0), T(3), T(-1), T(1);
    const VecX<T> right = vector_of<T>(T(0.5), T(-2));
    const auto [linearized, cost] =
        squares_of<T>([=](const VecX<T>& x) -> VecX<T> { return a * (x - right); },
                      [=](const VecX<T>&) { return a; });
    LevenbergSettings settings;
    settings.damping = 0;
    settings.steps = 1;
    const auto r = levenberg<T>(vector_of<T>(T(7), T(9)), settings, linearized, cost);
    CHECK(r.steps == 1);
    CHECK(r.refused == 0);
    CHECK((r.x - right).norm() <= T(20) * std::numeric_limits<T>::epsilon());
    // Residuals of variance 1: (A^T A)^-1.
    const Columns<T> c = covariance<T>(r.at.matrix);
    CHECK((c * a.transpose() * a - Columns<T>::Identity(2, 2)).norm() <=
          T(100) * std::numeric_limits<T>::epsilon());
}

TEST_CASE("levenberg: in a bent valley steps are damped, never up, and end at the bottom") {
    const auto [linearized, cost] = valley<double>();
    LevenbergSettings settings;
    settings.steps = 60;
    settings.tolerance = 1e-14;
    double last = std::numeric_limits<double>::infinity();
    const auto watched = [&, at = linearized](const VecX<double>& x) {
        const auto n = at(x);
        CHECK(n.cost <= last);
        last = n.cost;
        return n;
    };
    const auto r = levenberg<double>(vector_of(-1.2, 1.0), settings, watched, cost);
    CHECK(r.refused > 0);
    CHECK(r.first_cost == doctest::Approx(24.2));
    CHECK((r.x - vector_of(1.0, 1.0)).norm() < 1e-6);
}

TEST_CASE("levenberg: a trial that is not finite is refused; a start that is not is a fault") {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    // log(x)^2: the undamped step from 3 leads below 0.
    const auto [linearized, cost] = squares_of<double>(
        [](const VecX<double>& x) -> VecX<double> { return x.array().log().matrix(); },
        [](const VecX<double>& x) -> Columns<double> { return x.cwiseInverse().asDiagonal(); });
    const auto r = levenberg<double>(VecX<double>::Constant(1, 3.0), {}, linearized, cost);
    CHECK(r.refused > 0);
    CHECK(r.x[0] == doctest::Approx(1).epsilon(1e-3));
    const auto message = [&](double start) -> std::string {
        try {
            levenberg<double>(VecX<double>::Constant(1, start), {}, linearized, cost);
        } catch (const Error& e) {
            return e.what();
        }
        return "";
    };
    CHECK(message(nan).find("levenberg: step 0: the sum of squares is nan") == 0);
    CHECK(message(-1).find("the sum of squares is") != std::string::npos);
}

TEST_CASE("covariance: a matrix that is not positive definite is a fault") {
    CHECK_THROWS_AS(covariance<double>(-Columns<double>::Identity(2, 2)), Error);
}
