// SPDX-License-Identifier: Apache-2.0
/// rye/core/memory.hpp: how much memory a file may ask for. A small file can state large sizes, or
/// unpack to a thousand times its own, so readers compare what it asks for with a limit in bytes
/// before they allocate it.
#pragma once

#include <cstdint>
#include <limits>
#include <string>

#include <rye/core/error.hpp>

namespace rye {

/// Limit of one file, or of the lists of one picture, unless a caller gives another [bytes]: 2 GiB,
/// which holds 8 million Gaussians of degree 3.
inline constexpr std::uint64_t default_memory = std::uint64_t(1) << 31U;

/// Returns a * b, or the largest number where that is beyond 64 bits.
constexpr std::uint64_t saturated_product(std::uint64_t a, std::uint64_t b) {
    constexpr std::uint64_t most = std::numeric_limits<std::uint64_t>::max();
    return b != 0 && a > most / b ? most : a * b;
}

namespace detail {

/// Returns a + b, or the largest number where that is beyond 64 bits.
constexpr std::uint64_t saturated_sum(std::uint64_t a, std::uint64_t b) {
    constexpr std::uint64_t most = std::numeric_limits<std::uint64_t>::max();
    return a > most - b ? most : a + b;
}

} // namespace detail

/// Throws Error with both numbers if more bytes are needed than the limit; `what` needs them.
inline void require_memory(std::uint64_t need, std::uint64_t most, const std::string& who,
                           const std::string& what) {
    if (need > most)
        throw Error(who + ": " + what + " would take " + std::to_string(need) +
                    " bytes of memory, expected at most the limit of " + std::to_string(most));
}

} // namespace rye
