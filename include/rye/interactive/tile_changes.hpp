// SPDX-License-Identifier: Apache-2.0
/// rye/interactive/tile_changes.hpp: how a tile's sorted list of entries follows when some
/// Gaussians change: those leave it, and enter it again where they now belong.
#pragma once

#include <algorithm>
#include <cstdint>

#include <rye/core/config.hpp>

namespace rye {

/// What happens to one tile's list.
struct TileChange {
    static constexpr std::uint32_t whole_tile = 0xFFFFFFFF;
    /// Finding out which strips a change reaches costs a few percent of blending what it reaches;
    /// many changes reach most strips.
    static constexpr std::uint32_t most_few = 64;

    std::uint32_t left = 0, entered = 0;  ///< entries
    std::uint32_t fresh = 0;              ///< where those that entered begin among all of them
    std::uint32_t mask = whole_tile;      ///< place of its strips, if only some are drawn again
    bool redraw = false;

    bool changes() const { return left + entered > 0; }
    bool few() const { return changes() && left + entered <= most_few; }
};

/// Writes the entries [from, end) that have not left, and the sorted [fresh, fresh_end) among them,
/// to `to`. Returns how many entries at the front are those of the old list.
template <class Entry, class Left, class Nearer>
Index merge_entries(const Entry* from, const Entry* end, const Entry* fresh,
                    const Entry* fresh_end, Entry* to, const Left& left, const Nearer& nearer) {
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

} // namespace rye
