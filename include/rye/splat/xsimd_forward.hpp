// SPDX-License-Identifier: Apache-2.0
/// rye/splat/xsimd_forward.hpp: blending a tile, visit by visit, with a pixel in each lane. The
/// sums of a few channels lie beside the transmittance. Many channels are a product of matrices for
/// each strip, the weights of its visits times their entries' features, with channels in the lanes.
#pragma once

#include <rye/splat/forward.hpp>
#include <rye/splat/xsimd_group.hpp>

namespace rye {

/// The vectors of a strip: transmittance, what the outputs ask for, sums of C channels.
template <Outputs O, int C>
struct LaneState {
    static constexpr int depth = 1;
    static constexpr int most = depth + (O.depth ? 1 : 0);             ///< the largest weight
    static constexpr int contributor = most + (O.contributor ? 1 : 0); ///< its entry of the tile
    static constexpr int sums = contributor + (O.contributor ? 1 : 0);
    static constexpr int vectors = sums + C;
};

/// Memory of one thread's tiles.
template <class V>
struct LaneCanvas : Workspaces::Space {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    static constexpr int most = LaneGroup<V>::most;

    LaneGroup<V> group;
    Lines<T> state;          ///< of each strip, the vectors that LaneState numbers
    // Of many channels:
    Lines<T> sums;           ///< a row a pixel
    Lines<T> feature;        ///< of the group
    alignas(64) T weight[Tile::count][most][V::size];  ///< of each strip's visits
    std::uint8_t of[Tile::count][most];                ///< of each strip's visits: their entries
    std::uint8_t visits[Tile::count];
};

/// sums(pixel, channels) += sum_j weight[j][pixel] feature(of[j], channels) for the pixels of a
/// strip and P vectors of channels; two pixels at a time keep their sums in registers.
template <int P, class V>
void blend_channels(const typename V::value_type (*weight)[V::size], const std::uint8_t* of,
                    int visits, const typename V::value_type* feature, Index stride,
                    typename V::value_type* sums) {
    constexpr int lanes = static_cast<int>(V::size);
    for (int p = 0; p < lanes; p += 2) {
        std::array<V, std::size_t(P)> a, b;
        typename V::value_type* const to = sums + p * stride;
        unrolled<P>([&](auto i) {
            a[i] = V::load_aligned(to + i * lanes);
            b[i] = V::load_aligned(to + stride + i * lanes);
        });
        for (int j = 0; j < visits; ++j) {
            const V wa(weight[j][p]), wb(weight[j][p + 1]);
            const auto* f = feature + of[j] * stride;
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

/// Blends a group's visits. C few channels, or any number for C = 0, whose weights are laid down.
/// `first` is the group's first entry, counted from the tile's.
template <class V, int C, class A>
void blend_group(LaneBlend<A, V> blend, [[maybe_unused]] Index first, LaneCanvas<V>& canvas) {
    using T = typename V::value_type;
    using State = LaneState<A::outputs, C>;
    constexpr int lanes = static_cast<int>(V::size);
    LaneGroup<V>& group = canvas.group;
    blend.alphas(group);
    T* const state = canvas.state.lines[0].x;
    const int visits = group.visits;
    for (int i = 0; i < visits; ++i) {
        const LaneEntry<T>& entry = group.entry[group.of[i]];
        const std::size_t strip = group.strip[i];
        T* const at = state + strip * (State::vectors * lanes);
        V t = V::load_aligned(at);
        const V w = blend(V::load_aligned(group.alpha[i]), t).weight;
        t.store_aligned(at);
        if constexpr (A::outputs.depth) {
            T* const depth = at + State::depth * lanes;
            (V::load_aligned(depth) + w * V(entry.depth)).store_aligned(depth);
        }
        if constexpr (A::outputs.contributor) {
            T* const most = at + State::most * lanes;
            T* const which = at + State::contributor * lanes;
            const V before = V::load_aligned(most);
            const V self(static_cast<T>(first + group.of[i]));
            select(w > before, self, V::load_aligned(which)).store_aligned(which);
            max(w, before).store_aligned(most);
        }
        if constexpr (C > 0) {
            unrolled<C>([&](auto c) __attribute__((always_inline)) {
                T* const sum = at + (State::sums + c) * lanes;
                (V::load_aligned(sum) + w * V(entry.colour[c])).store_aligned(sum);
            });
        } else {
            const int j = canvas.visits[strip]++;
            w.store_aligned(canvas.weight[strip][j]);
            canvas.of[strip][j] = group.of[i];
        }
    }
}

/// The product of matrices of a group of many channels.
template <class V>
void blend_features(Index stride, LaneCanvas<V>& canvas) {
    constexpr int lanes = static_cast<int>(V::size);
    for (int s = 0; s < Strips<V>::count; ++s) {
        auto* const sums = canvas.sums.lines[0].x + s * lanes * stride;
        Index c = 0;
        const auto blocks = [&]<int P>(std::integral_constant<int, P>) {
            for (; c + P * lanes <= stride; c += P * lanes)
                blend_channels<P, V>(canvas.weight[s], canvas.of[s], canvas.visits[s],
                                     canvas.feature.lines[0].x + c, stride, sums + c);
        };
        if (canvas.visits[s] == 0) continue;
        blocks(std::integral_constant<int, 4>());
        blocks(std::integral_constant<int, 2>());
        blocks(std::integral_constant<int, 1>());
    }
}

/// Tiles [first, last) of one row of tiles, which hold no Gaussian, row of pixels by row.
template <class T, Outputs O>
void draw_background(const Scene<T>& scene, Index first, Index last, Raster<T, O>& out) {
    const Index channels = scene.feature.rows(), n = scene.right(last - 1) - scene.left(first);
    const auto pixels = [&](int y) {
        return out.feature.pixels.data() + scene.pixel(scene.left(first), y) * channels;
    };
    const int top = scene.top(first);
    for (Index i = 0; i < n * channels; ++i) pixels(top)[i] = scene.background[i % channels];
    for (int y = top; y < scene.bottom(first); ++y) {
        if (y > top) std::copy_n(pixels(top), n * channels, pixels(y));
        const Index p = scene.pixel(scene.left(first), y);
        std::fill_n(out.alpha.pixels.data() + p, n, T(0));
        if constexpr (O.depth) std::fill_n(out.depth.pixels.data() + p, n, T(0));
        if constexpr (O.contributor)
            std::fill_n(out.contributor.pixels.data() + p, n, no_contributor);
    }
    std::fill(out.trace.used.begin() + first, out.trace.used.begin() + last, 0);
}

/// Draws strips of one tile, which holds Gaussians. C few channels, or any number for C = 0.
template <class V, int C, class A>
void blend_tile_lanes(const Scene<typename V::value_type>& scene, const A& accuracy, Index tile,
                      const StripMask& drawn, Raster<typename V::value_type, A::outputs>& out,
                      LaneCanvas<V>& canvas) {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    if constexpr (A::order == BlendOrder::by_peak) return blend_tile(scene, accuracy, tile, out);
    constexpr int lanes = Tile::lanes, most = LaneGroup<V>::most;
    using State = LaneState<A::outputs, C>;
    constexpr Index state_stride = State::vectors * lanes;
    const Index channels = C > 0 ? C : scene.feature.rows();
    const Index stride = C > 0 ? C : padded_channels<V>(channels);
    const Index begin = scene.begin(tile), end = scene.end(tile);
    const Tile strips(scene, tile);
    const LaneBlend<A, V> blend(accuracy);
    T* const state = canvas.state.reserve(Tile::count * state_stride);
    std::fill_n(state, Tile::count * state_stride, T(0));
    strips.start(drawn, state, state_stride);
    if constexpr (C == 0) {
        std::fill_n(canvas.sums.reserve(tile_pixels * stride), tile_pixels * stride, T(0));
        canvas.feature.reserve(most * stride);
    }

    typename LaneGroup<V>::Open open;
    fetch_ahead(scene, begin, std::min<Index>(end, begin + 2 * most));
    Index k = begin;
    while (k < end && blend.open_strips(state, state_stride, open)) {
        const Index next = std::min<Index>(end, k + most);
        const Index after = std::min<Index>(end, next + most);
        fetch_ahead(scene, after, std::min<Index>(end, after + most));
        fetch_features(scene, next, after);
        canvas.group.fill(scene, strips, scene.top(tile), k, next, open);
        if constexpr (C > 0) {
            for (Index i = k; i < next; ++i)
                std::copy_n(scene.feature_of(i), C, canvas.group.entry[i - k].colour);
        } else {
            copy_features<V>(scene, k, next, stride, canvas.feature.lines[0].x);
            std::fill_n(canvas.visits, Tile::count, std::uint8_t(0));
        }
        blend_group<V, C>(blend, k - begin, canvas);
        if constexpr (C == 0) blend_features<V>(stride, canvas);
        k = next;
    }
    out.trace.used[static_cast<std::size_t>(tile)] = k - begin;

    for (int y = 0; y < strips.height; ++y) {
        const Index p = scene.pixel(scene.left(tile), scene.top(tile) + y);
        T* to = out.feature.pixels.data() + p * channels;
        for (int x = 0; x < strips.width; ++x) {
            const int strip = Tile::strip(x, y), lane = x % lanes;
            if (!drawn.has(strip)) {
                to += channels;
                continue;
            }
            const T* const from = state + strip * state_stride + lane;
            const T behind = std::abs(from[0]);
            out.alpha.pixels.data()[p + x] = T(1) - behind;
            if constexpr (A::outputs.depth)
                out.depth.pixels.data()[p + x] = from[State::depth * lanes];
            if constexpr (A::outputs.contributor) {
                const auto entry = static_cast<Index>(from[State::contributor * lanes]);
                out.contributor.pixels.data()[p + x] =
                    from[State::most * lanes] > T(0) ? scene.member(begin + entry).source
                                                     : no_contributor;
            }
            if constexpr (C > 0) {
                for (int c = 0; c < C; ++c)
                    *to++ = from[(State::sums + c) * lanes] + behind * scene.background[c];
            } else {
                const T* const sum = canvas.sums.lines[0].x + (strip * lanes + lane) * stride;
                const T* const back = scene.background.data();
                Index c = 0;
                for (; c + lanes <= channels; c += lanes)
                    (V::load_aligned(sum + c) + V(behind) * V::load_unaligned(back + c))
                        .store_unaligned(to + c);
                for (; c < channels; ++c) to[c] = sum[c] + behind * back[c];
                to += channels;
            }
        }
    }
}

/// Draws tiles drawn.tile(k) for the ks of a span.
template <class V, int C, class A>
void blend_tiles_lanes(const Scene<typename V::value_type>& scene, const A& accuracy,
                       const DrawnTiles& drawn, const std::array<Index, 2>& span,
                       Raster<typename V::value_type, A::outputs>& out, LaneCanvas<V>& canvas) {
    const auto empty = [&](Index t) { return scene.begin(t) == scene.end(t); };
    for (Index k = span[0]; k < span[1];) {
        const Index first = drawn.tile(k);
        Index last = first;
        while (k < span[1] && drawn.tile(k) == last && empty(last) &&
               scene.top(last) == scene.top(first)) {
            ++k;
            ++last;
        }
        if (last > first)
            draw_background(scene, first, last, out);
        else
            blend_tile_lanes<V, C>(scene, accuracy, first, drawn.mask(k++), out, canvas);
    }
}

} // namespace rye
