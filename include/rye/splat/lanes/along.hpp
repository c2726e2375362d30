// SPDX-License-Identifier: Apache-2.0
/// rye/splat/lanes/along.hpp: the cotangent of a strip's pixels along a colour, and the sums of
/// weight times cotangent, for the reverse walk.
#pragma once

#include <array>
#include <cstdint>

#include <rye/splat/lanes/registers.hpp>

namespace rye {

/// Returns <cotangent, colour> of a strip's pixels, for a few channels. One expression for entries
/// and background, so that equal colours give equal sums.
template <class V, int C>
[[gnu::always_inline]] inline V along(const typename V::value_type* cotangent,
                                      const std::array<V, std::size_t(C)>& colour) {
    constexpr int lanes = static_cast<int>(V::size);
    V sum = V::load_aligned(cotangent) * colour[0];
    unrolled<C - 1>([&](auto c) __attribute__((always_inline)) {
        sum = sum + V::load_aligned(cotangent + (c + 1) * lanes) * colour[c + 1];
    });
    return sum;
}

namespace detail {

/// The strips of an entry's visits.
struct VisitedStrips {
    const std::uint8_t* strip;
    Index count;
};

/// No sums, for the background.
struct NoSums {
    void start() {}
    template <class V>
    void add(Index, Index, const V&) {}
    void write(Index) {}
};

/// Sums over visits of weight times cotangent, eight channels at a time.
template <class V>
struct WeightedSums {
    using T = typename V::value_type;
    const T (*weight)[V::size];            ///< [visits]
    T* to;                                 ///< [channels]
    std::array<V, 8> sum;

    void start() { sum.fill(V(T(0))); }
    [[gnu::always_inline]] void add(Index visit, Index channel, const V& cotangent) {
        V& s = sum[static_cast<std::size_t>(channel)];
        s = s + cotangent * V::load_aligned(weight[visit]);
    }
    void write(Index channel) { lane_sums(sum, to + channel); }
};

/// Writes <cotangent, colour> of many channels, of strip[i] to to[i], and passes the same
/// cotangents to `sums`. Eight channels at a time, whose colours stay in registers. The cotangents
/// of a tile fill the nearest cache, so they are read once for both.
template <class V, class Sums>
void along_strips(const typename V::value_type* cotangent, VisitedStrips visited,
                  const typename V::value_type* colour, Index stride,
                  typename V::value_type (*to)[V::size], Sums sums) {
    constexpr int lanes = static_cast<int>(V::size);
    const auto [strip, visits] = visited;
    for (Index c = 0; c < stride; c += 8) {
        std::array<V, 8> f;
        unrolled<8>([&](auto i) { f[i] = V(colour[c + i]); });
        sums.start();
        for (Index v = 0; v < visits; ++v) {
            const auto* const g = cotangent + (strip[v] * stride + c) * lanes;
            const auto next = [&](int i) __attribute__((always_inline)) {
                const V x = load_once<V>(g + i * lanes);
                sums.add(v, i, x);
                return x;
            };
            const V first = next(0);
            V even = c == 0 ? first * f[0] : V::load_aligned(to[v]) + first * f[0];
            V odd = next(1) * f[1];
            unrolled<3>([&](auto i) __attribute__((always_inline)) {
                even = even + next(2 + 2 * i) * f[2 + 2 * i];
                odd = odd + next(3 + 2 * i) * f[3 + 2 * i];
            });
            (even + odd).store_aligned(to[v]);
        }
        sums.write(c);
    }
}

/// Writes the sums of WeightedSums, and nothing else.
template <class V>
void weigh_strips(const typename V::value_type* cotangent, VisitedStrips visited, Index stride,
                  const typename V::value_type (*weight)[V::size], typename V::value_type* to) {
    using T = typename V::value_type;
    constexpr int lanes = static_cast<int>(V::size);
    const auto [strip, visits] = visited;
    for (Index c = 0; c < stride; c += 8) {
        std::array<V, 8> sum;
        sum.fill(V(T(0)));
        for (Index v = 0; v < visits; ++v) {
            const V w = V::load_aligned(weight[v]);
            const T* const g = cotangent + (strip[v] * stride + c) * lanes;
            unrolled<8>([&](auto i) __attribute__((always_inline)) {
                sum[i] = sum[i] + V::load_aligned(g + i * lanes) * w;
            });
        }
        lane_sums(sum, to + c);
    }
}

} // namespace detail

} // namespace rye
