// SPDX-License-Identifier: Apache-2.0
/// rye/core/bit_cast.hpp: std::bit_cast, which libc++ before 14 (Debian 12's emscripten) lacks.
#pragma once

#include <type_traits>

#include <rye/core/config.hpp>

namespace rye {

/// Returns the same bits as another type of the same size.
template <class To, class From>
    requires(sizeof(To) == sizeof(From) && std::is_trivially_copyable_v<To> &&
             std::is_trivially_copyable_v<From>)
RYE_HD constexpr To bit_cast(const From& x) noexcept {
    return __builtin_bit_cast(To, x);
}

} // namespace rye
