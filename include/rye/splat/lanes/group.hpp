// SPDX-License-Identifier: Apache-2.0
/// rye/splat/lanes/group.hpp: a tile's entries, made ready for lanes. A tile is cut into strips: as
/// many pixels as there are lanes, in two or four rows where that costs nothing. Entries are taken
/// in groups; each is evaluated once for what strips share. A strip then walks the entries that
/// reach it, from near to far, with what it sums up in registers.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <limits>
#include <type_traits>

#include <rye/math/exponential.hpp>
#include <rye/splat/blend.hpp>
#include <rye/splat/lanes/registers.hpp>

namespace rye::detail {

/// The strips of a tile, side by side and, of a side, row by row. Within a strip, lanes go down its
/// rows first; in one of four by four pixels along them. Strips that are less wide and higher meet
/// fewer Gaussians.
template <class V>
struct Strips {
    using T = typename V::value_type;
    static constexpr int lanes = static_cast<int>(V::size);
    static constexpr bool square = LoadsFours<V>;
    static constexpr int high = square ? 4 : LoadsPairs<V> ? 2 : 1; ///< [px]
    static constexpr int wide = lanes / high;            ///< [px]
    static constexpr int sides = tile_edge / wide;
    static constexpr int rows = tile_edge / high;        ///< strips of a side
    static constexpr int count = sides * rows;
    static_assert(tile_edge % wide == 0 && tile_edge % high == 0 && count <= StripMask::most);

    static constexpr int columns = square ? tile_edge : sides * lanes; ///< numbers of along_rows
    alignas(64) T x[std::size_t(columns)]; ///< pixel centres from the principal point [px], as
                                           ///< along_rows reads them
    alignas(64) T y[tile_edge];            ///< the same, by row
    int width, height;                   ///< extent of the part inside the image [px]
    Index tile;

    Strips(const Scene<T>& scene, Index of)
        : width(scene.right(of) - scene.left(of)),
          height(scene.bottom(of) - scene.top(of)),
          tile(of) {
        for (int i = 0; i < columns; ++i)
            x[i] = static_cast<T>(scene.left(tile) + (square ? i : i / high)) + T(0.5) - scene.cx;
        for (int i = 0; i < tile_edge; ++i)
            y[i] = static_cast<T>(scene.top(tile) + i) + T(0.5) - scene.cy;
    }
    /// Sets transmittance to 1 where a pixel is drawn, else to 0; a vector every `stride` numbers.
    void start(const StripMask& drawn, T* transmittance, Index stride) const {
        for (int s = 0; s < count; ++s)
            for (int lane = 0; lane < lanes; ++lane)
                transmittance[s * stride + lane] =
                    drawn.has(s) && row(s) + lane_row(lane) < height &&
                            side(s) * wide + lane_column(lane) < width
                        ? T(1)
                        : T(0);
    }
    /// Returns the strips of `drawn` that have a pixel inside the image.
    StripMask inside(StripMask drawn) const {
        if (width < tile_edge || height < tile_edge)
            for (int s = 0; s < count; ++s)
                if (row(s) >= height || side(s) * wide >= width) drawn.clear(s);
        drawn.keep(count);
        return drawn;
    }
    /// Returns a pixel's strip, or its lane, by its place in the tile [px].
    static int strip(int px, int py) { return px / wide * rows + py / high; }
    static int lane(int px, int py) {
        return square ? py % high * wide + px % wide : px % wide * high + py % high;
    }
    /// Returns a lane's column, or row, in its strip [px].
    static constexpr int lane_column(int lane) { return square ? lane % wide : lane / high; }
    static constexpr int lane_row(int lane) { return square ? lane / wide : lane % high; }
    /// Returns a strip's side, or its first row of pixels.
    static constexpr int side(int strip) { return strip / rows; }
    static constexpr int row(int strip) { return strip % rows * high; }
    /// Returns the first and the last of a side's centres.
    T first_x(int of) const { return x[square ? of * wide : of * lanes]; }
    T last_x(int of) const { return x[square ? of * wide + wide - 1 : of * lanes + lanes - 1]; }

    /// Returns the lanes of a side's strips for what varies along rows: `columns` numbers.
    [[gnu::always_inline]] static V along_rows(const T* numbers, int side) {
        if constexpr (square)
            return repeat_four<V>(numbers + side * wide);
        else
            return V::load_aligned(numbers + side * lanes);
    }
    /// Returns the lanes of a strip for what varies from row to row: a number a row of the tile.
    [[gnu::always_inline]] static V down_rows(const T* numbers, int first_row) {
        if constexpr (square)
            return spread_four<V>(numbers + first_row);
        else
            return repeat<high, V>(numbers + first_row);
    }
};

/// An entry as the strips see it.
template <class V>
struct alignas(64) LaneEntry {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    T v[Tile::columns];                    ///< v = this + down
    T exponent[Tile::columns];             ///< exponent = this - v^2
    T down[tile_edge];                     ///< offset of each row
    static constexpr int few = 8;          ///< channels at most
    T cut, floor, depth;
    T colour[few];                         ///< a few channels
};

/// A group of a tile's entries, and which of them reach each strip.
template <class V>
struct LaneGroup {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    static constexpr int lanes = Tile::lanes;
    static constexpr int most = 64;      ///< entries
    /// Best number of entries to take at once, unless sums of many channels go to memory and back
    /// with each group.
    static constexpr int usual = 32;

    LaneEntry<V> entry[most];
    std::uint64_t reaching[Tile::count]; ///< [strips] entries that reach it, a bit each

    /// Takes entries [first, last), with the features of C few channels; fetch(k) is called with
    /// each to prefetch what comes later.
    template <int C, class Fetch>
    void fill(const Scene<T>& scene, const Tile& tile, int top, Index first, Index last,
              const Fetch& fetch) {
        static_assert(C <= LaneEntry<V>::few);
        const int n = static_cast<int>(last - first);
        for (int k = 0; k < n; ++k) {
            fetch(first + k);
            share(scene.member(first + k), tile, top, k);
            if constexpr (C > 0) {
                const T* const from = scene.feature_of(first + k);
                unrolled<C>([&](auto c) { entry[k].colour[c] = from[c]; });
            }
        }
        for (int k = n; k % lanes != 0; ++k) begin_[k] = end_[k] = T(0);   // reach no row
        std::fill_n(reaching, Tile::count, std::uint64_t(0));
        for (int k = 0; k < n; k += lanes) reach(tile, k);
    }

  private:
    alignas(64) T x_[most], y_[most], ux_[most], vx_[most], vy_[most], lost_[most];
    alignas(64) T begin_[most], end_[most];      ///< rows of the tile

    /// Computes the terms of an entry that all strips share.
    [[gnu::always_inline]] void share(const VisibleGaussian<T>& member, const Tile& tile, int top,
                                      int k) {
        const Splat<T>& s = member.splat;
        x_[k] = s.x, y_[k] = s.y, ux_[k] = s.ux, vx_[k] = s.vx, vy_[k] = s.vy;
        lost_[k] = s.log2_opacity - s.cut;
        begin_[k] = static_cast<T>(member.rows.begin - top);
        end_[k] = static_cast<T>(member.rows.end - top);
        LaneEntry<V>& to = entry[k];
        to.cut = s.cut, to.floor = s.floor, to.depth = s.depth;
        unrolled<Tile::columns / lanes>([&](auto i) __attribute__((always_inline)) {
            const V dx = V::load_aligned(tile.x + i * lanes) - V(s.x);
            const V u = V(s.ux) * dx;
            (V(s.vx) * dx).store_aligned(to.v + i * lanes);
            less_square(V(s.log2_opacity), u).store_aligned(to.exponent + i * lanes);
        });
        unrolled<tile_edge / lanes>([&](auto i) __attribute__((always_inline)) {
            (V(s.vy) * (V::load_aligned(tile.y + i * lanes) - V(s.y)))
                .store_aligned(to.down + i * lanes);
        });
    }

    /// Marks the strips that entries k, k + 1, ... reach, an entry in each lane: those that meet
    /// the part of their rows where the exponent is not below the cut, and a bit more for rounding.
    /// In a row, u^2 + v^2 = s (dx - nearest)^2 + (ux down)^2 / s with s = ux^2 + vx^2.
    void reach(const Tile& tile, int k) {
        const auto load = [k](const T* from) { return V::load_aligned(from + k); };
        const V cx = load(x_), cy = load(y_), a = load(ux_), b = load(vx_), c = load(vy_);
        const V first = load(begin_), last = load(end_);
        const V inverse = V(T(1)) / (a * a + b * b);
        const V steepest = -b * inverse, share = a * a * inverse * inverse;
        const V farthest = max(abs(V(tile.y[0]) - cy), abs(V(tile.y[tile_edge - 1]) - cy));
        const V rounding = c * farthest + V(T(2 * tile_edge)) * (a + abs(b));
        const V budget = (load(lost_) + V(T(0x1p-10)) + V(T(0x1p-16)) * rounding) * inverse;
        const V none(std::numeric_limits<T>::lowest()), zero(T(0));
        std::array<V, std::size_t(Tile::sides)> low, high;   // pixels of each side
        unrolled<Tile::sides>([&](auto side) __attribute__((always_inline)) {
            low[side] = V(tile.first_x(side)) - cx;
            high[side] = V(tile.last_x(side)) - cx;
        });
        for (int i = 0; i < Tile::rows; ++i) {
            V left = -none, right = none;
            unrolled<Tile::high>([&](auto j) __attribute__((always_inline)) {
                const int row = i * Tile::high + j;
                const V at(static_cast<T>(row)), down = c * (V(tile.y[row]) - cy);
                const V nearest = steepest * down, allowed = budget - share * down * down;
                const auto some = at >= first && at < last && allowed >= zero;
                const V half = select(some, sqrt(allowed), none);
                left = min(left, nearest - half);
                right = max(right, nearest + half);
            });
            unrolled<Tile::sides>([&](auto side) __attribute__((always_inline)) {
                const auto meets = low[side] <= right && high[side] >= left;
                reaching[side * Tile::rows + i] |= lane_bits(meets) << k;
            });
        }
    }
};

/// The pixels of a strip, a lane each, with the cheapest instructions for masks.
struct LanePixels : PixelGroup {
    template <class V>
    [[gnu::always_inline]] static V when(const typename V::batch_bool_type& mask, const V& x) {
        return where(mask, x);
    }
    template <class V>
    [[gnu::always_inline]] static V full(const V& transmittance) {
        return transmittance | V(typename V::value_type(-0.0));
    }
};

/// 2^x by the polynomial of a degree, or by the library for 0 and for double, which no polynomial
/// is exact enough for.
template <int Degree, class T>
struct LaneExp2 {
    template <class V>
    [[gnu::always_inline]] V operator()(const V& x) const {
        if constexpr (Degree == 0 || std::is_same_v<T, double>)
            return V(Exp2Library()(x));
        else
            return Exp2Poly<Degree>::within(x);
    }
};

/// Blends along the entries of a strip, without a branch.
template <class A, class V>
struct LaneBlend : Blend<A, V, LanePixels, LaneExp2<A::exp2_degree, typename V::value_type>> {
    using LaneBlend::Blend::Blend;

    /// Calls visit(k, entry, contribution) for each entry of the group that reaches a strip, from
    /// near to far. One after another: several alphas side by side, or the first half of the next
    /// one, cost more than they hide.
    template <class F>
    [[gnu::always_inline]] void along(const LaneGroup<V>& group, int strip, V& transmittance,
                                      const F& visit) const {
        const int side = Strips<V>::side(strip), row = Strips<V>::row(strip);
        V t = transmittance;
        for (std::uint64_t todo = group.reaching[strip]; todo != 0; todo &= todo - 1) {
            const int k = std::countr_zero(todo);
            const LaneEntry<V>& entry = group.entry[k];
            const V v =
                Strips<V>::along_rows(entry.v, side) + Strips<V>::down_rows(entry.down, row);
            const V x = less_square(Strips<V>::along_rows(entry.exponent, side), v);
            visit(k, entry, this->take(this->coverage(x, V(entry.cut), V(entry.floor)), t));
        }
        transmittance = t;
    }

    /// Returns true if some pixel of a strip can still take a contribution.
    [[gnu::always_inline]] bool any_open(const V& transmittance) const {
        return any(this->open(transmittance));
    }
};

} // namespace rye::detail
