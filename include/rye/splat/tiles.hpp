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
#include <vector>

#include <rye/core/error.hpp>
#include <rye/core/parallel.hpp>
#include <rye/math/linalg.hpp>
#include <rye/splat/accuracy.hpp>

namespace rye {

/// Side of a tile [px]: small, since most Gaussians of a head avatar span a few pixels.
inline constexpr int tile_edge = 8;
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
    Span columns(int row, const Span& rows) const {
        Span px;
        if constexpr (support == Support::square) {
            px = square(f.x, width);
        } else {
            // The widest point of the ellipse within the slab of these rows.
            const R top = static_cast<R>(std::max(row * tile_edge, rows.begin)) + R(0.5) - f.y;
            const R bottom =
                static_cast<R>(std::min((row + 1) * tile_edge, rows.end) - 1) + R(0.5) - f.y;
            const R sigma_x = std::sqrt(f.covariance.xx);
            const R tilt = f.covariance.xy / f.covariance.yy;              // of E[x | y]
            const R widest = f.radius * f.covariance.xy / sigma_x;   // y of the rightmost point
            const R s = slack();
            px = pixels_between(f.x + end(-widest, top, bottom, tilt, R(-1)) - s,
                                f.x + end(widest, top, bottom, tilt, R(1)) + s, width);
        }
        if (px.begin >= px.end) return {};
        return {px.begin / tile_edge, (px.end - 1) / tile_edge + 1};
    }

  private:
    /// Left (-1) or right (+1) end of the ellipse at the y in [top, bottom] nearest to `y`.
    R end(R y, R top, R bottom, R tilt, R side) const {
        const R at = std::clamp(y, top, bottom);
        const R left_over = std::max(R(0), f.radius * f.radius - at * at / f.covariance.yy);
        return tilt * at + side * std::sqrt(left_over * (f.determinant / f.covariance.yy));
    }

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
    std::vector<Index> first;             ///< member m owns places [first[m], first[m + 1])
    std::vector<Index> place;             ///< entries of a member, in the order of tiles

    Index tiles() const { return static_cast<Index>(columns) * rows; }
    Index entries() const { return begin.empty() ? 0 : begin.back(); }

    /// Deals members out over an image, in the given order; footprint(m) is a Footprint, and
    /// pixel_rows[m] its rows of pixels, not empty.
    template <Threads P, Support support, Real R, class Footprints>
    void build(int width, int height, const std::vector<Span>& pixel_rows,
               const std::vector<std::uint32_t>& order, Index max_entries,
               const Footprints& footprint) {
        const Index n = static_cast<Index>(pixel_rows.size());
        columns = (width + tile_edge - 1) / tile_edge;
        rows = (height + tile_edge - 1) / tile_edge;
        const auto tile_rows = [&](Index r) {
            const Span& p = pixel_rows[static_cast<std::size_t>(r)];
            return Span{p.begin / tile_edge, (p.end + tile_edge - 1) / tile_edge};
        };
        const auto at = [](auto& v, Index i) -> auto& { return v[static_cast<std::size_t>(i)]; };

        // Both passes below read the same spans, so counts and entries cannot disagree.
        first_span_.resize(static_cast<std::size_t>(n) + 1);
        at(first_span_, 0) = 0;
        for (Index r = 0; r < n; ++r) {
            const Span t = tile_rows(r);
            at(first_span_, r + 1) = at(first_span_, r) + (t.end - t.begin);
        }
        spans_.resize(static_cast<std::size_t>(at(first_span_, n)));
        for_chunks<P>(n, 2048, [&](Index b, Index e, Index) {
            for (Index r = b; r < e; ++r) {
                const Cover<support, R> cover{footprint(r), width, height};
                const Span t = tile_rows(r);
                for (int y = t.begin; y < t.end; ++y)
                    at(spans_, at(first_span_, r) + y - t.begin) =
                        cover.columns(y, at(pixel_rows, r));
            }
        });

        begin.assign(static_cast<std::size_t>(tiles()) + 1, 0);
        first.resize(static_cast<std::size_t>(n) + 1);
        Index total = 0;
        for (Index m = 0; m < n; ++m) {
            at(first, m) = total;
            const Span t = tile_rows(m);
            for (int y = t.begin; y < t.end; ++y) {
                const Span s = at(spans_, at(first_span_, m) + y - t.begin);
                for (int x = s.begin; x < s.end; ++x) ++at(begin, Index(y) * columns + x + 1);
                total += s.end - s.begin;
            }
            if (total > max_entries)
                throw Error("rasterizer: got more than " + std::to_string(max_entries) +
                            " pairs of a tile and a Gaussian, expected fewer: the Gaussians are "
                            "too large for the image");
        }
        at(first, n) = total;
        for (Index t = 0; t < tiles(); ++t) at(begin, t + 1) += at(begin, t);
        member.resize(static_cast<std::size_t>(total));
        place.resize(static_cast<std::size_t>(total));
        cursor_.assign(begin.begin(), begin.end());
        for (const std::uint32_t m : order) {
            const Span t = tile_rows(m);
            Index at_place = at(first, m);
            for (int y = t.begin; y < t.end; ++y) {
                const Span s = at(spans_, at(first_span_, m) + y - t.begin);
                for (int x = s.begin; x < s.end; ++x) {
                    const Index to = at(cursor_, Index(y) * columns + x)++;
                    at(member, to) = m;
                    at(place, at_place++) = to;
                }
            }
        }
    }

  private:
    std::vector<Span> spans_;
    std::vector<Index> first_span_, cursor_;
};

} // namespace rye
