// SPDX-License-Identifier: Apache-2.0
/// rye/core/concepts.hpp: concepts of the scalars that formulas are instantiated with.
#pragma once

#include <concepts>
#include <type_traits>

#include <rye/core/config.hpp>

namespace rye {

/// float or double.
template <class T>
concept Real = std::floating_point<T>;

/// Any scalar of a formula: Real, Dual<Scalar, N>, xsimd::batch<Real>.
template <class T>
concept Scalar = std::default_initializable<T> && std::copyable<T> &&
                 std::constructible_from<T, double> && requires(T a, const T b) {
                     { b + b } -> std::convertible_to<T>;
                     { b * b } -> std::convertible_to<T>;
                     { b / b } -> std::convertible_to<T>;
                     { -b } -> std::convertible_to<T>;
                     { a += b };
                 };

                 namespace detail {

                 /// The innermost Real of a scalar: float for Dual<Dual<float, 2>, 3> and for
                 /// batch<float>. Specialised beside Dual and beside the batch.
                 template <class T>
                 struct RealOf {
                     using type = T;
};

} // namespace detail

/// See RealOf.
template <class T>
using real_t = typename detail::RealOf<T>::type;

/// Returns the value of a scalar without its derivative; the identity for Real and batches.
/// Overloaded beside Dual. Branches and comparisons are taken on values only.
template <Real T>
RYE_HD constexpr T value_of(T x) {
    return x;
}
/// A batch is its own value.
template <class V>
    requires requires { typename V::batch_bool_type; }
constexpr const V& value_of(const V& x) {
    return x;
}

} // namespace rye
