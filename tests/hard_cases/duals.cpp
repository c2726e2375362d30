// SPDX-License-Identifier: Apache-2.0
// Derivatives at singular points, ties, and within derivatives (H1-H10).
#include <cfenv>
#include <limits>

#include <rye/autodiff/check.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/influence.hpp>

#include "report.hpp"

namespace rye::hard {
namespace {

/// Number of the kind S, its dual seeded with 1, and the parts.
template <class S>
Dual<S, 1> seeded_at(double x, double seed = 1) {
    Dual<S, 1> d(S(static_cast<real_t<S>>(x)));
    d.d[0] = S(static_cast<real_t<S>>(seed));
    return d;
}

template <class S>
void h1_h3_h4_h5(Report& report) {
    using D = Dual<S, 1>;
    const auto slope = [](const D& d) { return first(d.d[0]); };
    // H1: both sides of a choice are evaluated, so the argument is made safe before the root.
    const D zero = seeded_at<S>(0);
    const Vec3<D> none(zero, zero, zero);
    const Vec3<D> n = normalized(none);
    report.holds("H1", kind_of<S>(), "normalise 0: value 0, derivative 0, not 0 inf",
                 slope(n[0]) == 0 && first(n[0].value) == 0);
    using std::sqrt;
    const D raw = select(zero > D(S(real_t<S>(0))), sqrt(zero), D(S(real_t<S>(0))));
    const D masked = sqrt(zero) * D(S(real_t<S>(0))); // a mask that multiplies
    report.holds("H1", kind_of<S>(), "select(x > 0, sqrt(x), 0) at 0: derivative 0",
                 slope(raw) == 0);
    report.textbook_fails("H1", kind_of<S>(), "mask * sqrt(x) at 0", std::isfinite(slope(masked)));
    // H3: a zero seed stays zero at a singularity.
    const auto still = [&](double x) { return seeded_at<S>(x, 0); };
    using std::log;
    bool quiet = slope(sqrt(still(0))) == 0 && slope(log(still(0))) == 0;
    if constexpr (std::is_floating_point_v<S>) {
        quiet = quiet && slope(acos(still(1))) == 0 && slope(asin(still(-1))) == 0;
        report.holds("H3", kind_of<S>(), "acos'(1), seed 1: -inf",
                     slope(acos(seeded_at<S>(1))) == -std::numeric_limits<double>::infinity());
    }
    report.holds("H3", kind_of<S>(), "sqrt, log, acos, asin at their ends, seed 0: tangent 0",
                 quiet);
    report.holds("H3", kind_of<S>(), "sqrt'(0), seed 1: inf",
                 std::isinf(slope(sqrt(seeded_at<S>(0)))));
    const real_t<S> inf = std::numeric_limits<real_t<S>>::infinity();
    report.textbook_fails("H3", kind_of<S>(), "f'(x) dx with f' = inf, dx = 0",
                          std::isfinite(inf * real_t<S>(0)));
    // H4: ties take the average, in any order of the arguments.
    const D x = seeded_at<S>(2), c(S(real_t<S>(2)));
    using std::abs, std::max, std::min;
    report.holds("H4", kind_of<S>(), "max(x, 2), min(2, x) at 2: 1/2; |x| at +-0: 0",
                 slope(max(x, c)) == 0.5 && slope(max(c, x)) == 0.5 && slope(min(c, x)) == 0.5 &&
                     slope(abs(seeded_at<S>(0.0))) == 0 && slope(abs(seeded_at<S>(-0.0))) == 0);
    if constexpr (std::is_floating_point_v<S>)
        report.textbook_fails("H4", kind_of<S>(), "std::max picks by position: equal if swapped",
                              slope(std::max<D>(x, c)) == slope(std::max<D>(c, x)));
    // H5
    using std::atan2, std::hypot;
    const D origin = seeded_at<S>(0), o(S(real_t<S>(0)));
    report.holds("H5", kind_of<S>(), "atan2(0, 0), hypot(0, 0): value 0, tangent 0",
                 slope(atan2(origin, o)) == 0 && slope(hypot(origin, o)) == 0);
    const real_t<S> nothing = 0;
    report.textbook_fails("H5", kind_of<S>(), "x / (x^2 + y^2) at the origin",
                          std::isfinite(nothing / (nothing * nothing)));
}

template <class T>
void h2(Report& report) {
    using D = Dual<T, 1>;
    const D zero = seeded_at<T>(0), minus = seeded_at<T>(-2);
    const D two(T(2)), half(T(0.5)), still_zero(T(0)), g2 = seeded_at<T>(2);
    bool table = pow(zero, two).d[0] == T(0) && pow(zero, D(T(1))).d[0] == T(1) &&
                 pow(still_zero, g2).d[0] == T(0) && pow(minus, D(T(3))).d[0] == T(12) &&
                 !std::isfinite(pow(zero, half).d[0]) &&
                 !std::isfinite(pow(D(T(-2)), seeded_at<T>(3)).d[0]) &&
                 pow(zero, 0.0).value == T(1) && pow(zero, 0.0).d[0] == T(0);
    report.holds("H2", kind_of<T>(), "pow at f, g in {-2, 0, 1/2, 1, 2, 3}: Ceres' cases", table);
    report.textbook_fails("H2", kind_of<T>(), "0^2 as exp(2 log 0): derivative",
                          std::isfinite(std::exp(T(2) * std::log(T(0))) * T(2) / T(0)));
}

template <class T>
void h6_h7(Report& report) {
    const auto outer = [](auto x) {
        return x * derivative([&](auto y) { return x * y; }, decltype(x)(1));
    };
    report.holds("H6", kind_of<T>(), "D(x -> x D(y -> x y, 1), 4) = 8",
                 derivative(outer, T(4)) == T(8));
    // Perturbations that are one: the inner derivative sees the outer's seed.
    const T confused = T(4) * T(1) + T(4) * T(1) + T(4);
    report.textbook_fails("H6", kind_of<T>(), "one perturbation for both: 8", confused == T(8));
    using D = Dual<T, 1>;
    using DD = Dual<D, 1>;
    double worst = 0;
    for (std::uint64_t i = 0; i < 200; ++i) {
        const T x = static_cast<T>(Random{6, 0}.normal(2 * i)),
                y = static_cast<T>(Random{6, 1}.uniform(i));
        DD xx(seeded_at<T>(double(x))), yy = DD::variable(D(y));
        const DD f = sin(xx * yy);
        const double p = double(x) * double(y);
        worsen(worst, std::abs(double(f.d[0].d[0]) - (std::cos(p) - p * std::sin(p))));
    }
    report.at_most("H6", kind_of<T>(), "d2 sin(x y) / dx dy", sizeof(T) == 4 ? 2e-6 : 1e-14, worst);
    const D a = seeded_at<T>(1), b(T(1));
    report.holds(
        "H7", kind_of<T>(), "comparisons are of values; -0 = +0",
        a == b && !(a < b) && D(T(-0.0)) == D(T(0)) && select(a < D(T(2)), a, b).d[0] == T(1));
}

/// Central differences of a chain of rotations and roots against duals: the V over h.
void h9_h10(Report& report) {
    const auto f = [](const auto& x) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        Vec4<S> q(x(0, 0), x(1, 0), x(2, 0), x(3, 0));
        Vec3<S> v(x(4, 0), x(5, 0), x(6, 0));
        const Vec3<S> y = quat_rotate(quat_normalized(q), normalized(v));
        Columns<S> r(3, 1);
        for (int i = 0; i < 3; ++i) r(i, 0) = y[i];
        return r;
    };
    const Columns<double> x = random_columns<double>(7, 1, {9}),
                          v = random_columns<double>(7, 1, {10});
    const Columns<double> j = jvp(f, x, v);
    double at_step = 0, best = 1;
    for (int e = 1; e <= 12; ++e) {
        const double h = std::pow(10.0, -e);
        const double off = (central_difference(f, x, v, h) - j).norm() / j.norm();
        best = std::min(best, off);
    }
    at_step = (central_difference(f, x, v) - j).norm() / j.norm();
    report.at_most("H9", "double", "central difference at h = 6e-6 against duals", 1e-8, at_step);
    report.holds("H9", "double", "the V's least is within 30x of that", best > at_step / 30);
    const Columns<float> xf = x.cast<float>(), vf = v.cast<float>();
    const Columns<float> above = f(Columns<float>(xf + 6e-6F * vf)),
                         below = f(Columns<float>(xf - 6e-6F * vf));
    report.textbook("H9", "float", "the same difference in float", 1e-8,
                    double(((above - below) / 12e-6F - j.cast<float>()).norm() / j.norm()));
    // H10: the second derivative of the ramp is 0, at its kinks too.
    using D = Dual<double, 1>;
    using DD = Dual<D, 1>;
    bool flat = true;
    for (const double d2 : {0.1, 0.15, 0.2, 0.25, 0.3}) {
        const DD x2 = DD::variable(D::variable(d2));
        const DD w = SquaredDistance().value(Ramp<DD>{DD(0.15), DD(0.25)}, x2);
        flat = flat && w.d[0].d[0] == 0;
    }
    report.holds("H10", "double", "d2 lambda / dx2 inside, outside, at both kinks: 0", flat);
}

void h8(Report& report) {
    // A product of duals is evaluated into its own matrix, not kept as an expression.
    using D = Dual<double, 1>;
    Columns<D> product;
    {
        const Columns<D> a = Columns<D>::Constant(2, 2, D::variable(2)), b = a;
        product = a * b;
    }
    report.holds("H8", "double", "a product outlives its factors",
                 product(0, 0).value == 8 && product(1, 1).d[0] == 8);
}

} // namespace

void duals(Report& report) {
    h1_h3_h4_h5<float>(report);
    h1_h3_h4_h5<double>(report);
    h2<float>(report);
    h2<double>(report);
    h6_h7<float>(report);
    h6_h7<double>(report);
    h8(report);
    h9_h10(report);
}

} // namespace rye::hard
