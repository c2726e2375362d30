// SPDX-License-Identifier: Apache-2.0
/// rye/interactive/tile_changes.hpp: update of a tile's sorted list when some Gaussians change:
/// their old entries leave and their new ones are merged in.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>

#include <rye/core/config.hpp>

namespace rye::detail {

/// Changes of one tile's list.
struct TileChange {
    static constexpr std::uint32_t whole_tile = 0xFFFFFFFF;
    /// Limit on changes for which the overlapped strips are found, which costs a few percent of
    /// blending; more changes overlap most strips anyway.
    static constexpr std::uint32_t most_few = 64;

    std::uint32_t left = 0, entered = 0;  ///< number of entries
    std::uint32_t fresh = 0;              ///< offset of its entering entries among all of them
    std::uint32_t mask = whole_tile;      ///< index of its strip mask, if blended in part
    bool redraw = false;

    bool changes() const { return left + entered > 0; }
    bool few() const { return changes() && left + entered <= most_few; }
};

/// Merges into `to` the entries of `old` that have not left and those of `entered`, both sorted.
/// Returns the number of leading entries equal to the old list's.
template <class Entry, class Left, class Nearer>
Index merge_entries(std::span<const Entry> old, std::span<const Entry> entered, Entry* to,
                    const Left& left, const Nearer& nearer) {
    const Entry *from = old.data(), *const end = from + old.size();
    const Entry *fresh = entered.data(), *const fresh_end = fresh + entered.size();
    const Entry* const begin = to;
    Index same = end - from;
    const auto differ = [&] { same = std::min<Index>(same, to - begin); };
    for (; from < end; ++from) {
        if (left(*from)) {
            differ();
            continue;
        }
        while (fresh < fresh_end && nearer(*fresh, *from)) {
            differ();
            *to++ = *fresh++;
        }
        *to++ = *from;
    }
    if (fresh < fresh_end) differ();
    std::copy(fresh, fresh_end, to);
    return same;
}

} // namespace rye::detail
