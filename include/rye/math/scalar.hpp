// SPDX-License-Identifier: Apache-2.0
/// rye/math/scalar.hpp: branch-free selection and smooth step functions, for every scalar.
/// `select(condition, a, b)` evaluates both sides, so make the *argument* of a singular function
/// safe before calling it. Formulas call functions unqualified after a `using std::f`, so that
/// those of duals and batches are found by argument-dependent lookup.
#pragma once

#include <cmath>
#include <limits>

#include <rye/core/concepts.hpp>

namespace rye {

/// Returns a double literal, rounded once to the innermost Real; also for batches and duals.
template <Scalar T>
RYE_HD constexpr T constant(double x) {
    return T(static_cast<real_t<T>>(x));
}

/// Values of std::numeric_limits, whose functions device code must not call.
template <Real R>
struct Limits {
    static constexpr R largest = std::numeric_limits<R>::max();
    static constexpr R epsilon = std::numeric_limits<R>::epsilon();
    static constexpr R infinity = std::numeric_limits<R>::infinity();
    static constexpr R nan = std::numeric_limits<R>::quiet_NaN();
};

/// Returns the smaller argument, also in device code; of a NaN and a number, the first one.
/// (Batches and duals have their own.)
template <class T>
    requires std::is_arithmetic_v<T>
RYE_HD constexpr T min(const T& a, const T& b) {
    return b < a ? b : a;
}
/// Returns the larger argument; of a NaN and a number, the first one.
template <class T>
    requires std::is_arithmetic_v<T>
RYE_HD constexpr T max(const T& a, const T& b) {
    return a < b ? b : a;
}

/// Returns a where the condition holds, else b. (Batches and duals have their own.)
template <class T>
    requires std::is_arithmetic_v<T>
RYE_HD constexpr T select(bool condition, const T& a, const T& b) {
    return condition ? a : b;
}

/// Returns x x.
template <class T>
RYE_HD constexpr T square(const T& x) {
    return x * x;
}

namespace detail {

/// Returns the bits of a batch as another type of the same size. The template argument of
/// bitwise_cast is a batch type before xsimd 11, and a scalar type since.
template <class To, class From>
[[gnu::always_inline]] inline To cast_bits(const From& x) {
    using Number = typename To::value_type;
    if constexpr (requires { { bitwise_cast<Number>(x) } -> std::same_as<To>; })
        return bitwise_cast<Number>(x);
    else
        return bitwise_cast<To>(x);
}

/// Returns the slope of |x|: -1, 0 or 1; 0 at 0. Without derivative.
template <Scalar T>
RYE_HD T sign_of(const T& x) {
    return select(x > T(0), T(1), select(x < T(0), T(-1), T(0)));
}

} // namespace detail

/// Returns min(max(x, lo), hi), with derivative 1 inside, 1/2 at the ends, 0 outside.
template <Scalar T>
RYE_HD T clamp_value(const T& x, const T& lo, const T& hi) {
    return min(max(x, lo), hi);
}

/// Returns 1 / (1 + exp(-x)) without overflow: takes exp of non-positive numbers only. Not in terms
/// of |x|, whose derivative of 0 at 0 would give sigmoid'(0) = 0.
template <Scalar T>
RYE_HD T sigmoid(const T& x) {
    using std::exp;
    const auto negative = x < T(0);
    const T e = exp(select(negative, x, T(-x)));
    return select(negative, e, T(1)) / (T(1) + e);
}

/// Returns log(1 + exp(x)) = max(x, 0) + log1p(exp(-|x|)); equals -log(1 - sigmoid(x)).
template <Scalar T>
RYE_HD T softplus(const T& x) {
    using std::abs, std::exp, std::log1p;
    return max(x, T(0)) + log1p(exp(-abs(x)));
}

/// Returns log(p) - log1p(-p), the inverse of sigmoid, for p in (0, 1).
template <Scalar T>
RYE_HD T logit(const T& p) {
    using std::log, std::log1p;
    return log(p) - log1p(-p);
}

} // namespace rye
