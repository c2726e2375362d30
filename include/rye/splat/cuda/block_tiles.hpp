// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/block_tiles.hpp: the tiles of a block's Gaussians, shared evenly among its
/// threads.
#pragma once

#include <rye/splat/cuda/records.hpp>

namespace rye::detail {

/// The tiles of a block's Gaussians as one row of tasks, so that its threads share them evenly; so
/// are the rows of those Gaussians that are in many rows of tiles, then the tiles of these rows.
struct BlockTiles {
    static constexpr int threads = 128;
    TileSpans spans[threads];
    std::uint32_t places[threads]; ///< number of a Gaussian's tiles
    std::uint32_t before[threads]; ///< tasks of Gaussians before each
    std::uint32_t tall;            ///< number of Gaussians in many rows
    std::uint32_t index[threads];  ///< those Gaussians
    std::uint32_t rows_before[threads], places_before[threads]; ///< of each of them
    /// Of some of their rows: whose, the row, its first column, tiles in rows before it.
    std::uint32_t row_of[threads], row[threads], column[threads], row_before[threads];

    /// A Gaussian's tile.
    struct Task {
        std::uint32_t own;  ///< number of the Gaussian in the block
        std::uint32_t rank; ///< number of the tile among those of the Gaussian, by rows
        int row, column;
    };

    /// Enters Gaussian t, whose spans are set, with its number of tiles.
    template <class Block>
    RYE_DEVICE void put(Block& block, int t, std::uint32_t count) {
        const bool is_tall = spans[t].rows > TileSpans::most;
        places[t] = count;
        before[t] = is_tall ? 0U : count;
        if (is_tall) index[block.add(&tall, 1U)] = static_cast<std::uint32_t>(t);
    }

    /// Calls first(task) for all tiles of the block, and later last(task, what that gave):
    /// accesses to memory in `first` are under way together.
    template <Support support, class Block, class First, class Last>
    RYE_DEVICE void each(Block& block, const Footprint<float>* footprints, int width, int height,
                         const First& first, const Last& last) {
        const std::uint32_t tasks = block.exclusive_sums(before);
        block.each_thread([&](int t) {
            some(
                t, tasks, [&](std::uint32_t k) { return task(k); }, first, last);
        });
        if (tall == 0) return;
        block.each_thread([&](int t) {
            const bool has = static_cast<std::uint32_t>(t) < tall;
            rows_before[t] = has ? spans[index[t]].rows : 0U;
            places_before[t] = has ? places[index[t]] : 0U;
        });
        const std::uint32_t rows = block.exclusive_sums(rows_before);
        block.exclusive_sums(places_before);
        std::uint32_t done = 0;
        for (std::uint32_t from = 0; from < rows; from += threads) {
            block.each_thread([&](int t) {
                const std::uint32_t r = from + static_cast<std::uint32_t>(t);
                row_before[t] = 0;
                if (r >= rows) return;
                const std::uint32_t of = search(rows_before, r), own = index[of];
                const Cover<support, float> cover{footprints[own], width, height};
                const int y = spans[own].first + static_cast<int>(r - rows_before[of]);
                const Span x = cover.columns(y, cover.rows());
                row_of[t] = of;
                row[t] = static_cast<std::uint32_t>(y);
                column[t] = static_cast<std::uint32_t>(x.begin);
                row_before[t] = static_cast<std::uint32_t>(x.end - x.begin);
            });
            const std::uint32_t tiles = block.exclusive_sums(row_before);
            block.each_thread([&](int t) {
                const auto of_rows = [&](std::uint32_t k) {
                    const std::uint32_t r = search(row_before, k), of = row_of[r];
                    return Task{index[of], done + k - places_before[of], static_cast<int>(row[r]),
                                static_cast<int>(column[r] + k - row_before[r])};
                };
                some(t, tiles, of_rows, first, last);
            });
            done += tiles;
        }
    }

    /// Returns the last index whose number, of those that ascend from 0, is k or less.
    RYE_DEVICE static std::uint32_t search(const std::uint32_t* ascending, std::uint32_t k) {
        std::uint32_t low = 0;
        for (std::uint32_t step = threads / 2; step > 0; step /= 2)
            if (ascending[low + step] <= k) low += step;
        return low;
    }

  private:
    RYE_DEVICE Task task(std::uint32_t k) const {
        const std::uint32_t own = search(before, k), rank = k - before[own];
        const TileSpans& s = spans[own];
        int at = 0, rest = static_cast<int>(rank);
        for (int y = 0; y + 1 < TileSpans::most; ++y) {
            const int wide = s.end[y] - s.begin[y];
            if (at == y && y + 1 < s.rows && rest >= wide) rest -= wide, ++at;
        }
        return {own, rank, s.first + at, s.begin[at] + rest};
    }
    /// Does this thread's tasks among [0, n).
    template <class At, class First, class Last>
    RYE_DEVICE static void some(int t, std::uint32_t n, const At& at, const First& first,
                                const Last& last) {
        constexpr std::uint32_t at_once = 5; // the blocks of a head have 4.1 tasks a thread
        for (auto k = static_cast<std::uint32_t>(t); k < n; k += at_once * threads) {
            Task task[at_once];
            decltype(first(task[0])) given[at_once];
            repeated<int(at_once)>([&](auto e) {
                const std::uint32_t own = k + e * static_cast<std::uint32_t>(threads);
                if (own < n) {
                    task[e] = at(own);
                    given[e] = first(task[e]);
                }
            });
            repeated<int(at_once)>([&](auto e) {
                if (k + e * static_cast<std::uint32_t>(threads) < n) last(task[e], given[e]);
            });
        }
    }
};

} // namespace rye::detail
