// SPDX-License-Identifier: Apache-2.0
/// rye/core/random.hpp: counter-based random numbers. Each number is a function of
/// (seed, stream, index), so there is no state to save or to share between threads.
/// Source: the finaliser of splitmix64 (Steele, Lea, Flood, 2014).
#pragma once

#include <cmath>
#include <cstdint>

#include <rye/core/config.hpp>

namespace rye {

/// Applies one round of splitmix64.
constexpr std::uint64_t mix64(std::uint64_t z) {
    z += 0x9E3779B97F4A7C15ULL;
    z = (z ^ (z >> 30U)) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ (z >> 27U)) * 0x94D049BB133111EBULL;
    return z ^ (z >> 31U);
}

/// Random numbers of one (seed, stream); the index is the counter.
struct Random {
    std::uint64_t seed = 0;
    std::uint64_t stream = 0;

    constexpr std::uint64_t bits(std::uint64_t index) const {
        return mix64(mix64(seed ^ (stream * 0xD1B54A32D192ED03ULL)) + index);
    }
    /// Returns a number uniform in (0, 1), 24 bits, never 0 or 1.
    constexpr double uniform(std::uint64_t index) const {
        return (static_cast<double>(bits(index) >> 40U) + 0.5) * 0x1.0p-24;
    }
    /// Returns a standard normal number (Box-Muller); uses stream and stream + 1.
    double normal(std::uint64_t index) const {
        const Random other{seed, stream + 1};
        return std::sqrt(-2.0 * std::log(uniform(index))) *
               std::cos(6.283185307179586476925 * other.uniform(index));
    }
    /// Returns a number uniform in {0, ..., n - 1}.
    constexpr Index below(std::uint64_t index, Index n) const {
        return static_cast<Index>(bits(index) % static_cast<std::uint64_t>(n));
    }
    /// Returns an independent generator, for a training step or a purpose.
    constexpr Random fork(std::uint64_t key) const { return {mix64(seed ^ mix64(key)), stream}; }
};

} // namespace rye
