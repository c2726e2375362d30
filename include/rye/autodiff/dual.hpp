// SPDX-License-Identifier: Apache-2.0
/// rye/autodiff/dual.hpp: forward-mode dual numbers x + d_1 e_1 + ... + d_N e_N with e_i e_j = 0.
/// A function evaluated on duals returns its value and N directional derivatives. T may be float,
/// double, a batch, or again a Dual (second derivatives). Duals of different tags do not mix, so
/// two derivatives in flight cannot be confused (Siskind and Pearlmutter, 2005).
/// Conventions at kinks: |x| and the ties of min and max take the average of both sides; where the
/// tangent of the argument is 0 the tangent of sqrt, log, acos, ... is 0, even at a singularity.
#pragma once

#include <cmath>

#include <rye/core/eigen.hpp>

#include <rye/core/array.hpp>
#include <rye/core/concepts.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

struct DefaultTag {};

/// A number with its derivatives in N directions. `Tag` keeps the duals of nested derivatives
/// apart.
template <Scalar T, int N, class Tag = DefaultTag>
struct Dual {
    T value = T(0);
    Array<T, std::size_t(N)> d;  ///< directional derivatives

    RYE_HD constexpr Dual() {
        for (T& x : d) x = T(0);
    }
    /// A constant.
    template <class U>
        requires std::is_arithmetic_v<U>
    RYE_HD constexpr Dual(U x) : Dual() {
        value = T(static_cast<real_t<T>>(x));
    }
    RYE_HD constexpr Dual(const T& x)
        requires(!std::is_arithmetic_v<T>)
        : Dual() {
        value = x;
    }
    /// Returns x with derivative 1 in direction i.
    RYE_HD static constexpr Dual variable(const T& x, int i = 0) {
        Dual r;
        r.value = x;
        r.d[static_cast<std::size_t>(i)] = T(1);
        return r;
    }

    /// Returns f(value) with f'(value) = slope: the chain rule, 0 * inf being 0.
    RYE_HD constexpr Dual chain(const T& f, const T& slope) const {
        Dual r;
        r.value = f;
        for (std::size_t i = 0; i < N; ++i)
            r.d[i] = pick(is_zero_part(d[i]), T(0), T(d[i] * slope));
        return r;
    }

    RYE_HD Dual& operator+=(const Dual& b) { return *this = *this + b; }
    RYE_HD Dual& operator-=(const Dual& b) { return *this = *this - b; }
    RYE_HD Dual& operator*=(const Dual& b) { return *this = *this * b; }
    RYE_HD Dual& operator/=(const Dual& b) { return *this = *this / b; }

    RYE_HD friend Dual operator+(const Dual& a) { return a; }
    RYE_HD friend Dual operator-(const Dual& a) { return combine(a, T(-1), a, T(0), -a.value); }
    RYE_HD friend Dual operator+(const Dual& a, const Dual& b) {
        Dual r;
        r.value = a.value + b.value;
        for (std::size_t i = 0; i < N; ++i) r.d[i] = a.d[i] + b.d[i];
        return r;
    }
    RYE_HD friend Dual operator-(const Dual& a, const Dual& b) {
        Dual r;
        r.value = a.value - b.value;
        for (std::size_t i = 0; i < N; ++i) r.d[i] = a.d[i] - b.d[i];
        return r;
    }
    RYE_HD friend Dual operator*(const Dual& a, const Dual& b) {
        return combine(a, b.value, b, a.value, a.value * b.value);
    }
    RYE_HD friend Dual operator/(const Dual& a, const Dual& b) {
        const T i = T(1) / b.value;
        const T q = a.value / b.value;  // not a i: same rounding as the formula on plain numbers
        return combine(a, i, b, -q * i, q);
    }

    // Comparisons are of values: a branch has the derivative of the side taken.
    RYE_HD friend auto operator<(const Dual& a, const Dual& b) { return a.value < b.value; }
    RYE_HD friend auto operator>(const Dual& a, const Dual& b) { return a.value > b.value; }
    RYE_HD friend auto operator<=(const Dual& a, const Dual& b) { return a.value <= b.value; }
    RYE_HD friend auto operator>=(const Dual& a, const Dual& b) { return a.value >= b.value; }
    RYE_HD friend auto operator==(const Dual& a, const Dual& b) { return a.value == b.value; }
    RYE_HD friend auto operator!=(const Dual& a, const Dual& b) { return a.value != b.value; }

    template <class Condition>
    RYE_HD friend Dual select(const Condition& c, const Dual& a, const Dual& b) {
        Dual r;
        r.value = pick(c, a.value, b.value);
        for (std::size_t i = 0; i < N; ++i) r.d[i] = pick(c, a.d[i], b.d[i]);
        return r;
    }

    // sqrt(x + h) = sqrt(x) + h / (2 sqrt(x))
    RYE_HD friend Dual sqrt(const Dual& x) {
        using std::sqrt;
        const T s = sqrt(x.value);
        return x.chain(s, T(0.5) / s);
    }
    // exp(x + h) = exp(x) + exp(x) h
    RYE_HD friend Dual exp(const Dual& x) {
        using std::exp;
        const T e = exp(x.value);
        return x.chain(e, e);
    }
    // exp2(x + h) = exp2(x) + ln(2) exp2(x) h
    RYE_HD friend Dual exp2(const Dual& x) {
        using std::exp2;
        const T e = exp2(x.value);
        return x.chain(e, constant<T>(0.69314718055994530942) * e);
    }
    // expm1(x + h) = expm1(x) + exp(x) h
    RYE_HD friend Dual expm1(const Dual& x) {
        using std::exp, std::expm1;
        return x.chain(expm1(x.value), exp(x.value));
    }
    // log(x + h) = log(x) + h / x
    RYE_HD friend Dual log(const Dual& x) {
        using std::log;
        return x.chain(log(x.value), T(1) / x.value);
    }
    // log2(x + h) = log2(x) + h / (x ln 2)
    RYE_HD friend Dual log2(const Dual& x) {
        using std::log2;
        return x.chain(log2(x.value), constant<T>(1.4426950408889634074) / x.value);
    }
    // log1p(x + h) = log1p(x) + h / (1 + x)
    RYE_HD friend Dual log1p(const Dual& x) {
        using std::log1p;
        return x.chain(log1p(x.value), T(1) / (T(1) + x.value));
    }
    // sin(x + h) = sin(x) + cos(x) h
    RYE_HD friend Dual sin(const Dual& x) {
        using std::cos, std::sin;
        return x.chain(sin(x.value), cos(x.value));
    }
    // cos(x + h) = cos(x) - sin(x) h
    RYE_HD friend Dual cos(const Dual& x) {
        using std::cos, std::sin;
        return x.chain(cos(x.value), -sin(x.value));
    }
    // tan(x + h) = tan(x) + (1 + tan(x)^2) h
    RYE_HD friend Dual tan(const Dual& x) {
        using std::tan;
        const T t = tan(x.value);
        return x.chain(t, T(1) + t * t);
    }
    // tanh(x + h) = tanh(x) + (1 - tanh(x)^2) h
    RYE_HD friend Dual tanh(const Dual& x) {
        using std::tanh;
        const T t = tanh(x.value);
        return x.chain(t, (T(1) - t) * (T(1) + t));
    }
    // asin(x + h) = asin(x) + h / sqrt(1 - x^2)
    RYE_HD friend Dual asin(const Dual& x) {
        using std::asin, std::sqrt;
        return x.chain(asin(x.value), T(1) / sqrt((T(1) - x.value) * (T(1) + x.value)));
    }
    // acos(x + h) = acos(x) - h / sqrt(1 - x^2)
    RYE_HD friend Dual acos(const Dual& x) {
        using std::acos, std::sqrt;
        return x.chain(acos(x.value), T(-1) / sqrt((T(1) - x.value) * (T(1) + x.value)));
    }
    // atan(x + h) = atan(x) + h / (1 + x^2)
    RYE_HD friend Dual atan(const Dual& x) {
        using std::atan;
        return x.chain(atan(x.value), T(1) / (T(1) + x.value * x.value));
    }
    // atan2(y + k, x + h) = atan2(y, x) + (x k - y h) / (x^2 + y^2), tangent 0 at the origin
    RYE_HD friend Dual atan2(const Dual& y, const Dual& x) {
        using std::atan2;
        const T n = x.value * x.value + y.value * y.value;
        const auto origin = n == T(0);
        const T i = T(1) / pick(origin, T(1), n);
        return combine(y, x.value * i, x, -y.value * i, atan2(y.value, x.value));
    }
    // hypot(x + h, y + k) = r + (x h + y k) / r, tangent 0 at the origin
    RYE_HD friend Dual hypot(const Dual& x, const Dual& y) {
        using std::hypot;
        const T r = hypot(x.value, y.value);
        const auto origin = r == T(0);
        const T i = T(1) / pick(origin, T(1), r);
        return combine(x, x.value * i, y, y.value * i, r);
    }
    // |x + h| = |x| + sign(x) h, with sign(0) = 0
    RYE_HD friend Dual abs(const Dual& x) {
        using std::abs;
        const T zero = T(0);
        const T sign = pick(x.value > zero, T(1), pick(x.value < zero, T(-1), zero));
        return x.chain(abs(x.value), sign);
    }
    RYE_HD friend Dual fabs(const Dual& x) { return abs(x); }
    RYE_HD friend Dual min(const Dual& a, const Dual& b) {
        return select(a < b, a, select(b < a, b, T(0.5) * (a + b)));
    }
    RYE_HD friend Dual max(const Dual& a, const Dual& b) {
        return select(a > b, a, select(b > a, b, T(0.5) * (a + b)));
    }
    // (x + h)^p = x^p + p x^(p-1) h for a constant exponent; 0^0 = 1 with tangent 0
    RYE_HD friend Dual pow(const Dual& x, double p) {
        using std::pow;
        if (p == 0) return Dual(1);
        const T f = pow(x.value, constant<T>(p));
        return x.chain(f, p == 1 ? T(1) : T(constant<T>(p) * pow(x.value, constant<T>(p - 1))));
    }
    // x^g = exp(g log x): tangent g x^(g-1) h + log(x) x^g k, where 0^g with g > 0 stays 0
    RYE_HD friend Dual pow(const Dual& x, const Dual& g) {
        using std::log, std::pow;
        const T f = pow(x.value, g.value);
        const Dual by_base = x.chain(f, g.value * pow(x.value, g.value - T(1)));
        const auto still = (x.value == T(0)) && (g.value > T(0));
        const T rate = log(pick(still, T(1), x.value)) * f;
        const Dual by_exponent = g.chain(f, pick(still, T(0), rate));
        Dual r;
        r.value = f;
        for (std::size_t i = 0; i < N; ++i) r.d[i] = by_base.d[i] + by_exponent.d[i];
        return r;
    }
    RYE_HD friend Dual floor(const Dual& x) {
        using std::floor;
        return Dual(floor(x.value));
    }
    RYE_HD friend bool isfinite(const Dual& x) {
        using std::isfinite;
        bool all = isfinite(x.value);
        for (const T& t : x.d) all = all && isfinite(t);
        return all;
    }
    RYE_HD friend bool isnan(const Dual& x) {
        using std::isnan;
        return isnan(x.value);
    }

    /// Returns true where the value and every derivative are 0: the only case in which a singular
    /// slope is dropped. (An inner dual of value 0 can still carry a derivative.)
    RYE_HD friend auto is_zero(const Dual& x) {
        auto all = is_zero_part(x.value);
        for (const T& t : x.d) all = all && is_zero_part(t);
        return all;
    }

  private:
    RYE_HD static auto is_zero_part(const T& t) {
        if constexpr (requires { is_zero(t); })
            return is_zero(t);
        else
            return t == T(0);
    }
    template <class Condition>
    RYE_HD static T pick(const Condition& c, const T& a, const T& b) {
        return select(c, a, b);
    }
    RYE_HD static Dual combine(const Dual& a, const T& pa, const Dual& b, const T& pb, const T& f) {
        Dual r;
        r.value = f;
        for (std::size_t i = 0; i < N; ++i) r.d[i] = pa * a.d[i] + pb * b.d[i];
        return r;
    }
};

namespace detail {

template <class T, int N, class Tag>
struct RealOf<Dual<T, N, Tag>> {
    using type = real_t<T>;
};

} // namespace detail

/// Returns the innermost value.
template <class T, int N, class Tag>
RYE_HD constexpr auto value_of(const Dual<T, N, Tag>& x) {
    if constexpr (requires { x.value.value; })
        return value_of(x.value);
    else
        return x.value;
}

} // namespace rye

namespace Eigen {

template <class T, int N, class Tag>
struct NumTraits<rye::Dual<T, N, Tag>> : GenericNumTraits<rye::Dual<T, N, Tag>> {
    using Real = rye::Dual<T, N, Tag>;
    using NonInteger = Real;
    using Nested = Real;
    using Literal = Real;
    enum {
        IsComplex = 0,
        IsInteger = 0,
        IsSigned = 1,
        RequireInitialization = 1,
        ReadCost = 1 + N,
        AddCost = 1 + N,
        MulCost = 1 + 3 * N
    };
    RYE_HD static Real epsilon() { return Real(NumTraits<T>::epsilon()); }
    RYE_HD static Real dummy_precision() { return Real(NumTraits<T>::dummy_precision()); }
    RYE_HD static Real highest() { return Real(NumTraits<T>::highest()); }
    RYE_HD static Real lowest() { return Real(NumTraits<T>::lowest()); }
    RYE_HD static int digits10() { return NumTraits<T>::digits10(); }
};

} // namespace Eigen
