// SPDX-License-Identifier: Apache-2.0
/// rye/splat/xsimd_vjp.hpp: the reverse walk of a tile in vectors. The forward walk is repeated
/// without colours, laying down alpha and transmittance; then, far to near, as in splat/vjp.hpp.
#pragma once

#include <memory>

#include <rye/splat/xsimd_lanes.hpp>

namespace rye {

/// A Gaussian that adds to some pixel of the tile, and where its vectors lie.
struct LaneHit {
    Index entry = 0;
    Index at = 0;            ///< of its first vector
    Span range;              ///< of vectors
    std::uint64_t pixels = 0;
};

/// Memory of one thread's tiles.
template <class T>
struct LaneTape {
    std::vector<LaneHit> hits;
    std::unique_ptr<T[]> alpha, transmittance;
    Index capacity = 0;      ///< [numbers]
    std::vector<T> cotangent;  ///< by pixels: channels x tile_pixels
    std::vector<T> sums;       ///< any number of channels: a vector for each

    void reserve(Index numbers) {
        if (numbers <= capacity) return;
        capacity = numbers + numbers / 2;
        const auto n = static_cast<std::size_t>(capacity);
        alpha = std::make_unique_for_overwrite<T[]>(n);
        transmittance = std::make_unique_for_overwrite<T[]>(n);
    }
};

/// Repeats the forward walk of a tile onto the tape.
template <class V, class A>
void record_tile(const Scene<typename V::value_type>& scene, const A& accuracy, Index tile,
                 const TileVectors<V>& vectors, LaneTape<typename V::value_type>& tape) {
    using T = typename V::value_type;
    constexpr int lanes = TileVectors<V>::lanes;
    const LaneBlend<A, V> blend(accuracy);
    alignas(64) T transmittance[tile_pixels];
    for (int v = 0; v < TileVectors<V>::count; ++v)
        LaneBlend<A, V>::start(V::load_aligned(vectors.inside + v * lanes))
            .store_aligned(transmittance + v * lanes);
    const int top = scene.top(tile);
    const Index begin = scene.begin(tile), end = begin + scene.used(tile);
    tape.hits.clear();
    tape.reserve((end - begin) * tile_pixels);
    Index at = 0;
    for (Index k = begin; k < end; ++k) {
        fetch_ahead(scene, k, end);
        const Splat<T>& s = scene.splat(k);
        const LaneResponse<V> response(vectors, s);
        const V cut(s.cut), floor(s.floor);
        const Span range = TileVectors<V>::range(s, top);
        PixelBits<V> pixels;
        Index to = at;
        for (int v = range.begin; v < range.end; ++v, to += lanes) {
            V t = V::load_aligned(transmittance + v * lanes);
            t.store_unaligned(tape.transmittance.get() + to);
            const V alpha = blend(response(v).exponent, cut, floor, t);
            alpha.store_unaligned(tape.alpha.get() + to);
            t.store_aligned(transmittance + v * lanes);
            pixels.add(alpha, v);
        }
        pixels.flush();
        if (pixels.bits == 0) continue;
        tape.hits.push_back({k, at, range, pixels.bits});
        at = to;
    }
}

/// Gradients of one tile's pixels, into the slots of its entries. C channels, or any for C = 0.
template <class V, int C, class A>
void blend_tile_vjp_lanes(const Scene<typename V::value_type>& scene, const A& accuracy,
                          const RasterCotangent<typename V::value_type>& g, Index tile,
                          RasterScratch<typename V::value_type>& scratch,
                          LaneTape<typename V::value_type>& tape) {
    using T = typename V::value_type;
    using Tile = TileVectors<V>;
    constexpr int lanes = Tile::lanes;
    const int channels = C > 0 ? C : static_cast<int>(scene.feature.rows());
    const Tile vectors(scene, tile);
    record_tile<V>(scene, accuracy, tile, vectors, tape);
    if (tape.hits.empty()) return;

    const int left = scene.left(tile), top = scene.top(tile);
    const T* g_tile = g.feature.data() + scene.pixel(left, top) * channels;
    const auto g_of = [&](int p) {
        return g_tile + (Index(p / tile_edge) * scene.width + p % tile_edge) * channels;
    };
    alignas(64) T g_alpha[tile_pixels] = {}, g_depth[tile_pixels] = {};
    alignas(64) T behind[tile_pixels] = {}, mine[tile_pixels] = {};
    if constexpr (!by_channels<V, C>)
        tape.cotangent.assign(static_cast<std::size_t>(channels * tile_pixels), T(0));
    for (int p = 0; p < tile_pixels; ++p) {
        if (!(vectors.inside[p] > T(0))) continue;
        const Index from = scene.pixel(left + p % tile_edge, top + p / tile_edge);
        if (g.alpha != nullptr) g_alpha[p] = (*g.alpha)(0, from);
        if (g.depth != nullptr) g_depth[p] = (*g.depth)(0, from);
        for (int c = 0; c < channels; ++c) {
            const T gc = g_of(p)[c];
            behind[p] += gc * scene.background[c];
            if constexpr (!by_channels<V, C>)
                tape.cotangent[static_cast<std::size_t>(c * tile_pixels + p)] = gc;
        }
    }

    const V zero(T(0)), alpha_max(static_cast<T>(accuracy.alpha_max));
    for (auto h = tape.hits.rbegin(); h != tape.hits.rend(); ++h) {
        const Splat<T>& s = scene.splat(h->entry);
        if (tape.hits.rend() - h > 4) fetch_feature(scene, (h + 4)->entry);
        const T* feature = scene.feature_of(h->entry);
        T* g_feature = scratch.feature_slots.data() + h->entry * channels;
        const T* alphas = tape.alpha.get() + h->at;
        const T* transmittances = tape.transmittance.get() + h->at;

        if constexpr (by_channels<V, C>) {
            constexpr int parts = C / lanes;
            alignas(64) T weight[tile_pixels];
            for (int v = h->range.begin; v < h->range.end; ++v) {
                const Index at = Index(v - h->range.begin) * lanes;
                (V::load_unaligned(alphas + at) * V::load_unaligned(transmittances + at))
                    .store_aligned(weight + v * lanes);
            }
            std::array<V, static_cast<std::size_t>(parts)> colour, sum;
            unrolled<parts>([&](auto i) {
                colour[i] = V::load_unaligned(feature + i * lanes);
                sum[i] = zero;
            });
            each_pixel(h->pixels, [&](int p) {
                const T* gp = g_of(p);
                const V w(weight[p]);
                V along = zero;
                unrolled<parts>([&](auto i) {
                    const V gv = V::load_unaligned(gp + i * lanes);
                    along = along + gv * colour[i];
                    sum[i] = sum[i] + gv * w;
                });
                mine[p] = lane_sum(along);
            });
            unrolled<parts>([&](auto i) { sum[i].store_unaligned(g_feature + i * lanes); });
        } else if constexpr (C > 0) {
            std::array<V, static_cast<std::size_t>(C)> sum;
            unrolled<C>([&](auto c) { sum[c] = zero; });
            for (int v = h->range.begin; v < h->range.end; ++v) {
                const Index at = Index(v - h->range.begin) * lanes;
                const V w =
                    V::load_unaligned(alphas + at) * V::load_unaligned(transmittances + at);
                V along = zero;
                unrolled<C>([&](auto c) {
                    const V gv = V::load_unaligned(tape.cotangent.data() + c * tile_pixels +
                                                   v * lanes);
                    along = along + gv * V(feature[c]);
                    sum[c] = sum[c] + gv * w;
                });
                along.store_aligned(mine + v * lanes);
            }
            unrolled<C>([&](auto c) { g_feature[c] = lane_sum(sum[c]); });
        } else {
            for (int v = h->range.begin; v < h->range.end; ++v)
                zero.store_aligned(mine + v * lanes);
            for (int c = 0; c < channels; ++c) {
                V sum = zero;
                for (int v = h->range.begin; v < h->range.end; ++v) {
                    const Index at = Index(v - h->range.begin) * lanes;
                    const V gv = V::load_unaligned(tape.cotangent.data() + c * tile_pixels +
                                                   v * lanes);
                    const V along = V::load_aligned(mine + v * lanes) + gv * V(feature[c]);
                    along.store_aligned(mine + v * lanes);
                    sum = sum + gv * (V::load_unaligned(alphas + at) *
                                      V::load_unaligned(transmittances + at));
                }
                g_feature[c] = lane_sum(sum);
            }
        }

        const LaneResponse<V> response(vectors, s);
        const V z(s.depth), floor(s.floor);
        V u = zero, v1 = zero, uu = zero, uv = zero, vv = zero, opacity = zero, depth = zero;
        for (int v = h->range.begin; v < h->range.end; ++v) {
            const Index at = Index(v - h->range.begin) * lanes;
            const V alpha = V::load_unaligned(alphas + at);
            const V before = V::load_unaligned(transmittances + at);
            const V gz = V::load_aligned(g_depth + v * lanes);
            const V b = V::load_aligned(behind + v * lanes);
            const V extra = V::load_aligned(g_alpha + v * lanes) + gz * z;
            const auto on = alpha > zero;
            const V more =
                select(on, (V::load_aligned(mine + v * lanes) - b) + extra, zero);
            (b + alpha * more).store_aligned(behind + v * lanes);
            const V g_raw = select(alpha < alpha_max, before * more, zero);
            const Response<V> r = response(v);
            V g_exponent = g_raw * alpha;
            opacity = opacity + g_exponent;
            if constexpr (A::has_floor) g_exponent = g_exponent + g_raw * floor;
            const V gu = g_exponent * r.u, gv = g_exponent * r.v;
            u = u + gu;
            v1 = v1 + gv;
            uu = uu + gu * r.u;
            uv = uv + gu * r.v;
            vv = vv + gv * r.v;
            depth = depth + alpha * select(on, before, zero) * gz;
        }
        const auto k = static_cast<std::size_t>(h->entry);
        scratch.touched[k] = 1;
        scratch.slots[k] = {lane_sum(u),  lane_sum(v1), lane_sum(uu),   lane_sum(uv),
                            lane_sum(vv), lane_sum(opacity), lane_sum(depth)};
    }
}

} // namespace rye
