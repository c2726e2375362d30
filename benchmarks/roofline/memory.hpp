// SPDX-License-Identifier: Apache-2.0
/// benchmarks/roofline/memory.hpp: how fast a thread reads and copies what lies in a cache or in
/// memory.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

#include <unistd.h>

#include <rye/backend/lanes.hpp>
#include <rye/core/aligned.hpp>
#include <rye/splat/lanes/registers.hpp>

#include "caches.hpp"
#include "clock.hpp"

namespace rye::bench {

/// Numbers that one turn of the loops below takes: eight vectors of the widest lanes.
inline constexpr std::size_t memory_turn = 128;

/// Returns the sum of n numbers, a multiple of `memory_turn`, gone through `passes` times: as many
/// loads as a core has units for, since eight sums do not wait for each other.
inline float read_all(const float* from, std::size_t n, int passes = 1) {
    using V = XsimdBackend<>::batch<float>;
    constexpr std::size_t lanes = V::size;
    std::array<V, 8> sum;
    sum.fill(V(0.F));
    for (int pass = 0; pass < passes; ++pass) {
        opaque(from);
        for (std::size_t at = 0; at < n; at += 8 * lanes)
            unrolled<8>([&](auto i) __attribute__((always_inline)) {
                sum[i] = sum[i] + V::load_aligned(from + at + i * lanes);
            });
    }
    V all(0.F);
    unrolled<8>([&](auto i) { all = all + sum[i]; });
    return lane_sum(all);
}

/// Copies n numbers, a multiple of `memory_turn`, by plain stores.
inline void copy_all(const float* from, float* to, std::size_t n) {
    using V = XsimdBackend<>::batch<float>;
    constexpr std::size_t lanes = V::size;
    for (std::size_t at = 0; at < n; at += 4 * lanes)
        unrolled<4>([&](auto i) __attribute__((always_inline)) {
            V::load_aligned(from + at + i * lanes).store_aligned(to + at + i * lanes);
        });
}

/// The speed of memory at a size.
struct MemorySpeed {
    WorkingSet set;
    double read;                         ///< [byte/s]
    double copy;                         ///< bytes read and bytes written, both counted [byte/s]
};

/// Measures arrays of `set`: the best of several runs of a quarter of a millisecond or of one pass.
inline MemorySpeed measured_speed(const WorkingSet& set, int runs) {
    const std::size_t n =
        std::max<std::size_t>(2, static_cast<std::size_t>(set.bytes) / (8 * memory_turn)) * 2 *
        memory_turn;
    AlignedArray<float> memory;
    float* const x = memory.reserve(static_cast<Index>(n));
    std::fill_n(x, n, 1.F);
    const double bytes = 4.0 * static_cast<double>(n);
    const int passes = static_cast<int>(std::max(1.0, 0x1p23 / bytes));
    const auto rate = [&](const auto& all_passes) {
        return passes * bytes /
               least_time(runs, all_passes, passes > 1 ? wall_seconds : thread_seconds);
    };
    MemorySpeed speed{set, 0, 0};
    speed.read = rate([&] {
        float sum = read_all(x, n, passes);
        opaque(sum);
    });
    speed.copy = rate([&] {
        for (int i = 0; i < passes; ++i) {
            copy_all(x, x + n / 2, n / 2);
            opaque(*x);
        }
    });
    return speed;
}

/// Speeds from the smallest working set to the largest.
struct MemorySpeeds {
    std::vector<MemorySpeed> speeds;

    /// Gives that of the smallest cache which holds so many bytes, else that of memory.
    const MemorySpeed& at(double bytes) const {
        for (const MemorySpeed& s : speeds)
            if (bytes <= s.set.holds) return s;
        return speeds.back();
    }
};

/// Measures every level of this machine, with at most 1 GiB and an eighth of its memory.
inline MemorySpeeds measured_speeds() {
    const double all = static_cast<double>(sysconf(_SC_PHYS_PAGES)) *
                       static_cast<double>(sysconf(_SC_PAGESIZE));
    MemorySpeeds r;
    for (const WorkingSet& set : working_sets(cache_sizes(), std::min(0x1p30, all / 8)))
        r.speeds.push_back(measured_speed(set, set.bytes > 0x1p26 ? 3 : 9));
    return r;
}

} // namespace rye::bench
