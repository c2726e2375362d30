// SPDX-License-Identifier: Apache-2.0
/// rye/math/exponential.hpp: 2^x as 2^k times a polynomial on [-1/2, 1/2]. The degree trades time
/// for error; the error is a constant of the type. Callers scale their quadratic form by log2(e)
/// beforehand, since multiplying x by it afterwards costs accuracy.
/// Source: minimax polynomials in relative error (Remez); Cody and Waite, 1980.
#pragma once

#include <cmath>
#include <concepts>
#include <cstdint>
#include <type_traits>
#include <utility>

#include <rye/core/bit_cast.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

/// ln(2).
inline constexpr double ln_2 = 0.69314718055994530942;

namespace detail {

/// 1.5 times 2 to the number of mantissa bits: adding it rounds to an integer, which then occupies
/// the lowest bits.
template <class R>
inline constexpr double rounder = sizeof(R) == 4 ? 0x1.8p23 : 0x1.8p52;

/// Returns p 2^k for p in [1/2, 2) and t = k + rounder, k in the range of normal exponents, by
/// adding k to the exponent bits. Unspecified for other k.
template <Scalar T>
RYE_HD T scale_by_power(const T& p, const T& t) {
    if constexpr (std::same_as<T, float>) {
        const auto k = bit_cast<std::uint32_t>(t) << 23U;
        return bit_cast<float>(bit_cast<std::uint32_t>(p) + k);
    } else if constexpr (std::same_as<T, double>) {
        const auto k = bit_cast<std::uint64_t>(t) << 52U;
        return bit_cast<double>(bit_cast<std::uint64_t>(p) + k);
    } else if constexpr (requires { p.each(t, nullptr); }) {  // several batches
        return p.each(t, [](const auto& a, const auto& b) { return scale_by_power(a, b); });
    } else {                                // a batch, by argument-dependent lookup
        using Bits = decltype(to_int(p));
        constexpr int mantissa = sizeof(real_t<T>) == 4 ? 23 : 52;
        return cast_bits<T>(cast_bits<Bits>(p) + (cast_bits<Bits>(t) << mantissa));
    }
}

/// Degrees 3 to 6, highest power first.
template <int Degree>
struct Exp2Coefficients;
template <>
struct Exp2Coefficients<3> {
    static constexpr double error = 7.6e-5;
    static constexpr double c[4]{0.0551716685, 0.242611125, 0.693260968, 0.999928057};
};
template <>
struct Exp2Coefficients<4> {
    static constexpr double error = 2.8e-6;
    static constexpr double c[5]{0.00957010221, 0.0559178591, 0.240247443, 0.693121791,
                                             0.999999285};
};
template <>
struct Exp2Coefficients<5> {
    static constexpr double error = 2.4e-7;
    static constexpr double c[6]{0.00132764725, 0.00967554096, 0.0555071309,
                                             0.240221202,   0.693146944,   1.00000012};
};
template <>
struct Exp2Coefficients<6> {
    static constexpr double error = 1.0e-7;
    static constexpr double c[7]{0.000153458124, 0.00133999309, 0.00961848907,
                                             0.0555032864,   0.240226462,   0.693147182, 1.};
};

} // namespace detail

/// 2^x for x <= 127 in float. For x < -126 and for NaN the result is 2^-126, so that a Gaussian
/// with a NaN exponent is transparent, not opaque, on every backend.
template <int Degree>
struct Exp2Poly {
    using Coefficients = detail::Exp2Coefficients<Degree>;
    static constexpr double max_relative_error = Coefficients::error;  ///< in float

    template <Scalar T>
    RYE_HD T operator()(const T& x) const {
        if constexpr (requires { x.chain(x.value, x.value); }) {  // a dual: d 2^x = ln(2) 2^x dx
            const auto f = (*this)(x.value);
            using V = std::remove_const_t<decltype(f)>;
            return x.chain(f, V(constant<V>(ln_2) * f));
        } else {
            const T lowest = T(-126);
            return within(T(select(x > lowest, x, lowest)));
        }
    }

    /// Returns the same for x in [-126, 127], not a dual; unspecified elsewhere.
    template <Scalar T>
    [[gnu::always_inline]] RYE_HD static T within(const T& x) {
        const T round = constant<T>(detail::rounder<real_t<T>>);
        const T t = x + round;
        const T f = x - (t - round);                                     // in [-1/2, 1/2]
        using Powers = std::make_index_sequence<std::size_t(Degree)>;
        return detail::scale_by_power(polynomial(f, Powers()), t);
    }

  private:
    /// Evaluates by Horner's scheme as a fold expression: compilers do not unroll a loop over the
    /// coefficients.
    template <Scalar T, std::size_t... I>
    [[gnu::always_inline]] RYE_HD static T polynomial(const T& f, std::index_sequence<I...>) {
        T p = constant<T>(Coefficients::c[0]);
        ((p = p * f + constant<T>(Coefficients::c[I + 1])), ...);
        return p;
    }
};

/// exp2 of the standard library or of xsimd, almost correctly rounded.
struct Exp2Library {
    static constexpr double max_relative_error = 1.5e-7;  ///< in float, of xsimd's version

    template <Scalar T>
    RYE_HD T operator()(const T& x) const {
        using std::exp2;
        return exp2(x);
    }
};

/// A function 2^x with a stated error.
template <class E>
concept Exp2Kernel = std::default_initializable<E> && requires(const E e, const float x) {
    { e(x) } -> std::same_as<float>;
    { E::max_relative_error } -> std::convertible_to<double>;
};
static_assert(Exp2Kernel<Exp2Poly<5>> && Exp2Kernel<Exp2Library>);

} // namespace rye
