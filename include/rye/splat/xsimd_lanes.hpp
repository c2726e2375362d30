// SPDX-License-Identifier: Apache-2.0
/// rye/splat/xsimd_lanes.hpp: what the tuned walks share. A tile is cut into strips: as many pixels
/// of a row as there are lanes. A tile's entries are taken in groups; each entry is evaluated once
/// for what all rows share, and joins the lists of the strips it reaches. Then each strip walks
/// its list with its pixels' state in registers.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <limits>
#include <memory>
#include <type_traits>
#include <utility>

#include <rye/backend/xsimd.hpp>
#include <rye/math/exponential.hpp>
#include <rye/splat/raster.hpp>

namespace rye {

/// A backend with vectors of T: for these the tuned walks run.
template <class B, class T>
concept LaneBackend = Backend<B> && Real<T> && requires { typename B::template batch<T>; };

/// f(0) ... f(N - 1) with constant arguments, so that arrays indexed by them stay in registers.
template <int N, class F>
[[gnu::always_inline]] inline void unrolled(F&& f) {
    [&]<int... I>(std::integer_sequence<int, I...>) __attribute__((always_inline)) {
        (f(std::integral_constant<int, I>()), ...);
    }(std::make_integer_sequence<int, N>());
}

/// Sum of a batch's lanes; the library renamed it.
template <class V>
typename V::value_type lane_sum(const V& x) {
    if constexpr (requires { reduce_add(x); })
        return reduce_add(x);
    else
        return hadd(x);
}

/// The sums of eight batches' lanes, into eight numbers at `to`.
template <class V>
[[gnu::always_inline]] inline void lane_sums(const std::array<V, 8>& x,
                                             typename V::value_type* to) {
    constexpr std::size_t lanes = V::size;
    if constexpr (8 % lanes == 0)
        for (std::size_t i = 0; i < 8; i += lanes) haddp(x.data() + i).store_unaligned(to + i);
    else
        for (std::size_t i = 0; i < 8; ++i) to[i] = lane_sum(x[i]);
}

/// Memory from a cache line's start: a vector across two lines is slow, and slower still to read
/// back. Its numbers are anything.
template <class T>
struct Lines {
    struct alignas(64) Line {
        T x[64 / sizeof(T)];
    };
    std::unique_ptr<Line[]> lines;
    std::size_t capacity = 0;

    T* reserve(Index numbers) {
        const std::size_t n = static_cast<std::size_t>(numbers) / (64 / sizeof(T)) + 1;
        if (!lines || n > capacity) {
            capacity = n + n / 2;
            lines = std::make_unique_for_overwrite<Line[]>(capacity);
        }
        return lines[0].x;
    }
    /// As reserve, but the first `kept` numbers stay.
    T* grow(Index numbers, Index kept) {
        if (lines && static_cast<std::size_t>(numbers) / (64 / sizeof(T)) < capacity)
            return lines[0].x;
        const std::unique_ptr<Line[]> old = std::move(lines);
        T* const to = reserve(numbers);
        if (kept > 0) std::copy_n(old[0].x, kept, to);
        return to;
    }
};

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
    /// Transmittance 1 where a pixel is drawn, 0 outside the image, strip by strip.
    void start(const StripMask& drawn, T* transmittance) const {
        for (int s = 0; s < count; ++s)
            for (int lane = 0; lane < lanes; ++lane)
                transmittance[s * lanes + lane] =
                    drawn.has(s) && s % tile_edge < height && s / tile_edge * lanes + lane < width
                        ? T(1)
                        : T(0);
    }
    /// Where pixel (x, y) of the tile lies in strip by strip arrays.
    static int at(int px, int py) {
        return (px / lanes * tile_edge + py) * lanes + px % lanes;
    }
};

/// Transposes 32 x 32 bits: bit i of word j becomes bit j of word i.
inline void transpose_bits(std::uint32_t* word) {
    std::uint32_t low = 0x0000FFFF;
    for (unsigned j = 16; j != 0; j >>= 1U, low ^= low << j)
        for (unsigned k = 0; k < 32; k = ((k | j) + 1) & ~j) {
            const std::uint32_t t = ((word[k] >> j) ^ word[k | j]) & low;
            word[k | j] ^= t;
            word[k] ^= t << j;
        }
}

/// A group of a tile's entries, made ready for the strips.
template <class V>
struct LaneGroup {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    static constexpr int lanes = Tile::lanes;
    static constexpr int most = 32;      ///< entries
    static constexpr int sides_a_word = 32 / tile_edge;
    static constexpr int words = (Tile::sides + sides_a_word - 1) / sides_a_word;

    struct alignas(64) Shared {
        T v[tile_edge];                  ///< v = this + down[row]
        T exponent[tile_edge];           ///< exponent = this - v^2
        T down[tile_edge];
    };
    Shared shared[most];
    alignas(64) T x[most], y[most], ux[most], vx[most], vy[most], peak[most];
    alignas(64) T cut[most], floor[most], depth[most];
    std::uint32_t strips[words][most];   ///< of each entry, a bit a strip that it reaches
    std::uint32_t entries[words][32];    ///< of each strip, a bit an entry that reaches it

    /// Takes entries [begin, end); strips that are not `open`, a bit each, get none.
    void fill(const Scene<T>& scene, const Tile& tile, int top, Index begin, Index end,
              const std::uint32_t* open) {
        std::uint32_t rows[most];
        const int n = static_cast<int>(end - begin);
        for (int k = 0; k < n; ++k) rows[k] = share(scene.splat(begin + k), tile, top, k);
        for (int k = 0; k < n; k += lanes) reach(tile, k);
        for (int w = 0; w < words; ++w) {
            std::uint32_t* const s = strips[w];
            for (int k = 0; k < n; ++k) s[k] &= rows[k] & open[w];
            std::fill(s + n, s + most, 0U);
            std::copy_n(s, most, entries[w]);
            transpose_bits(entries[w]);
        }
    }
    std::uint32_t entries_of(int strip) const { return entries[strip / 32][strip % 32]; }

  private:
    /// What all strips need of an entry; returns its rows, for each side of a word.
    std::uint32_t share(const Splat<T>& s, const Tile& tile, int top, int k) {
        x[k] = s.x, y[k] = s.y, ux[k] = s.ux, vx[k] = s.vx, vy[k] = s.vy;
        peak[k] = s.log2_opacity, cut[k] = s.cut, floor[k] = s.floor, depth[k] = s.depth;
        Shared& to = shared[k];
        unrolled<Tile::sides>([&](auto i) __attribute__((always_inline)) {
            const V dx = V::load_aligned(tile.x + i * lanes) - V(s.x);
            const V u = V(s.ux) * dx;
            (V(s.vx) * dx).store_aligned(to.v + i * lanes);
            (V(s.log2_opacity) - u * u).store_aligned(to.exponent + i * lanes);
            (V(s.vy) * (V::load_aligned(tile.y + i * lanes) - V(s.y)))
                .store_aligned(to.down + i * lanes);
        });
        const int b = std::max(0, s.row_begin - top), e = std::min(tile_edge, s.row_end - top);
        const std::uint32_t span =
            (1U << static_cast<unsigned>(e)) - (1U << static_cast<unsigned>(b));
        return span | span << static_cast<unsigned>(tile_edge);
    }

    /// Which strips entries k, k + 1, ... reach, an entry in each lane: those in which the highest
    /// exponent of a row is not below the cut; a bit more for the rounding.
    void reach(const Tile& tile, int k) {
        const auto of = [k](const T* a) { return V::load_aligned(a + k); };
        const V cx = of(x), cy = of(y), a = of(ux), b = of(vx), c = of(vy), zero(T(0));
        const V most_lost = of(peak) - of(cut) + V(T(0x1p-10));
        const V steepest = -b / (a * a + b * b);
        std::array<V, std::size_t(Tile::sides)> low, high, bits;
        unrolled<Tile::sides>([&](auto side) __attribute__((always_inline)) {
            low[side] = V(tile.x[side * lanes]) - cx;
            high[side] = V(tile.x[side * lanes + lanes - 1]) - cx;
            bits[side] = zero;
        });
        T power = 1;
        for (int row = 0; row < tile_edge; ++row, power *= 2) {
            const V down = c * (V(tile.y[row]) - cy), nearest = steepest * down;
            const V allowed = most_lost + V(T(0x1p-16)) * abs(down);
            unrolled<Tile::sides>([&](auto side) __attribute__((always_inline)) {
                const V dx = min(high[side], max(low[side], nearest));
                const V u = a * dx, v = b * dx + down;
                bits[side] = bits[side] + select(u * u + v * v <= allowed, V(power), zero);
            });
        }
        alignas(64) T number[Tile::sides][lanes];
        for (int side = 0; side < Tile::sides; ++side)
            bits[std::size_t(side)].store_aligned(number[side]);
        for (int w = 0; w < words; ++w)
            for (int lane = 0; lane < lanes; ++lane) {
                std::uint32_t word = 0;
                for (int i = 0; i < sides_a_word && w * sides_a_word + i < Tile::sides; ++i)
                    word |= static_cast<std::uint32_t>(
                                static_cast<std::int32_t>(number[w * sides_a_word + i][lane]))
                            << (i * tile_edge);
                strips[w][k + lane] = word;
            }
    }
};

/// What a Gaussian adds to a strip.
template <class V>
struct LaneShare {
    V alpha, before;         ///< and the transmittance in front of it
    V weight;                ///< alpha times before; 0 where nothing is added
};

/// One blend, strip by strip. The transmittance of a full pixel, and of one outside the image, is
/// 0; that with which it got full is kept aside.
template <class A, class V>
struct LaneBlend {
    using T = typename V::value_type;
    static constexpr bool library = A::exp2_degree == 0 || std::is_same_v<T, double>;
    using Exp2 = Exp2Poly<A::exp2_degree == 0 ? 6 : A::exp2_degree>;
    V alpha_max, stop;

    explicit LaneBlend(const A& a)
        : alpha_max(static_cast<T>(a.alpha_max)), stop(static_cast<T>(a.stop)) {}

    /// Updates the transmittance; that of pixels that get full goes to `left`.
    [[gnu::always_inline]] LaneShare<V> operator()(const V& exponent, const V& cut, const V& floor,
                                                   V& transmittance, T* left) const {
        const V zero(T(0));
        // Exponents below the cut, and so those that the polynomial does not know, are not used.
        V alpha;
        if constexpr (library)
            alpha = Exp2Library()(exponent);
        else
            alpha = Exp2::within(exponent);
        if constexpr (A::has_floor) alpha = alpha - floor;
        alpha = select(exponent >= cut, min(alpha_max, alpha), zero);
        const V before = transmittance;
        V weight = alpha * before;
        V behind = before - weight;
        if constexpr (A::stop_rule != Stop::never) {
            const auto full = behind < min(before, stop);
            if (any(full)) [[unlikely]] {
                constexpr bool in = A::stop_rule == Stop::inclusive;
                select(full, in ? behind : before, V::load_aligned(left)).store_aligned(left);
                if constexpr (!in) {
                    alpha = select(full, zero, alpha);
                    weight = select(full, zero, weight);
                }
                behind = select(full, zero, behind);
            }
        }
        transmittance = behind;
        return {alpha, before, weight};
    }
};

/// Which strips can still take a contribution, a bit each; false if none.
template <class V>
bool open_strips(const typename V::value_type* transmittance, std::uint32_t* open) {
    using T = typename V::value_type;
    std::fill_n(open, LaneGroup<V>::words, 0U);
    bool some = false;
    for (int s = 0; s < Strips<V>::count; ++s)
        if (any(V::load_aligned(transmittance + s * Strips<V>::lanes) > V(T(0)))) {
            open[s / 32] |= std::uint32_t(1) << (s % 32);
            some = true;
        }
    return some;
}

/// Asks for the records of the entries of a tile that come after `entry`. Always inlined: g++ takes
/// a function that only prefetches for one without effect, and drops the call.
template <class T>
[[gnu::always_inline]] inline void fetch_ahead(const Scene<T>& scene, Index entry, Index end) {
    for (Index k = entry; k < end; ++k) {
        const std::size_t r = scene.member(k);
        __builtin_prefetch(&scene.trace.splats[r]);
        __builtin_prefetch(&scene.trace.splats[r].row_end);
        __builtin_prefetch(&scene.trace.source[r]);
    }
}

/// Asks for the features of entries [begin, end), whose records were asked for before. Always
/// inlined, as fetch_ahead.
template <class T>
[[gnu::always_inline]] inline void fetch_features(const Scene<T>& scene, Index begin, Index end) {
    constexpr Index line = 64 / static_cast<Index>(sizeof(T));
    for (Index k = begin; k < end; ++k) {
        const T* const f = scene.feature_of(k);
        for (Index c = 0; c < scene.feature.rows(); c += line) __builtin_prefetch(f + c);
        __builtin_prefetch(f + scene.feature.rows() - 1);
    }
}

/// Channels in whole vectors, and at least in eights.
template <class V>
constexpr Index padded_channels(Index channels) {
    constexpr Index unit = std::max<Index>(8, static_cast<Index>(V::size));
    return (channels + unit - 1) / unit * unit;
}

/// The features of entries [begin, end), a row of `stride` each, with zeros behind the channels.
/// C channels, or any number for C = 0.
template <class V, int C>
void copy_features(const Scene<typename V::value_type>& scene, Index begin, Index end,
                   Index stride, typename V::value_type* to) {
    using T = typename V::value_type;
    constexpr Index lanes = static_cast<Index>(V::size);
    const Index channels = C > 0 ? C : scene.feature.rows();
    for (Index k = begin; k < end; ++k, to += stride) {
        const T* from = scene.feature_of(k);
        if constexpr (C > 0) {
            unrolled<C>([&](auto c) { to[c] = from[c]; });
        } else {
            Index c = 0;
            for (; c + lanes <= channels; c += lanes)
                V::load_unaligned(from + c).store_aligned(to + c);
            for (; c < channels; ++c) to[c] = from[c];
            for (; c < stride; ++c) to[c] = T(0);
        }
    }
}

/// Whether walks keep all channels in registers: else they are blended in blocks.
template <int C>
inline constexpr bool few_channels = C > 0 && C <= 4;

} // namespace rye
