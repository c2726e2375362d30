// SPDX-License-Identifier: Apache-2.0
/// benchmarks/roofline/order.hpp: how fast a thread sorts keys, and how fast it appends entries to
/// lists, each as a loop that does nothing else.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include <rye/core/random.hpp>
#include <rye/splat/tile_lists.hpp>

#include "clock.hpp"

namespace rye::bench {

/// Measures 32-bit keys sorted with 32-bit values, 100000 of them [1/s].
inline double sorted_keys() {
    constexpr std::size_t n = 100000;
    std::vector<Keyed<std::uint32_t>> unsorted(n), x(n), buffer(n);
    const Random random{1, 1};
    for (std::size_t i = 0; i < n; ++i)
        unsorted[i] = {static_cast<std::uint32_t>(random.bits(i) >> 32U),
                       static_cast<std::uint32_t>(i)};
    double least = 1e30;
    for (int i = 0; i < 15; ++i) {
        x = unsorted;
        least = std::min(least,
                         least_time(
                             1, [&] { sort_by_key(x.data(), buffer.data(), Index(n)); },
                             wall_seconds));
    }
    return static_cast<double>(n) / least;
}

/// Measures entries of 4 bytes appended to 1024 lists whose lengths are known, 300000 of them in
/// three neighbouring lists at a time, as Gaussians reach tiles [1/s].
inline double appended_entries() {
    constexpr std::uint32_t lists = 1024, gaussians = 100000, reached = 3;
    const Random random{2, 1};
    std::vector<std::uint16_t> first(gaussians);
    std::vector<std::uint32_t> begin(lists + 1), cursor(lists), entry(gaussians * reached);
    for (std::uint32_t i = 0; i < gaussians; ++i) {
        first[i] = static_cast<std::uint16_t>(random.bits(i) % (lists - reached));
        for (std::uint32_t k = 0; k < reached; ++k) ++begin[first[i] + k + 1];
    }
    for (std::uint32_t i = 0; i < lists; ++i) begin[i + 1] += begin[i];
    const auto append = [&] {
        std::copy_n(begin.begin(), lists, cursor.begin());
        for (std::uint32_t i = 0; i < gaussians; ++i)
            for (std::uint32_t k = 0; k < reached; ++k) entry[cursor[first[i] + k]++] = i;
        opaque(entry[0]);
    };
    const double least = least_time(15, append, wall_seconds);
    return gaussians * double(reached) / least;
}

} // namespace rye::bench
