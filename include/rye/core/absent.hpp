// SPDX-License-Identifier: Apache-2.0
/// rye/core/absent.hpp: empty members in place of those of a feature that is off. Declared
/// [[no_unique_address]], they take no memory; any use is a compile error that names Without<X> on
/// the user's line.
#pragma once

#include <type_traits>

namespace rye {

/// Type of a member of the feature X where X is off. Two of them share an address, and so take no
/// memory, only if their types differ: number them.
template <class X, int number = 0>
struct Without {
    Without() = default;
    Without(const Without&) = default;
    Without& operator=(const Without&) = default;
    template <class U>
    Without& operator=(U&&) = delete;
    template <class U>
    void operator[](U&&) const = delete;
};

namespace detail {

/// True if V is a Without.
template <class V>
inline constexpr bool is_absent = false;
template <class X, int number>
inline constexpr bool is_absent<Without<X, number>> = true;

/// V, or Without<X> where X is off.
template <bool on, class X, class V, int number = 0>
using PresentIf = std::conditional_t<on, V, Without<X, number>>;

} // namespace detail

} // namespace rye
