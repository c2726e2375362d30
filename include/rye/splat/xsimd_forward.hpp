// SPDX-License-Identifier: Apache-2.0
/// rye/splat/xsimd_forward.hpp: blending a tile, strip by strip. A few channels are summed in
/// registers with a pixel in each lane. Many are a product of matrices for each strip, the weights
/// of its entries times their features, with channels in the lanes.
#pragma once

#include <rye/splat/forward.hpp>
#include <rye/splat/xsimd_lanes.hpp>

namespace rye {

/// Memory of one thread's tiles.
template <class V>
struct LaneCanvas : Workspaces::Space {
    using T = typename V::value_type;
    LaneGroup<V> group;
    alignas(64) T transmittance[tile_pixels], left[tile_pixels], depth[tile_pixels];
    alignas(64) T weight[LaneGroup<V>::most][Strips<V>::lanes];
    Lines<T> sums;           ///< few channels: strip by strip, each channel's; else a row a pixel
    Lines<T> feature;        ///< of the group
    Lines<T> background;     ///< a row of it
};

/// sums(pixel, channels) += sum_j weight[j][pixel] feature(entry j of the strip, channels) for
/// the pixels of a strip and P vectors of channels; two pixels at a time keep their sums in
/// registers.
template <int P, class V>
void blend_channels(const typename V::value_type (*weight)[V::size], std::uint32_t entries,
                    const typename V::value_type* feature, Index stride,
                    typename V::value_type* sums) {
    constexpr int lanes = static_cast<int>(V::size);
    for (int p = 0; p < lanes; p += 2) {
        std::array<V, std::size_t(P)> a, b;
        typename V::value_type* const to = sums + p * stride;
        unrolled<P>([&](auto i) {
            a[i] = V::load_aligned(to + i * lanes);
            b[i] = V::load_aligned(to + stride + i * lanes);
        });
        int j = 0;
        for (std::uint32_t left = entries; left != 0; left &= left - 1, ++j) {
            const V wa(weight[j][p]), wb(weight[j][p + 1]);
            const auto* f = feature + std::countr_zero(left) * stride;
            unrolled<P>([&](auto i) {
                const V x = V::load_aligned(f + i * lanes);
                a[i] = a[i] + wa * x;
                b[i] = b[i] + wb * x;
            });
        }
        unrolled<P>([&](auto i) {
            a[i].store_aligned(to + i * lanes);
            b[i].store_aligned(to + stride + i * lanes);
        });
    }
}

/// One strip's walk over its list. C few channels, or any number for C = 0.
template <class V, int C, class A>
void blend_strip(const LaneBlend<A, V>& blend, int strip, Index stride, LaneCanvas<V>& canvas) {
    using T = typename V::value_type;
    constexpr int lanes = static_cast<int>(V::size);
    const LaneGroup<V>& group = canvas.group;
    const std::uint32_t entries = group.entries_of(strip);
    if (entries == 0) return;
    const int row = strip % tile_edge, column = strip / tile_edge * lanes, at = strip * lanes;
    T* const sums = canvas.sums.lines[0].x + at * stride;
    const T* const feature = canvas.feature.lines[0].x;
    V t = V::load_aligned(canvas.transmittance + at), depth = V::load_aligned(canvas.depth + at);
    std::array<V, std::size_t(std::max(C, 1))> sum;
    unrolled<C>([&](auto c) { sum[c] = V::load_aligned(sums + c * lanes); });
    int j = 0;
    for (std::uint32_t todo = entries; todo != 0; todo &= todo - 1) {
        const int k = std::countr_zero(todo);
        const auto& shared = group.shared[k];
        const V v = V::load_aligned(shared.v + column) + V(shared.down[row]);
        const V exponent = V::load_aligned(shared.exponent + column) - v * v;
        const V w =
            blend(exponent, V(group.cut[k]), V(group.floor[k]), t, canvas.left + at).weight;
        depth = depth + w * V(group.depth[k]);
        if constexpr (C > 0)
            unrolled<C>([&](auto c) { sum[c] = sum[c] + w * V(feature[k * stride + c]); });
        else
            w.store_aligned(canvas.weight[j++]);
    }
    t.store_aligned(canvas.transmittance + at);
    depth.store_aligned(canvas.depth + at);
    unrolled<C>([&](auto c) { sum[c].store_aligned(sums + c * lanes); });
    if constexpr (C == 0) {
        Index c = 0;
        const auto blocks = [&]<int P>(std::integral_constant<int, P>) {
            for (; c + P * lanes <= stride; c += P * lanes)
                blend_channels<P, V>(canvas.weight, entries, feature + c, stride, sums + c);
        };
        blocks(std::integral_constant<int, 4>());
        blocks(std::integral_constant<int, 2>());
        blocks(std::integral_constant<int, 1>());
    }
}

/// Draws one tile of the three images. C few channels, or any number for C = 0.
template <class V, int C, class A>
void blend_tile_lanes(const Scene<typename V::value_type>& scene, const A& accuracy, Index tile,
                      Raster<typename V::value_type>& out, LaneCanvas<V>& canvas) {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    if constexpr (A::order == BlendOrder::by_peak) return blend_tile(scene, accuracy, tile, out);
    constexpr int lanes = Tile::lanes;
    const Index channels = C > 0 ? C : scene.feature.rows();
    const Index stride = C > 0 ? C : padded_channels<V>(channels);
    const int left = scene.left(tile), top = scene.top(tile);
    const Index begin = scene.begin(tile), end = scene.end(tile);
    if (begin == end) {
        out.trace.used[static_cast<std::size_t>(tile)] = 0;
        const Index n = scene.right(tile) - left;
        T* const row = canvas.background.reserve(tile_edge * channels);
        for (Index i = 0; i < n * channels; ++i) row[i] = scene.background[i % channels];
        for (int y = top; y < scene.bottom(tile); ++y) {
            const Index p = scene.pixel(left, y);
            std::copy_n(row, n * channels, out.feature.pixels.data() + p * channels);
            std::fill_n(out.alpha.pixels.data() + p, n, T(0));
            std::fill_n(out.depth.pixels.data() + p, n, T(0));
        }
        return;
    }
    const Tile strips(scene, tile);
    const LaneBlend<A, V> blend(accuracy);
    strips.start(canvas.transmittance);
    std::fill_n(canvas.left, tile_pixels, T(0));
    std::fill_n(canvas.depth, tile_pixels, T(0));
    T* const sums = canvas.sums.reserve(tile_pixels * stride);
    std::fill_n(sums, tile_pixels * stride, T(0));
    T* const feature = canvas.feature.reserve(LaneGroup<V>::most * stride);

    std::uint32_t open[LaneGroup<V>::words];
    Index k = begin;
    while (k < end && open_strips<V>(canvas.transmittance, open)) {
        const Index next = std::min<Index>(end, k + LaneGroup<V>::most);
        const Index after = std::min<Index>(end, next + LaneGroup<V>::most);
        fetch_ahead(scene, after, std::min<Index>(end, after + LaneGroup<V>::most));
        fetch_features(scene, next, after);
        copy_features<V, C>(scene, k, next, stride, feature);
        canvas.group.fill(scene, strips, top, k, next, open);
        for (int s = 0; s < Tile::count; ++s) blend_strip<V, C>(blend, s, stride, canvas);
        k = next;
    }
    out.trace.used[static_cast<std::size_t>(tile)] = k - begin;

    for (int y = 0; y < strips.height; ++y) {
        const Index p = scene.pixel(left, top + y);
        T* to = out.feature.pixels.data() + p * channels;
        for (int x = 0; x < strips.width; ++x) {
            const int at = Tile::at(x, y);
            const T behind = canvas.transmittance[at] + canvas.left[at];
            out.alpha.pixels.data()[p + x] = T(1) - behind;
            out.depth.pixels.data()[p + x] = canvas.depth[at];
            if constexpr (C > 0) {
                const T* from = sums + at / lanes * lanes * stride + at % lanes;
                for (int c = 0; c < C; ++c)
                    *to++ = from[c * lanes] + behind * scene.background[c];
            } else {
                const T* const from = sums + at * stride;
                const T* const back = scene.background.data();
                Index c = 0;
                for (; c + lanes <= channels; c += lanes)
                    (V::load_aligned(from + c) + V(behind) * V::load_unaligned(back + c))
                        .store_unaligned(to + c);
                for (; c < channels; ++c) to[c] = from[c] + behind * back[c];
                to += channels;
            }
        }
    }
}

} // namespace rye
