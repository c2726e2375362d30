// SPDX-License-Identifier: Apache-2.0
/// rye/splat/xsimd_lanes.hpp: what the tuned walks share: a tile as vectors of pixels, the alpha of
/// a Gaussian at one of them, and sums over lanes.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <limits>
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
void unrolled(F&& f) {
    [&]<int... I>(std::integer_sequence<int, I...>) {
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

/// Tile pixels in vectors, row by row: pixel p of the tile is lane p % lanes of vector p / lanes.
template <class V>
struct TileVectors {
    using T = typename V::value_type;
    static constexpr int lanes = static_cast<int>(V::size);
    static constexpr int count = tile_pixels / lanes;
    static_assert(tile_pixels % lanes == 0);
    static constexpr bool by_rows = lanes == tile_edge;      ///< a vector is a row

    alignas(64) T px[tile_pixels];       ///< pixel centres from the principal point [px]
    alignas(64) T py[tile_pixels];
    alignas(64) T inside[tile_pixels];   ///< 1 for pixels of the image, else 0

    TileVectors(const Scene<T>& scene, Index tile) {
        for (int p = 0; p < tile_pixels; ++p) {
            const int x = scene.left(tile) + p % tile_edge, y = scene.top(tile) + p / tile_edge;
            px[p] = static_cast<T>(x) + T(0.5) - scene.cx;
            py[p] = static_cast<T>(y) + T(0.5) - scene.cy;
            inside[p] = x < scene.width && y < scene.height ? T(1) : T(0);
        }
    }

    /// The vectors that hold a Gaussian's rows, given the first row of the tile.
    static Span range(const Splat<T>& s, int top) {
        const int b = std::max(0, s.row_begin - top), e = std::min(tile_edge, s.row_end - top);
        return {b * tile_edge / lanes, (e * tile_edge + lanes - 1) / lanes};
    }
};

/// Folded offsets and exponent of one Gaussian, vector by vector.
template <class V>
struct LaneResponse {
    using T = typename V::value_type;
    const TileVectors<V>& tile;
    T x, y;
    V ux, vx, vy, log2_opacity;
    V u_row, v_row, exponent_row;        ///< what does not change from row to row

    LaneResponse(const TileVectors<V>& t, const Splat<T>& s)
        : tile(t), x(s.x), y(s.y), ux(s.ux), vx(s.vx), vy(s.vy), log2_opacity(s.log2_opacity),
          u_row(ux * (V::load_aligned(t.px) - V(s.x))),
          v_row(vx * (V::load_aligned(t.px) - V(s.x))),
          exponent_row(log2_opacity - u_row * u_row) {}

    Response<V> operator()(int vector) const {
        if constexpr (TileVectors<V>::by_rows) {
            const V v = v_row + vy * V(tile.py[vector * tile_edge] - y);
            return {u_row, v, exponent_row - v * v};
        } else {
            const V dx = V::load_aligned(tile.px + vector * TileVectors<V>::lanes) - V(x);
            const V dy = V::load_aligned(tile.py + vector * TileVectors<V>::lanes) - V(y);
            const V u = ux * dx, v = vx * dx + vy * dy;
            return {u, v, log2_opacity - u * u - v * v};
        }
    }
};

/// One blend, vector by vector. A full pixel is one whose transmittance is below `stop`, or, with
/// the exclusive rule, negative; pixels outside the image start full.
template <class A, class V>
struct LaneBlend {
    using T = typename V::value_type;
    using Exp2 = std::conditional_t<A::exp2_degree == 0 || std::is_same_v<T, double>, Exp2Library,
                                    Exp2Poly<A::exp2_degree == 0 ? 6 : A::exp2_degree>>;
    V alpha_max, stop;

    explicit LaneBlend(const A& a)
        : alpha_max(static_cast<T>(a.alpha_max)),
          stop(A::stop_rule == Stop::never ? T(0) : static_cast<T>(a.stop)) {}

    static V start(const V& inside) { return select(inside > V(T(0)), V(T(1)), V(T(-1))); }
    static V finish(const V& transmittance) { return abs(transmittance); }

    /// alpha, 0 where nothing is added; updates the transmittance.
    V operator()(const V& exponent, const V& cut, const V& floor, V& transmittance) const {
        V alpha = Exp2()(exponent);
        if constexpr (A::has_floor) alpha = alpha - floor;
        alpha = min(alpha_max, alpha);
        const auto on = (exponent >= cut) && (transmittance >= stop);
        alpha = select(on, alpha, V(T(0)));
        const V behind = transmittance - transmittance * alpha;
        if constexpr (A::stop_rule == Stop::exclusive) {
            const auto full = on && (behind < stop);
            alpha = select(full, V(T(0)), alpha);
            transmittance = select(full, -transmittance, behind);
        } else {
            transmittance = behind;
        }
        return alpha;
    }
};

/// Which of a tile's 64 pixels a Gaussian adds to, as bits. Vectors are added in order.
template <class V>
struct PixelBits {
    using T = typename V::value_type;
    static constexpr int lanes = static_cast<int>(V::size);
    /// Powers of two sum without rounding as far as the mantissa reaches: so many vectors at once.
    static constexpr int at_once = std::max(1, std::numeric_limits<T>::digits / lanes);
    static constexpr int wide = std::min(at_once, 32 / lanes);

    std::uint64_t bits = 0;
    V pending = V(T(0));
    int first = -1;                      ///< vector of the lowest pending bits

    void add(const V& alpha, int vector) {
        if (first < 0) first = vector;
        const T* p = powers.data() + (vector - first) * lanes;
        pending = pending + select(alpha > V(T(0)), V::load_aligned(p), V(T(0)));
        if (vector - first == wide - 1) flush();
    }
    void flush() {
        if (first < 0) return;
        const auto sum = static_cast<std::uint64_t>(static_cast<std::int64_t>(lane_sum(pending)));
        bits |= sum << (first * lanes);
        pending = V(T(0));
        first = -1;
    }

  private:
    alignas(64) static constexpr std::array<T, static_cast<std::size_t>(wide * lanes)> powers = [] {
        std::array<T, static_cast<std::size_t>(wide * lanes)> p{};
        T x = 1;
        for (T& q : p) {
            q = x;
            x *= 2;
        }
        return p;
    }();
};

/// f(pixel) for each bit, in order.
template <class F>
void each_pixel(std::uint64_t bits, F&& f) {
    for (; bits != 0; bits &= bits - 1) f(std::countr_zero(bits));
}

/// Asks for an entry's feature. Always inlined, as fetch_ahead.
template <class T>
[[gnu::always_inline]] inline void fetch_feature(const Scene<T>& scene, Index entry) {
    constexpr Index line = 64;
    const char* f = static_cast<const char*>(static_cast<const void*>(scene.feature_of(entry)));
    const Index size = scene.feature.rows() * static_cast<Index>(sizeof(T));
    for (Index b = 0; b < size; b += line) __builtin_prefetch(f + b);
    __builtin_prefetch(f + size - 1);
}

/// Asks for the record and the feature of an entry that is a few steps away. Always inlined: g++
/// takes a function that only prefetches for one without effect, and drops the call.
template <class T>
[[gnu::always_inline]] inline void fetch_ahead(const Scene<T>& scene, Index entry, Index end) {
    if (entry + 16 < end) {
        const std::size_t r = scene.member(entry + 16);
        __builtin_prefetch(&scene.trace.source[r]);
        __builtin_prefetch(&scene.trace.splats[r]);
        __builtin_prefetch(&scene.trace.splats[r].row_end);
    }
    if (entry + 8 < end) fetch_feature(scene, entry + 8);
}

/// Whether any pixel can still take a contribution.
template <class V>
bool any_open(const typename V::value_type* transmittance, const V& stop) {
    V most = V::load_aligned(transmittance);
    for (int v = 1; v < TileVectors<V>::count; ++v)
        most = max(most, V::load_aligned(transmittance + v * TileVectors<V>::lanes));
    return any(most >= stop);
}

/// Channels are blended in vectors of channels when they fill some; else pixels fill the vectors.
template <class V, int C>
inline constexpr bool by_channels = C >= 8 && C % static_cast<int>(V::size) == 0;

} // namespace rye
