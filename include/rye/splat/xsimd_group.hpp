// SPDX-License-Identifier: Apache-2.0
/// rye/splat/xsimd_group.hpp: a tile's entries, made ready for lanes. A tile is cut into strips: as
/// many pixels of a row as there are lanes. Entries are taken in groups; each is evaluated once for
/// what all rows share. A visit is an entry at a strip that it reaches. Visits lie in one list,
/// entry by entry: neighbours in it belong to different strips and do not wait for each other, and
/// one long loop over it has no ends to mispredict.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <type_traits>

#include <rye/math/exponential.hpp>
#include <rye/splat/xsimd_lanes.hpp>

namespace rye {

/// The strips of a tile: that of a side and a row is number side tile_edge + row.
template <class V>
struct Strips {
    using T = typename V::value_type;
    static constexpr int lanes = static_cast<int>(V::size);
    static constexpr int sides = tile_edge / lanes;
    static constexpr int count = sides * tile_edge;
    static_assert(tile_edge % lanes == 0 && tile_edge <= 16 && count <= 128);

    alignas(64) T x[tile_edge];          ///< pixel centres from the principal point [px]
    alignas(64) T y[tile_edge];
    int width, height;                   ///< of the part inside the image [px]

    Strips(const Scene<T>& scene, Index tile)
        : width(scene.right(tile) - scene.left(tile)),
          height(scene.bottom(tile) - scene.top(tile)) {
        for (int i = 0; i < tile_edge; ++i) {
            x[i] = static_cast<T>(scene.left(tile) + i) + T(0.5) - scene.cx;
            y[i] = static_cast<T>(scene.top(tile) + i) + T(0.5) - scene.cy;
        }
    }
    /// Transmittance 1 where a pixel is drawn, else 0; a vector every `stride` numbers.
    void start(const StripMask& drawn, T* transmittance, Index stride) const {
        for (int s = 0; s < count; ++s)
            for (int lane = 0; lane < lanes; ++lane)
                transmittance[s * stride + lane] =
                    drawn.has(s) && s % tile_edge < height && s / tile_edge * lanes + lane < width
                        ? T(1)
                        : T(0);
    }
    static constexpr std::size_t side(std::size_t strip) { return strip / tile_edge; }
    static constexpr std::size_t row(std::size_t strip) { return strip % tile_edge; }
    static int strip(int px, int py) { return px / lanes * tile_edge + py; }
};

/// An entry as the strips see it.
template <class T>
struct alignas(64) LaneEntry {
    T v[tile_edge];                      ///< v = this + down[row]
    T exponent[tile_edge];               ///< exponent = this - v^2
    T down[tile_edge];
    T cut, floor, depth;
    T colour[4];                         ///< of a few channels
};

namespace detail {

/// The places of the bits that are set in a byte, a byte each, from the first in memory on.
inline constexpr auto bit_places = [] {
    std::array<std::uint64_t, 256> table{};
    for (std::size_t byte = 0; byte < 256; ++byte) {
        std::array<std::uint8_t, 8> places{};
        std::size_t n = 0;
        for (std::uint8_t bit = 0; bit < 8; ++bit)
            if ((byte >> bit & 1U) != 0) places[n++] = bit;
        table[byte] = std::bit_cast<std::uint64_t>(places);
    }
    return table;
}();

} // namespace detail

/// A group of a tile's entries and their visits.
template <class V>
struct LaneGroup {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    static constexpr int lanes = Tile::lanes;
    static constexpr int most = 32;      ///< entries
    static constexpr int words = (Tile::count + 31) / 32;
    using Open = std::array<std::uint32_t, std::size_t(words)>;  ///< a bit a strip

    LaneEntry<T> entry[most];
    int visits;
    std::uint8_t strip[most * Tile::count + 8];   ///< of each visit
    std::uint8_t of[most * Tile::count + 8];      ///< of each visit: its entry
    std::uint16_t end[most];                      ///< of each entry: where its visits end
    alignas(64) T alpha[most * Tile::count + 8][lanes];  ///< of each visit

    /// Takes entries [first, last); strips that are not open get no visits.
    void fill(const Scene<T>& scene, const Tile& tile, int top, Index first, Index last,
              const Open& open) {
        std::uint32_t rows[most];
        const int n = static_cast<int>(last - first);
        for (int k = 0; k < n; ++k) rows[k] = share(scene.member(first + k), tile, top, k);
        for (int k = 0; k < n; k += lanes) reach(tile, k);
        int count = 0;
        for (int k = 0; k < n; ++k) {
            const std::uint64_t self = every_byte * static_cast<std::uint64_t>(k);
            for (int b = 0; b < Tile::count / 8; ++b) {
                const std::size_t w = static_cast<std::size_t>(b) / 4;
                const std::uint32_t byte =
                    (strips_[w][k] & rows[k] & open[w]) >> (8 * (b % 4)) & 0xFFU;
                const std::uint64_t places = detail::bit_places[byte] +
                                             every_byte * static_cast<std::uint64_t>(8 * b);
                std::memcpy(strip + count, &places, 8);
                std::memcpy(of + count, &self, 8);
                count += std::popcount(byte);
            }
            end[k] = static_cast<std::uint16_t>(count);
        }
        visits = count;
        // What is read beyond the end by fours is a visit too.
        std::memset(strip + count, 0, 4);
        std::memset(of + count, 0, 4);
    }
    /// Of a strip's pixels.
    [[gnu::always_inline]] static V exponent(const LaneEntry<T>& e, std::size_t strip) {
        const std::size_t at = Tile::side(strip) * lanes;
        const V v = V::load_aligned(e.v + at) + V(e.down[Tile::row(strip)]);
        return V::load_aligned(e.exponent + at) - v * v;
    }

  private:
    static constexpr std::uint64_t every_byte = 0x0101010101010101U;
    static constexpr int sides_a_word = 32 / tile_edge;

    alignas(64) T x_[most], y_[most], ux_[most], vx_[most], vy_[most], lost_[most];
    std::uint32_t strips_[words][most];  ///< that each entry reaches, a bit each

    /// What all strips need of an entry; returns its rows, for each side of a word.
    [[gnu::always_inline]] std::uint32_t share(const Member<T>& member, const Tile& tile, int top,
                                               int k) {
        const Splat<T>& s = member.splat;
        x_[k] = s.x, y_[k] = s.y, ux_[k] = s.ux, vx_[k] = s.vx, vy_[k] = s.vy;
        lost_[k] = s.log2_opacity - s.cut;
        LaneEntry<T>& to = entry[k];
        to.cut = s.cut, to.floor = s.floor, to.depth = s.depth;
        unrolled<Tile::sides>([&](auto i) __attribute__((always_inline)) {
            const V dx = V::load_aligned(tile.x + i * lanes) - V(s.x);
            const V u = V(s.ux) * dx;
            (V(s.vx) * dx).store_aligned(to.v + i * lanes);
            (V(s.log2_opacity) - u * u).store_aligned(to.exponent + i * lanes);
            (V(s.vy) * (V::load_aligned(tile.y + i * lanes) - V(s.y)))
                .store_aligned(to.down + i * lanes);
        });
        const int b = std::max(0, member.rows.begin - top);
        const int e = std::min(tile_edge, member.rows.end - top);
        const std::uint32_t span =
            (1U << static_cast<unsigned>(e)) - (1U << static_cast<unsigned>(b));
        return span | span << static_cast<unsigned>(tile_edge);
    }

    /// Which strips entries k, k + 1, ... reach, an entry in each lane: those in which the highest
    /// exponent of a row is not below the cut; and a bit more for the rounding. In a row,
    /// u^2 + v^2 = s (dx - nearest)^2 + (ux down)^2 / s with s = ux^2 + vx^2.
    void reach(const Tile& tile, int k) {
        const auto load = [k](const T* from) { return V::load_aligned(from + k); };
        const V cx = load(x_), cy = load(y_), a = load(ux_), b = load(vx_), c = load(vy_);
        const V inverse = V(T(1)) / (a * a + b * b), zero(T(0));
        const V steepest = -b * inverse, share = a * a * inverse * inverse;
        const V farthest = max(abs(V(tile.y[0]) - cy), abs(V(tile.y[tile_edge - 1]) - cy));
        const V rounding = c * farthest + V(T(2 * tile_edge)) * (a + abs(b));
        const V budget = (load(lost_) + V(T(0x1p-10)) + V(T(0x1p-16)) * rounding) * inverse;
        std::array<V, std::size_t(Tile::sides)> low, high, bits;
        unrolled<Tile::sides>([&](auto side) __attribute__((always_inline)) {
            low[side] = V(tile.x[side * lanes]) - cx;
            high[side] = V(tile.x[side * lanes + lanes - 1]) - cx;
            bits[side] = zero;
        });
        T power = 1;
        for (int row = 0; row < tile_edge; ++row, power *= 2) {
            const V down = c * (V(tile.y[row]) - cy), nearest = steepest * down;
            const V allowed = budget - share * down * down;
            unrolled<Tile::sides>([&](auto side) __attribute__((always_inline)) {
                const V off = min(high[side], max(low[side], nearest)) - nearest;
                bits[side] = bits[side] + where(off * off <= allowed, V(power));
            });
        }
        for (int w = 0; w < words; ++w) {
            auto word = to_int(bits[std::size_t(w * sides_a_word)]);
            if constexpr (Tile::sides > 1)
                word = word | (to_int(bits[std::size_t(w * sides_a_word + 1)]) << tile_edge);
            alignas(64) typename decltype(word)::value_type number[lanes];
            word.store_aligned(number);
            for (int lane = 0; lane < lanes; ++lane)
                strips_[w][k + lane] = static_cast<std::uint32_t>(number[lane]);
        }
    }
};

/// What a Gaussian adds to a strip.
template <class V>
struct LaneShare {
    V alpha, before;         ///< and the transmittance in front of it
    V weight;                ///< alpha times before; 0 where nothing is added
};

/// One blend, strip by strip, without a branch. A full pixel keeps the transmittance with which it
/// got full: below `stop`, or, where a pixel stops before the blend that would take it there,
/// with its sign turned.
template <class A, class V>
struct LaneBlend {
    using T = typename V::value_type;
    static constexpr bool library = A::exp2_degree == 0 || std::is_same_v<T, double>;
    using Exp2 = Exp2Poly<A::exp2_degree == 0 ? 6 : A::exp2_degree>;
    V alpha_max, stop;

    explicit LaneBlend(const A& a)
        : alpha_max(static_cast<T>(a.alpha_max)), stop(static_cast<T>(a.stop)) {}

    /// The alpha of each visit of a group, several side by side; full pixels take none of it.
    void alphas(LaneGroup<V>& group) const {
        constexpr int side_by_side = 4;
        using Several = Bundle<V, side_by_side>;
        const V most = alpha_max;
        const int visits = group.visits;
        for (int i = 0; i < visits; i += side_by_side) {
            Several e;
            // Kept from here on: after a store the compiler would read the numbers again.
            std::array<const LaneEntry<T>*, side_by_side> of;
            unrolled<side_by_side>([&](auto k) __attribute__((always_inline)) {
                of[k] = group.entry + group.of[i + k];
                e.x[k] = LaneGroup<V>::exponent(*of[k], group.strip[i + k]);
            });
            // Exponents below the cut, and so those that the polynomial does not know, go unused.
            Several alpha;
            if constexpr (library)
                alpha = e.each(e, [](const V& x, const V&) { return V(Exp2Library()(x)); });
            else
                alpha = Exp2::within(e);
            T* const to = group.alpha[i];
            unrolled<side_by_side>([&](auto k) __attribute__((always_inline)) {
                V a = alpha.x[k];
                if constexpr (A::has_floor) a = a - V(of[k]->floor);
                where(e.x[k] >= V(of[k]->cut), V(min(most, a)))
                    .store_aligned(to + k * LaneGroup<V>::lanes);
            });
        }
    }

    /// What a visit adds to its strip.
    [[gnu::always_inline]] LaneShare<V> operator()(V alpha, V& transmittance) const {
        const V before = transmittance;
        if constexpr (A::stop_rule == Stop::inclusive) alpha = where(before >= stop, alpha);
        V weight = alpha * before;
        V behind = before - weight;
        if constexpr (A::stop_rule == Stop::exclusive) {
            const auto more = behind >= stop;        // never of a full pixel
            alpha = where(more, alpha);
            weight = where(more, weight);
            behind = select(more, behind, V(before | V(T(-0.0))));
        }
        transmittance = behind;
        return {alpha, before, weight};
    }

    /// A bit for each strip that can still take a contribution; false if none. Transmittances are
    /// a vector every `stride` numbers.
    bool open_strips(const T* transmittance, Index stride,
                     typename LaneGroup<V>::Open& open) const {
        open.fill(0);
        bool some = false;
        for (int s = 0; s < Strips<V>::count; ++s) {
            const V t = V::load_aligned(transmittance + s * stride);
            const V least = V(A::stop_rule == Stop::inclusive ? stop : V(T(0)));
            if (any(t >= least && t > V(T(0)))) {
                open[static_cast<std::size_t>(s) / 32] |= std::uint32_t(1) << (s % 32);
                some = true;
            }
        }
        return some;
    }
};

} // namespace rye
