// SPDX-License-Identifier: Apache-2.0
/// rye/autodiff/check.hpp: tests of hand-written adjoints, for rye's operators and for users' own.
/// The dot-product test has no step size and covers the whole Jacobian:
///     <J dx, w> = <dx, J^T w>
/// The central difference is independent of the duals, and so checks them too. Use it in double,
/// where it is accurate to about 5e-10 of the terms (in float, to 2e-4).
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include <rye/autodiff/derivative.hpp>
#include <rye/core/fields.hpp>
#include <rye/core/random.hpp>

namespace rye {

/// A sum of products, and the sum of their magnitudes, which bounds its rounding error.
struct DotSum {
    double sum = 0, magnitude = 0;

    template <class A, class B>
    void add(const Eigen::MatrixBase<A>& a, const Eigen::MatrixBase<B>& b) {
        RYE_ASSERT(a.rows() == b.rows() && a.cols() == b.cols(), "DotSum: a and b differ in shape");
        for (Index j = 0; j < a.cols(); ++j)
            for (Index i = 0; i < a.rows(); ++i) {
                const double term = static_cast<double>(a(i, j)) * static_cast<double>(b(i, j));
                sum += term;
                magnitude += std::abs(term);
            }
    }
    /// Adds the products of two parameter structs, array by array.
    template <class P>
    void add_all(const P& a, const P& b) {
        P::fields([&](const std::string&, const auto& x, const auto& y) { add(x, y); }, a, b);
    }
};

/// Returns the difference of two dot products, relative to the sum of the magnitudes of their
/// terms. Infinite if that is NaN, or if the sums differ without any term.
inline double disagreement(const DotSum& a, const DotSum& b) {
    const double gap = std::abs(a.sum - b.sum), scale = std::max(a.magnitude, b.magnitude);
    if (gap == 0 && std::isfinite(scale)) return 0;
    const double r = gap / scale;
    return std::isfinite(r) ? r : std::numeric_limits<double>::infinity();
}

namespace detail {

/// Returns the disagreement of <J dx, w> and <dx, vjp(w)> at x. `f` takes columns of duals, `vjp`
/// takes the cotangent of f(x) and returns that of x.
template <class F, class Vjp, class X>
double dot_product_test(F&& f, Vjp&& vjp, const Columns<X>& x, const Columns<X>& dx,
                        const Columns<X>& w) {
    DotSum forward, reverse;
    forward.add(jvp(f, x, dx), w);
    const Columns<X> g = vjp(w);
    reverse.add(dx, g);
    return disagreement(forward, reverse);
}

} // namespace detail

/// Returns (f(x + h dx) - f(x - h dx)) / 2h; `f` takes columns of doubles. The step suits inputs
/// near 1.
template <class F>
Columns<double> central_difference(F&& f, const Columns<double>& x, const Columns<double>& dx,
                                   double h = 6e-6) {
    const Columns<double> above = f(Columns<double>(x + h * dx));
    const Columns<double> below = f(Columns<double>(x - h * dx));
    return (above - below) / (2 * h);
}

namespace detail {

/// Returns the disagreement of <central difference, w> and <dx, vjp(w)> at x.
template <class F, class Vjp>
double difference_test(F&& f, Vjp&& vjp, const Columns<double>& x, const Columns<double>& dx,
                       const Columns<double>& w) {
    DotSum forward, reverse;
    forward.add(central_difference(f, x, dx), w);
    const Columns<double> g = vjp(w);
    reverse.add(dx, g);
    return disagreement(forward, reverse);
}

} // namespace detail

/// Returns standard normal numbers, for directions and cotangents.
template <Real T>
Columns<T> random_columns(Index rows, Index cols, const Random& random) {
    Columns<T> r(rows, cols);
    for (Index i = 0; i < r.size(); ++i)
        r.data()[i] = static_cast<T>(random.normal(static_cast<std::uint64_t>(i)));
    return r;
}

/// Returns a struct of p's shapes, filled with standard normal numbers.
template <class P>
P random_like(const P& p, const Random& random) {
    P r = p;
    std::uint64_t array = 0;
    P::fields(
        [&](const std::string&, auto& a) {
            using T = typename std::decay_t<decltype(a)>::Scalar;
            a = random_columns<T>(a.rows(), a.cols(), random.fork(array++));
        },
        r);
    return r;
}

namespace detail {

/// Writes x + dx e into the arrays of a struct of duals, whose other members the caller has set.
template <class DualP, class P>
void seed_fields(DualP& duals, const P& x, const P& dx) {
    DualP::fields(
        [](const std::string&, auto& d, const auto& a, const auto& b) { d = seeded(a, b); }, duals,
        x, dx);
}

} // namespace detail

} // namespace rye
