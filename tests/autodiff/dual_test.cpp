// SPDX-License-Identifier: Apache-2.0
#include <rye/autodiff/dual.hpp>

#include <doctest/doctest.h>

#include <limits>

#include <rye/autodiff/check.hpp>
#include <rye/backend/lanes.hpp>
#include <rye/math/rotation.hpp>

using namespace rye;

namespace {

using D = Dual<double, 1>;
constexpr double inf = std::numeric_limits<double>::infinity();

template <class A, class B>
concept Multiplies = requires(A a, B b) { a * b; };

/// f'(x) by the dual against the central difference; f(x) against the plain formula, which the
/// compiler may have contracted.
template <class F>
void check_rule(F f, double x) {
    CAPTURE(x);
    const D y = f(D::variable(x));
    CHECK(std::abs(y.value - f(x)) <= 4e-16 * (1 + std::abs(f(x))));
    const double h = 6e-6;
    const double difference = (f(x + h) - f(x - h)) / (2 * h);
    CHECK(std::abs(y.d[0] - difference) <= 1e-8 * (1 + std::abs(difference)));
}

struct TagA {};
struct TagB {};

} // namespace

TEST_CASE("dual: every rule against central differences, every value the plain one") {
    for (const double x : {0.31, 0.77, 0.15}) {
        check_rule([](auto t) { using std::sqrt; return sqrt(t); }, x);
        check_rule([](auto t) { using std::exp; return exp(t); }, x);
        check_rule([](auto t) { using std::exp2; return exp2(t); }, x);
        check_rule([](auto t) { using std::expm1; return expm1(t); }, x);
        check_rule([](auto t) { using std::log; return log(t); }, x);
        check_rule([](auto t) { using std::log2; return log2(t); }, x);
        check_rule([](auto t) { using std::log1p; return log1p(t); }, x);
        check_rule([](auto t) { using std::sin; return sin(t); }, x);
        check_rule([](auto t) { using std::cos; return cos(t); }, x);
        check_rule([](auto t) { using std::tan; return tan(t); }, x);
        check_rule([](auto t) { using std::tanh; return tanh(t); }, x);
        check_rule([](auto t) { using std::asin; return asin(t); }, x);
        check_rule([](auto t) { using std::acos; return acos(t); }, x);
        check_rule([](auto t) { using std::atan; return atan(t); }, x);
        check_rule([](auto t) { using std::atan2; return atan2(t, decltype(t)(0.4)); }, x);
        check_rule([](auto t) { using std::atan2; return atan2(decltype(t)(-0.4), t); }, x);
        check_rule([](auto t) { using std::hypot; return hypot(t, decltype(t)(0.4)); }, x);
        check_rule([](auto t) { using std::pow; return pow(t, 2.5); }, x);
        check_rule([](auto t) { using std::pow; return pow(decltype(t)(1.7), t); }, x);
        check_rule([](auto t) { using std::abs; return abs(t - 1) * t; }, x);
        check_rule([](auto t) { return t / (1 + t) - t * t + 1 / t; }, x);
    }
}

TEST_CASE("dual: powers at the edge (H2)") {
    CHECK(pow(D::variable(0), 2.0).d[0] == 0);
    CHECK(pow(D::variable(0), 1.0).d[0] == 1);
    CHECK(pow(D::variable(0), 0.0).value == 1);
    CHECK(pow(D::variable(0), 0.0).d[0] == 0);
    CHECK_FALSE(std::isfinite(pow(D::variable(0), 0.5).d[0]));
    CHECK(pow(D::variable(-2), 3.0).value == -8);
    CHECK(pow(D::variable(-2), 3.0).d[0] == 12);
    CHECK(std::isnan(pow(D::variable(-2), 0.5).value));
    CHECK(pow(D(0), D::variable(2)).value == 0);     // 0^g stays 0 as g moves
    CHECK(pow(D(0), D::variable(2)).d[0] == 0);
    CHECK_FALSE(std::isfinite(pow(D::variable(0), D(0.5)).d[0]));
    CHECK_FALSE(std::isfinite(pow(D(-2), D::variable(3)).d[0]));
    CHECK(pow(D(-2), D(3)).value == -8);
    CHECK(pow(D(-2), D(3)).d[0] == 0);
}

TEST_CASE("dual: a zero seed stays zero at a singularity, another does not (H3)") {
    CHECK(sqrt(D(0)).d[0] == 0);
    CHECK(acos(D(1)).d[0] == 0);
    CHECK(asin(D(-1)).d[0] == 0);
    CHECK(log(D(0)).d[0] == 0);
    CHECK(sqrt(D::variable(0)).d[0] == inf);
    CHECK(acos(D::variable(1)).d[0] == -inf);
}

TEST_CASE("dual: ties of min, max and |x| take the average (H4, F10)") {
    const D x = D::variable(2), c(2);
    CHECK(min(x, c).d[0] == 0.5);
    CHECK(max(x, c).d[0] == 0.5);
    CHECK(min(c, x).d[0] == min(x, c).d[0]);
    CHECK(max(c, x).d[0] == max(x, c).d[0]);
    CHECK(abs(D::variable(0)).d[0] == 0);
    CHECK(abs(D::variable(-3)).d[0] == -1);
}

TEST_CASE("dual: atan2 and hypot at the origin (H5)") {
    CHECK(atan2(D::variable(0), D(0)).d[0] == 0);
    CHECK(hypot(D::variable(0), D(0)).d[0] == 0);
    CHECK(atan2(D::variable(0), D(0)).value == 0);
}

TEST_CASE("dual: nested derivatives are not confused (H6)") {
    const auto outer = [](auto x) {
        return x * derivative([&](auto y) { return x * y; }, decltype(x)(1));
    };
    CHECK(derivative(outer, 4.0) == 8);
    static_assert(!Multiplies<Dual<double, 1, TagA>, Dual<double, 1, TagB>>);
    static_assert(Multiplies<Dual<double, 1, TagA>, double>);
    static_assert(Multiplies<D, Dual<D, 1>>);
}

TEST_CASE("dual: second derivatives, where the first is 0 too") {
    // f = sin(x y): at x = 0 the tangent by y has value 0 but not derivative 0.
    using DD = Dual<D, 1>;
    for (const double x : {0.0, 0.7}) {
        const double y = 1.3;
        DD xx(D::variable(x)), yy;
        yy = DD::variable(D(y));
        const DD f = sin(xx * yy);
        CHECK(f.value.value == std::sin(x * y));
        CHECK(f.d[0].value == doctest::Approx(x * std::cos(x * y)));
        CHECK(f.d[0].d[0] == doctest::Approx(std::cos(x * y) - x * y * std::sin(x * y)));
    }
    const auto cube = [](auto t) { return t * t * t * t; };
    const auto second = [&](auto t) { return derivative(cube, t); };
    CHECK(derivative(second, 0.5) == doctest::Approx(12 * 0.25).epsilon(1e-14));
    // The Hessian of |x|^3 / 3 is |x| (I + n n^T).
    const Vec3<double> at(0.3, -0.5, 0.8);
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            Vec3<DD> v;
            for (int k = 0; k < 3; ++k) {
                v[k] = DD(D(at[k]));
                if (k == i) v[k].value.d[0] = 1;
                if (k == j) v[k].d[0] = D(1);
            }
            const DD n = norm(v), f = n * n * n / DD(3);
            const double r = at.norm();
            CHECK(f.d[0].d[0] ==
                  doctest::Approx((i == j ? r : 0) + at[i] * at[j] / r).epsilon(1e-13));
        }
}

TEST_CASE("dual: branches are on values only (H7)") {
    const D a = D::variable(1), b(1);
    CHECK(a == b);
    CHECK_FALSE(a < b);
    CHECK(select(a < D(2), a, b).d[0] == 1);
    CHECK(D(-0.0) == D(0.0));
    CHECK(value_of(Dual<D, 2>(a)) == 1.0);
}

TEST_CASE("dual: matrices of duals multiply") {
    const Columns<double> a = random_columns<double>(3, 4, {1});
    const Columns<double> da = random_columns<double>(3, 4, {2});
    const Columns<double> b = random_columns<double>(4, 5, {3});
    const Columns<D> y = detail::seeded(a, da) * b.cast<D>();
    CHECK((values_of(y) - a * b).cwiseAbs().maxCoeff() <= 1e-15);
    CHECK((tangents_of(y) - da * b).cwiseAbs().maxCoeff() <= 4e-15);
}

TEST_CASE("dual: of lanes") {
    using Batch = XsimdBackend<>::batch<float>;
    using F = Dual<float, 1>;
    using L = Dual<Batch, 1>;
    const auto f = [](const auto& x) {
        using T = std::decay_t<decltype(x)>;
        using std::abs, std::exp, std::max, std::sqrt;
        return T(max(sqrt(abs(x) + T(1)) * exp(-x), x * x) / (T(2) + x));
    };
    for (const float x : {-1.5f, 0.0f, 0.3f, 2.0f}) {
        const F s = f(F::variable(x));
        const L l = f(L::variable(Batch(x)));
        CHECK(std::abs(l.value.get(2) - s.value) <= 4e-7f * (1 + std::abs(s.value)));
        CHECK(std::abs(l.d[0].get(2) - s.d[0]) <= 1e-6f * (1 + std::abs(s.d[0])));
    }
}
