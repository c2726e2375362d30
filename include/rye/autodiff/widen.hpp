// SPDX-License-Identifier: Apache-2.0
/// rye/autodiff/widen.hpp: the same scalar in double: float to double, Dual<float, N> to
/// Dual<double, N>. For geometry that subtracts nearly equal numbers.
#pragma once

#include <rye/autodiff/dual.hpp>

namespace rye::detail {

/// T in double: double for float, Dual<double, N> for Dual<float, N>; other types are the same.
template <class T>
struct WidenedOf {
    using type = T;
};
template <>
struct WidenedOf<float> {
    using type = double;
};
template <class T, int N, class Tag>
struct WidenedOf<Dual<T, N, Tag>> {
    using type = Dual<typename WidenedOf<T>::type, N, Tag>;
};
/// See WidenedOf.
template <class T>
using widened_t = typename WidenedOf<T>::type;

/// Converts between a scalar and its widened form, derivatives included.
template <class To, class From>
RYE_HD constexpr To scalar_cast(const From& x) {
    if constexpr (std::is_same_v<To, From>) {
        return x;
    } else if constexpr (std::is_arithmetic_v<From>) {
        return static_cast<To>(x);
    } else {
        To r;
        r.value = scalar_cast<decltype(r.value)>(x.value);
        for (std::size_t i = 0; i < x.d.size(); ++i)
            r.d[i] = scalar_cast<decltype(r.value)>(x.d[i]);
        return r;
    }
}

} // namespace rye::detail
