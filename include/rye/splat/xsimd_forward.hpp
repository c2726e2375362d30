// SPDX-License-Identifier: Apache-2.0
/// rye/splat/xsimd_forward.hpp: blending a tile in vectors. Alpha and transmittance have a pixel in
/// each lane; so have the colours when they are few. With many channels, weights are laid down and
/// each contributing pixel adds whole vectors of channels, so that no lane idles.
#pragma once

#include <rye/splat/xsimd_lanes.hpp>

namespace rye {

/// C channels, or any number for C = 0.
template <class V, int C, class A>
void blend_tile_lanes(const Scene<typename V::value_type>& scene, const A& accuracy, Index tile,
                      Raster<typename V::value_type>& out,
                      std::vector<typename V::value_type>& sums) {
    using T = typename V::value_type;
    using Tile = TileVectors<V>;
    constexpr int lanes = Tile::lanes;
    const int channels = C > 0 ? C : static_cast<int>(scene.feature.rows());
    const Tile vectors(scene, tile);
    const LaneBlend<A, V> blend(accuracy);
    alignas(64) T transmittance[tile_pixels], depth[tile_pixels], weight[tile_pixels];
    for (int v = 0; v < Tile::count; ++v) {
        const V inside = V::load_aligned(vectors.inside + v * lanes);
        LaneBlend<A, V>::start(inside).store_aligned(transmittance + v * lanes);
        V(T(0)).store_aligned(depth + v * lanes);
    }
    // By channels: a column of C a pixel. By pixels: a row of tile_pixels a channel.
    sums.assign(static_cast<std::size_t>(channels * tile_pixels), T(0));

    const int top = scene.top(tile);
    const Index begin = scene.begin(tile), end = scene.end(tile);
    Index k = begin;
    while (k < end) {
        fetch_ahead(scene, k, end);
        const Splat<T>& s = scene.splat(k);
        const T* feature = scene.feature_of(k);
        const LaneResponse<V> response(vectors, s);
        const V cut(s.cut), floor(s.floor), z(s.depth);
        const Span range = Tile::range(s, top);
        PixelBits<V> pixels;
        for (int v = range.begin; v < range.end; ++v) {
            V t = V::load_aligned(transmittance + v * lanes);
            const V before = t;
            const V alpha = blend(response(v).exponent, cut, floor, t);
            const V w = alpha * before;
            t.store_aligned(transmittance + v * lanes);
            (V::load_aligned(depth + v * lanes) + w * z).store_aligned(depth + v * lanes);
            if constexpr (by_channels<V, C>) {
                w.store_aligned(weight + v * lanes);
                pixels.add(alpha, v);
            } else {
                for (int c = 0; c < channels; ++c) {
                    T* sum = sums.data() + c * tile_pixels + v * lanes;
                    (V::load_unaligned(sum) + w * V(feature[c])).store_unaligned(sum);
                }
            }
        }
        if constexpr (by_channels<V, C>) {
            constexpr int parts = C / lanes;
            std::array<V, static_cast<std::size_t>(parts)> colour;
            unrolled<parts>([&](auto i) { colour[i] = V::load_unaligned(feature + i * lanes); });
            pixels.flush();
            each_pixel(pixels.bits, [&](int p) {
                const V w(weight[p]);
                T* sum = sums.data() + p * C;
                unrolled<parts>([&](auto i) {
                    (V::load_unaligned(sum + i * lanes) + w * colour[i])
                        .store_unaligned(sum + i * lanes);
                });
            });
        }
        ++k;
        if ((k - begin) % 8 == 0 && !any_open(transmittance, blend.stop)) break;
    }
    out.trace.used[static_cast<std::size_t>(tile)] = k - begin;

    for (int y = top; y < scene.bottom(tile); ++y)
        for (int x = scene.left(tile); x < scene.right(tile); ++x) {
            const int p = (y - top) * tile_edge + (x - scene.left(tile));
            const Index to = scene.pixel(x, y);
            const T behind = std::abs(transmittance[p]);
            T* pixel = out.feature.pixels.data() + to * channels;
            if constexpr (by_channels<V, C>) {
                unrolled<C / lanes>([&](auto i) {
                    (V::load_unaligned(sums.data() + p * C + i * lanes) +
                     V(behind) * V::load_unaligned(scene.background.data() + i * lanes))
                        .store_unaligned(pixel + i * lanes);
                });
            } else {
                for (int c = 0; c < channels; ++c)
                    pixel[c] = sums[static_cast<std::size_t>(c * tile_pixels + p)] +
                               behind * scene.background[c];
            }
            out.alpha.pixels(0, to) = T(1) - behind;
            out.depth.pixels(0, to) = depth[p];
        }
}

} // namespace rye
