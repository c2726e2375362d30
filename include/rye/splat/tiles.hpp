// SPDX-License-Identifier: Apache-2.0
/// rye/splat/tiles.hpp: which Gaussians can be seen in which tile, in the order of depth.
/// The visible Gaussians are sorted once (stable, ties by index), then dealt out in that order, so
/// that every tile's list is sorted. Pixel units; counts are 64-bit.
/// Source: bounds as in Radl et al., "StopThePop", 2024, but per row of tiles and exact.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <rye/core/error.hpp>
#include <rye/core/parallel.hpp>
#include <rye/math/linalg.hpp>
#include <rye/splat/accuracy.hpp>

namespace rye {

/// Side of a tile [px]: 8 and 16 were tried; the larger halves the entries.
inline constexpr int tile_edge = 16;
inline constexpr int tile_pixels = tile_edge * tile_edge;

/// The region where a Gaussian's alpha can reach alpha_min: an ellipse, or a square.
template <class R>              // Real, or a batch of them
struct Footprint {
    R x, y;                      ///< centre in the image [px]
    R radius;                    ///< [standard deviations]; of a square: half its side [px]
    Sym2<R> covariance;          ///< [px^2]
    R determinant;               ///< [px^4]
};

/// Pixels or tiles [begin, end).
struct Span {
    int begin = 0, end = 0;
};

/// Whole pixels whose centres lie in [low, high], cut to [0, size); the cast is of a clamped value.
template <Real R>
Span pixels_between(R low, R high, int size) {
    const R top = static_cast<R>(size);
    const R b = std::ceil(std::clamp(low - R(0.5), R(0), top));
    const R e = std::floor(std::clamp(high - R(0.5), R(-1), top)) + R(1);
    return {static_cast<int>(b), std::min(size, static_cast<int>(e))};
}

/// The footprint's rows of pixels, and for each row of tiles its columns of tiles.
template <Support support, Real R>
struct Cover {
    Footprint<R> f;
    int width, height;           ///< of the image [px]

    /// Rounding moves a bound by a few units in the last place of a position; this covers it.
    R slack() const {
        return R(8) * std::numeric_limits<R>::epsilon() *
               (std::abs(f.x) + std::abs(f.y) + f.radius * std::sqrt(f.covariance.xx) +
                f.radius * std::sqrt(f.covariance.yy) + R(1));
    }

    Span rows() const {
        if constexpr (support == Support::square) return square(f.y, height);
        const R reach = f.radius * std::sqrt(f.covariance.yy) + slack();
        return pixels_between(f.y - reach, f.y + reach, height);
    }

    /// Columns of tiles of tile row `row`, whose pixels within `rows` are all that count.
    Span columns(int row, const Span& rows) const { return columns_of(rows)(row); }

    /// The same as a function of the row.
    auto columns_of(const Span& rows) const {
        if constexpr (support == Support::square)
            return [px = square(f.x, width)](int) { return tiles_of(px); };
        else
            return Slabs{*this, rows};
    }

  private:
    static Span tiles_of(const Span& px) {
        if (px.begin >= px.end) return {};
        return {px.begin / tile_edge, (px.end - 1) / tile_edge + 1};
    }

    /// The widest part of the ellipse within a row of tiles.
    struct Slabs {
        R x, y, slack;
        R tilt;                      ///< of E[x | y]
        R widest;                    ///< y of the rightmost point
        R square, inverse_yy, left_over;
        Span rows;
        int width;

        Slabs(const Cover& c, const Span& r) : x(c.f.x), y(c.f.y), slack(c.slack()), rows(r),
                                               width(c.width) {
            const Footprint<R>& f = c.f;
            inverse_yy = R(1) / f.covariance.yy;
            tilt = f.covariance.xy * inverse_yy;
            widest = f.radius * f.covariance.xy / std::sqrt(f.covariance.xx);
            square = f.radius * f.radius;
            left_over = f.determinant * inverse_yy;
        }
        Span operator()(int row) const {
            const R top = static_cast<R>(std::max(row * tile_edge, rows.begin)) + R(0.5) - y;
            const R bottom =
                static_cast<R>(std::min((row + 1) * tile_edge, rows.end) - 1) + R(0.5) - y;
            return tiles_of(pixels_between(x + end(-widest, top, bottom, R(-1)) - slack,
                                           x + end(widest, top, bottom, R(1)) + slack, width));
        }
        /// Left (-1) or right (+1) end of the ellipse at the y in [top, bottom] nearest to `at`.
        R end(R nearest, R top, R bottom, R side) const {
            const R at = std::clamp(nearest, top, bottom);
            const R rest = std::max(R(0), square - at * at * inverse_yy);
            return tilt * at + side * std::sqrt(rest * left_over);
        }
    };

    /// The 16 px tiles that [centre - radius, centre + radius] touches, as pixels.
    Span square(R centre, int size) const {
        constexpr int coarse = 16;
        const R top = static_cast<R>(size + coarse), p = centre - R(0.5);  // its pixel origin
        const int low = static_cast<int>(std::clamp(p - f.radius, R(0), top));
        const int high = static_cast<int>(std::clamp(p + f.radius + R(coarse - 1), R(0), top));
        return {std::min(size, low / coarse * coarse), std::min(size, high / coarse * coarse)};
    }
};

/// Bits that compare as the non-negative number does.
template <Real R>
auto depth_key(R depth) {
    using Bits = std::conditional_t<sizeof(R) == 4, std::uint32_t, std::uint64_t>;
    const Bits b = std::bit_cast<Bits>(depth);
    constexpr Bits sign = Bits(1) << (8 * sizeof(Bits) - 1);
    return (b & sign) != 0 ? static_cast<Bits>(~b) : static_cast<Bits>(b | sign);
}

/// Scratch of sort_by_key.
template <class Key>
struct SortBuffer {
    std::vector<Key> keys;
    std::vector<std::uint32_t> values;
};

/// Sorts values by key, stable: radix with 11-bit digits; a digit that all keys share is skipped.
template <class Key>
void sort_by_key(std::vector<Key>& keys, std::vector<std::uint32_t>& values,
                 SortBuffer<Key>& buffer) {
    constexpr int digit = 11, buckets = 1 << digit;
    constexpr int bits = 8 * static_cast<int>(sizeof(Key)), passes = (bits + digit - 1) / digit;
    const std::size_t n = keys.size();
    if (n < 2) return;
    buffer.keys.resize(n);
    buffer.values.resize(n);
    std::vector<std::uint32_t> histogram(static_cast<std::size_t>(passes * buckets), 0U);
    const auto bucket = [](Key k, int pass) {
        return static_cast<std::size_t>((k >> (pass * digit)) & static_cast<Key>(buckets - 1));
    };
    for (const Key k : keys)
        for (int p = 0; p < passes; ++p)
            ++histogram[static_cast<std::size_t>(p * buckets) + bucket(k, p)];
    for (int p = 0; p < passes; ++p) {
        std::uint32_t* h = histogram.data() + static_cast<std::ptrdiff_t>(p) * buckets;
        if (h[bucket(keys[0], p)] == n) continue;
        std::uint32_t sum = 0;
        for (int b = 0; b < buckets; ++b) {
            const std::uint32_t count = h[b];
            h[b] = sum;
            sum += count;
        }
        for (std::size_t i = 0; i < n; ++i) {
            const std::size_t to = h[bucket(keys[i], p)]++;
            buffer.keys[to] = keys[i];
            buffer.values[to] = values[i];
        }
        keys.swap(buffer.keys);
        values.swap(buffer.values);
    }
}

/// For each tile its Gaussians, near to far. Visible Gaussians are members 0, 1, ... in the order
/// of the tiles that they lie in, so that what a tile reads lies together.
struct TileLists {
    int columns = 0, rows = 0;            ///< of tiles
    std::vector<Index> begin;             ///< tile t holds entries [begin[t], begin[t + 1])
    std::vector<std::uint32_t> member;    ///< of each entry
    std::vector<std::uint32_t> slot;      ///< of each entry: its place among its member's
    std::vector<Index> first;             ///< member m owns slots [first[m], first[m + 1]), in the
                                          ///< order of tiles

    Index tiles() const { return static_cast<Index>(columns) * rows; }
    Index entries() const { return begin.empty() ? 0 : begin.back(); }

    /// Deals members out over an image, in the given order; footprint(m) is a Footprint, and
    /// pixel_rows[m] its rows of pixels, not empty. The order is cut into chunks; where a chunk
    /// goes on in a tile's list follows from what the chunks before it have there.
    template <Threads P, Support support, Real R, class Footprints>
    void build(int width, int height, const std::vector<Span>& pixel_rows,
               const std::vector<std::uint32_t>& order, Index max_entries,
               const Footprints& footprint) {
        const Index n = static_cast<Index>(order.size());
        const Index grain = std::max<Index>(2048, (n + most_chunks - 1) / most_chunks);
        const Index chunks = chunk_count(n, grain);
        columns = (width + tile_edge - 1) / tile_edge;
        rows = (height + tile_edge - 1) / tile_edge;
        const auto at = [](auto& v, Index i) -> auto& { return v[static_cast<std::size_t>(i)]; };
        parts_.resize(std::max(parts_.size(), static_cast<std::size_t>(chunks)));
        first.resize(static_cast<std::size_t>(n) + 1);
        at(first, 0) = 0;

        for_chunks<P>(n, grain, [&](Index b, Index e, Index c) {
            Part& part = at(parts_, c);
            part.cursor.assign(static_cast<std::size_t>(tiles()), 0);
            part.spans.clear();
            for (Index i = b; i < e; ++i) {
                if (i + ahead < e) prefetch(footprint(at(order, i + ahead)));
                const std::uint32_t m = at(order, i);
                const Span& pixels = at(pixel_rows, m);
                const Cover<support, R> cover{footprint(m), width, height};
                const auto columns_of = cover.columns_of(pixels);
                Index count = 0;
                const int end = (pixels.end + tile_edge - 1) / tile_edge;
                for (int y = pixels.begin / tile_edge; y < end; ++y) {
                    const Span s = columns_of(y);
                    part.spans.push_back(s);
                    Index* const in_row = part.cursor.data() + Index(y) * columns;
                    for (int x = s.begin; x < s.end; ++x) ++in_row[x];
                    count += s.end - s.begin;
                }
                at(first, Index(m) + 1) = count;
            }
        });
        Index total = 0;
        for (Index m = 0; m < n; ++m) total = at(first, m + 1) += total;
        if (total > std::min(max_entries, Index(0xFFFFFFFF)))
            throw Error("rasterizer: got " + std::to_string(total) +
                        " pairs of a tile and a Gaussian, expected at most " +
                        std::to_string(max_entries) +
                        ": the Gaussians are too large for the image");
        begin.resize(static_cast<std::size_t>(tiles()) + 1);
        Index entry = 0;
        for (Index t = 0; t < tiles(); ++t) {
            at(begin, t) = entry;
            for (Index c = 0; c < chunks; ++c) {
                Index& cursor = at(at(parts_, c).cursor, t);
                entry += std::exchange(cursor, entry);
            }
        }
        at(begin, tiles()) = entry;
        member.resize(static_cast<std::size_t>(total));
        slot.resize(static_cast<std::size_t>(total));
        for_chunks<P>(n, grain, [&](Index b, Index e, Index c) {
            Part& part = at(parts_, c);
            const Span* span = part.spans.data();
            for (Index i = b; i < e; ++i) {
                if (i + ahead < e) prefetch(at(first, at(order, i + ahead)));
                const std::uint32_t m = at(order, i);
                const Span& pixels = at(pixel_rows, m);
                auto to_slot = static_cast<std::uint32_t>(at(first, m));
                const int end = (pixels.end + tile_edge - 1) / tile_edge;
                for (int y = pixels.begin / tile_edge; y < end; ++y, ++span) {
                    Index* const in_row = part.cursor.data() + Index(y) * columns;
                    for (int x = span->begin; x < span->end; ++x) {
                        const Index to = in_row[x]++;
                        at(member, to) = m;
                        at(slot, to) = to_slot++;
                    }
                }
            }
        });
    }

  private:
    static constexpr Index most_chunks = 16, ahead = 16;

    /// Of one chunk: the columns of tiles of each row of tiles, and where it goes on in each list.
    struct Part {
        std::vector<Span> spans;
        std::vector<Index> cursor;
    };
    std::vector<Part> parts_;

    /// Always inlined: g++ takes a function that only prefetches for one without effect.
    template <class X>
    [[gnu::always_inline]] static void prefetch(const X& x) {
        __builtin_prefetch(&x);
    }
};

} // namespace rye
