// SPDX-License-Identifier: Apache-2.0
/// rye/splat/tile_lists.hpp: for each tile its Gaussians in the order of depth, ties by index. They
/// are binned in memory order, where neighbours share tiles, and each tile's list is sorted by
/// itself, within the cache. Counts are 64-bit.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <concepts>
#include <cstdint>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <rye/core/error.hpp>
#include <rye/core/memory.hpp>
#include <rye/core/parallel.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/splat/tiles.hpp>

namespace rye {

/// A value that is sorted by a key.
template <class Key, class Value = std::uint32_t>
struct Keyed {
    Key key;
    Value value;
};

/// Sorts n values by their keys, stable; the buffer has room for as many. Radix, from the lowest of
/// the bits in which the keys differ. Two digits of the highest bits leave little out of order
/// unless keys cluster: what is left is inserted, and when that moves too much, all digits sort.
template <class Key, class Value>
void sort_by_key(Keyed<Key, Value>* x, Keyed<Key, Value>* buffer, Index n) {
    using Item = Keyed<Key, Value>;
    constexpr int widest = 11;
    constexpr Index few = 16, moves_each = 8;
    /// Returns false if it gave up; x holds the same values then.
    const auto insert = [&](Index allowed) {
        for (Index i = 1; i < n; ++i) {
            const Item moved = x[i];
            Index to = i;
            for (; to > 0 && moved.key < x[to - 1].key; --to) x[to] = x[to - 1];
            x[to] = moved;
            if ((allowed -= i - to) < 0) return false;
        }
        return true;
    };
    if (n <= few) {
        insert(n * n);
        return;
    }
    Key low = x[0].key, high = low;
    for (Index i = 1; i < n; ++i) {
        low = std::min(low, x[i].key);
        high = std::max(high, x[i].key);
    }
    const int bits = static_cast<int>(std::bit_width(static_cast<Key>(high - low)));
    const int digit = std::min(
        widest, static_cast<int>(std::bit_width(static_cast<std::uint64_t>(n))));
    std::array<std::uint32_t, (1 << widest)> even, odd;
    const std::size_t mask = (std::size_t(1) << digit) - 1;
    /// Sorts by the two digits above `shift`, from x to the buffer and back.
    const auto two_digits = [&](int shift) {
        const auto bucket = [&](Key key, int up) {
            return static_cast<std::size_t>((key - low) >> shift >> up) & mask;
        };
        std::fill_n(even.begin(), mask + 1, 0U);
        std::fill_n(odd.begin(), mask + 1, 0U);
        for (Index i = 0; i < n; ++i) {
            ++even[bucket(x[i].key, 0)];
            ++odd[bucket(x[i].key, digit)];
        }
        std::uint32_t sum = 0, same = 0;
        for (std::size_t b = 0; b <= mask; ++b) {
            sum += std::exchange(even[b], sum);
            same += std::exchange(odd[b], same);
        }
        for (Index i = 0; i < n; ++i) buffer[even[bucket(x[i].key, 0)]++] = x[i];
        for (Index i = 0; i < n; ++i) x[odd[bucket(buffer[i].key, digit)]++] = buffer[i];
    };
    two_digits(std::max(0, bits - 2 * digit));
    if (insert(moves_each * n)) return;
    for (int shift = 0; shift < bits; shift += 2 * digit) two_digits(shift);
}

/// A Gaussian that a tile's list holds.
struct Intersection {
    std::uint32_t member;
    std::uint32_t slot;                   ///< place among its member's slots
    bool operator==(const Intersection&) const = default;
};

namespace detail {

/// Memory that lists are made in; it holds no state between calls.
template <class Key>
struct BinScratch {
    using Binned = Keyed<Key, Intersection>;
    /// A tile and a member that reaches it.
    struct Mention {
        std::uint32_t tile, member;
    };
    /// Counts and bins of one chunk of members.
    struct Chunk {
        std::vector<Mention> mentions;    ///< member by member, in the order of tiles
        std::int64_t used;                ///< number of mentions, or the number that there would be
        std::vector<std::uint32_t> cursor; ///< [lists] index of the chunk's next entry
    };
    std::vector<Chunk> chunks;
    std::vector<Binned> binned;
    std::vector<std::vector<Binned>> buffers;  ///< [runs of tiles]
};

/// Members to be binned: key(m) is the distance of m; of equal ones the lower index(m) comes first;
/// footprint(m) is a Footprint, and pixel_rows(m) its rows of pixels, not empty.
template <class PixelRows, class KeyOf, class IndexOf, class Footprints>
    requires std::derived_from<std::remove_cvref_t<std::invoke_result_t<PixelRows, Index>>, Span>
struct BinInput {
    Index count;
    PixelRows pixel_rows;
    KeyOf key;
    IndexOf index;
    Footprints footprint;
};
template <class PixelRows, class KeyOf, class IndexOf, class Footprints>
BinInput(Index, PixelRows, KeyOf, IndexOf, Footprints)
    -> BinInput<PixelRows, KeyOf, IndexOf, Footprints>;

} // namespace detail

/// Lists of each tile's Gaussians, near to far. Visible Gaussians are members 0, 1, ... in the
/// order of the tiles that they lie in, so that a tile reads adjacent memory.
struct TileLists {
    using Entry = Intersection;
    int columns = 0, rows = 0;            ///< numbers of tiles
    std::vector<Index> begin;             ///< tile t holds entries [begin[t], begin[t + 1])
    std::vector<Entry> entry;
    std::vector<Index> first;             ///< member m owns slots [first[m], first[m + 1]), in the
                                          ///< order of tiles

    Index tiles() const { return static_cast<Index>(columns) * rows; }
    Index entries() const { return begin.empty() ? 0 : begin.back(); }

    /// Bins members into the tiles of an image.
    /// The lists take at most max_memory bytes, with the scratch memory that they are made in.
    template <Support support, Real R, Threads P, class Members, class Key>
    void build(const P& threads, ImageSize size, const Members& members, std::uint64_t max_memory,
               detail::BinScratch<Key>& scratch) {
        columns = tiles_across(size.width);
        rows = tiles_across(size.height);
        bin<support, R>(threads, size, members, max_memory, scratch);
        sort(threads, members.index, scratch);
    }

    /// Memory of an entry and of its making: a mention, a key with it, and the buffer of a run of
    /// tiles [bytes].
    template <class Key = std::uint32_t>
    static constexpr std::uint64_t entry_bytes = sizeof(typename detail::BinScratch<Key>::Mention) +
                                                 sizeof(Intersection) +
                                                 sizeof(typename detail::BinScratch<Key>::Binned) *
                                                     5 / 4;

    /// Returns the entries that so much memory holds, which 32 bits count.
    template <class Key = std::uint32_t>
    static constexpr std::int64_t most_entries(std::uint64_t max_memory) {
        return static_cast<std::int64_t>(
            std::min<std::uint64_t>(max_memory / entry_bytes<Key>, 0xFFFFFFFF));
    }

    /// Throws Error if the entries take more memory than allowed.
    template <class Key = std::uint32_t>
    static void check_entries(std::int64_t total, std::uint64_t max_memory) {
        if (total > most_entries<Key>(max_memory))
            throw Error("rasterizer: got " + std::to_string(total) +
                        " pairs of a tile and a Gaussian, whose lists would take " +
                        std::to_string(saturated_product(static_cast<std::uint64_t>(total),
                                                         entry_bytes<Key>)) +
                        " bytes of memory, expected at most the limit of " +
                        std::to_string(std::min(max_memory, 0xFFFFFFFF * entry_bytes<Key>)) +
                        ": the Gaussians are too large for the image");
    }

    /// Number of mentions that all chunks write before their total is compared with the limit.
    static constexpr Index most_unchecked = Index(1) << 24;

  private:
    static constexpr int mention_slack = 4;  // written beyond those that count

    template <class X>
    static auto& at(X& x, Index i) {
        return x[static_cast<std::size_t>(i)];
    }

    /// Bins members in as many chunks as there are threads. A chunk's place in a tile's list
    /// follows from the counts of the chunks before it, so lists do not depend on the chunks.
    template <Support support, Real R, Threads P, class Members, class Key>
    void bin(const P& threads, ImageSize size, const Members& members, std::uint64_t max_memory,
             detail::BinScratch<Key>& scratch) {
        const Index n = members.count;
        const std::int64_t max_entries = most_entries<Key>(max_memory);
        using Chunk = typename detail::BinScratch<Key>::Chunk;
        const Index grain = std::max<Index>(512, (n + threads.size() - 1) / threads.size());
        const Index chunks = detail::chunk_count(n, grain);
        if (static_cast<Index>(scratch.chunks.size()) < chunks)
            scratch.chunks.resize(static_cast<std::size_t>(chunks));
        first.resize(static_cast<std::size_t>(n) + 1);
        // Chunks of more mentions are only counted at first, and written once the total is allowed:
        // a refusal costs little memory.
        const std::int64_t unchecked =
            std::min<std::int64_t>(max_entries, most_unchecked / std::max<Index>(chunks, 1));
        const auto write = [&](Index b, Index e, Chunk& chunk, std::int64_t allowed) {
            chunk.used = 0;
            for (Index m = b; m < e; ++m) {
                at(first, m) = static_cast<Index>(chunk.used);
                mention<support, R>(size, members, m, allowed, chunk);
            }
            if (chunk.used > allowed) return;
            chunk.cursor.assign(static_cast<std::size_t>(tiles()), 0);
            for (Index i = 0; i < chunk.used; ++i) ++chunk.cursor[at(chunk.mentions, i).tile];
        };
        for_chunks(threads, n, grain, [&](Index b, Index e, Index c) {
            write(b, e, at(scratch.chunks, c), unchecked);
        });
        std::int64_t total = 0, most = 0;
        for (Index c = 0; c < chunks; ++c) {
            total += at(scratch.chunks, c).used;
            most = std::max(most, at(scratch.chunks, c).used);
        }
        check_entries<Key>(total, max_memory);
        if (most > unchecked)
            for_chunks(threads, n, grain, [&](Index b, Index e, Index c) {
                Chunk& chunk = at(scratch.chunks, c);
                if (chunk.used <= unchecked) return;
                const auto need = static_cast<std::size_t>(chunk.used + mention_slack);
                if (chunk.mentions.size() < need) chunk.mentions.resize(need);
                write(b, e, chunk, max_entries);
            });
        at(first, n) = static_cast<Index>(total);
        begin.resize(static_cast<std::size_t>(tiles()) + 1);
        std::uint32_t next = 0;
        for (Index t = 0; t < tiles(); ++t) {
            at(begin, t) = static_cast<Index>(next);
            for (Index c = 0; c < chunks; ++c)
                next += std::exchange(at(at(scratch.chunks, c).cursor, t), next);
        }
        at(begin, tiles()) = static_cast<Index>(total);
        if (scratch.binned.size() < static_cast<std::size_t>(total))
            scratch.binned.resize(static_cast<std::size_t>(total));
        for_chunks(threads, n, grain, [&](Index b, Index e, Index c) {
            Index before = 0;
            for (Index k = 0; k < c; ++k) before += static_cast<Index>(at(scratch.chunks, k).used);
            if (before > 0)
                for (Index m = b; m < e; ++m) at(first, m) += before;
            Chunk& chunk = at(scratch.chunks, c);
            auto* const to = scratch.binned.data();
            std::uint32_t* const cursor = chunk.cursor.data();
            const auto* const mentions = chunk.mentions.data();
            for (Index i = 0; i < chunk.used; ++i) {
                const auto& [tile, member] = mentions[i];
                to[cursor[tile]++] = {members.key(static_cast<Index>(member)),
                                      {member, static_cast<std::uint32_t>(before + i)}};
            }
        });
    }

    /// Appends the tiles of member m to its chunk's, or, beyond the limit, counts them.
    template <Support support, Real R, class Members, class Chunk>
    void mention(ImageSize size, const Members& members, Index m, std::int64_t max_entries,
                 Chunk& chunk) const {
        const auto& pixel_rows = members.pixel_rows(m);
        using Rows = std::remove_cvref_t<decltype(pixel_rows)>;
        constexpr int at_once = mention_slack;  // tiles of a row, even beyond its end
        const auto member = static_cast<std::uint32_t>(m);
        const auto append = [&](int row, int from, int count, int most) {
            const std::int64_t used = chunk.used;
            chunk.used += count;
            if (chunk.used > max_entries) return;
            const std::size_t need = static_cast<std::size_t>(used + std::max(count, most));
            if (chunk.mentions.size() < need) chunk.mentions.resize(need + need / 2);
            auto* const to = chunk.mentions.data() + used;
            const auto tile = static_cast<std::uint32_t>(row * columns + from);
            for (int x = 0; x < most; ++x) to[x] = {tile + static_cast<std::uint32_t>(x), member};
            for (int x = most; x < count; ++x)
                to[x] = {tile + static_cast<std::uint32_t>(x), member};
        };
        if constexpr (std::same_as<Rows, detail::TileRows>)
            if (pixel_rows.known(size.width)) {
                // The few rows are taken without asking how many there are.
                const int row = pixel_rows.first_row(), rows_here = pixel_rows.last_row() - row;
                for (int y = 0; y < detail::TileRows::most; ++y) {
                    const auto& c = pixel_rows.columns[static_cast<std::size_t>(y)];
                    append(row + y, c[0], y < rows_here ? c[1] - c[0] : 0, at_once);
                }
                return;
            }
        each_tile_row<support, R>(
            size.width, size.height, pixel_rows,
            [&]() -> const Footprint<R>& { return members.footprint(m); },
            [&](const detail::TileRowSpan& s) { append(s.row, s.begin, s.end - s.begin, 0); });
    }

    /// Sorts each tile's list.
    template <Threads P, class IndexOf, class Key>
    void sort(const P& threads, const IndexOf& index, detail::BinScratch<Key>& scratch) {
        constexpr Index run = 8;         // tiles: their lists differ in length
        entry.resize(static_cast<std::size_t>(entries()));
        if (static_cast<Index>(scratch.buffers.size()) < detail::chunk_count(tiles(), run))
            scratch.buffers.resize(static_cast<std::size_t>(detail::chunk_count(tiles(), run)));
        for_chunks(threads, tiles(), run, [&](Index b, Index e, Index c) {
            auto& buffer = at(scratch.buffers, c);
            for (Index t = b; t < e; ++t) {
                const Index n = at(begin, t + 1) - at(begin, t);
                if (static_cast<Index>(buffer.size()) < n)
                    buffer.resize(static_cast<std::size_t>(n + n / 2));
                auto* const x = scratch.binned.data() + at(begin, t);
                sort_by_key(x, buffer.data(), n);
                for (Index i = 0; i < n;) {      // equal keys: the lower index first
                    Index end = i + 1;
                    while (end < n && x[end].key == x[i].key) ++end;
                    if (end - i > 1)
                        std::sort(x + i, x + end, [&](const auto& u, const auto& v) {
                            return index(static_cast<Index>(u.value.member)) <
                                   index(static_cast<Index>(v.value.member));
                        });
                    i = end;
                }
                Entry* const to = entry.data() + at(begin, t);
                for (Index i = 0; i < n; ++i) to[i] = x[i].value;
            }
        });
    }
};

} // namespace rye
