// SPDX-License-Identifier: Apache-2.0
/// rye/core/array.hpp: a fixed-size array like std::array, whose members device code must not
/// call.
#pragma once

#include <cstddef>

#include <rye/core/config.hpp>

namespace rye {

/// N values, as std::array, whose members device code cannot call.
template <class T, std::size_t N>
struct Array {
    static_assert(N > 0, "Array: no entries");

    T entries[N];

    RYE_HD constexpr T& operator[](std::size_t i) { return entries[i]; }
    RYE_HD constexpr const T& operator[](std::size_t i) const { return entries[i]; }
    RYE_HD constexpr T* begin() { return entries; }
    RYE_HD constexpr T* end() { return entries + N; }
    RYE_HD constexpr const T* begin() const { return entries; }
    RYE_HD constexpr const T* end() const { return entries + N; }
    RYE_HD static constexpr std::size_t size() { return N; }
};

} // namespace rye
