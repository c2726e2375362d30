// SPDX-License-Identifier: Apache-2.0
/// rye/splat/lanes/forward.hpp: blending a tile, strip by strip, with a pixel in each lane. Sums of
/// a few channels stay in registers along a strip's entries. Many channels are a product of
/// matrices, the weights of a strip's visits times their entries' features, with channels in the
/// lanes.
#pragma once

#include <rye/splat/lanes/group.hpp>
#include <rye/splat/plain/forward.hpp>

namespace rye::detail {

/// Places of a strip's vectors: transmittance, those of the outputs, sums of C channels.
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
    static constexpr int most = LaneGroup<V>::most;

    LaneGroup<V> group;
    AlignedArray<T> state;   ///< [strips] the vectors that LaneState numbers
    // For many channels:
    AlignedArray<T> sums;    ///< a row a pixel
    AlignedArray<T> feature; ///< features of the group
    alignas(64) T weight[std::size_t(most)][V::size];         ///< weights of a strip's visits
    std::uint8_t of[std::size_t(most)];                       ///< their entries
};

/// A strip's visits: their weights and entries.
template <class V>
struct StripVisits {
    const typename V::value_type (*weight)[V::size];
    const std::uint8_t* of;
    int count;
};

/// sums(pixel, channels) += sum_j weight[j][pixel] feature(of[j], channels) for the pixels of a
/// strip and P vectors of channels; two pixels at a time keep their sums in registers.
template <int P, class V>
void blend_channels(const StripVisits<V>& visits, const typename V::value_type* feature,
                    Index stride, typename V::value_type* sums) {
    constexpr int lanes = static_cast<int>(V::size);
    const auto* const weight = visits.weight;
    const std::uint8_t* const of = visits.of;
    const int count = visits.count;
    for (int p = 0; p < lanes; p += 2) {
        std::array<V, std::size_t(P)> a, b;
        typename V::value_type* const to = sums + p * stride;
        unrolled<P>([&](auto i) {
            a[i] = V::load_aligned(to + i * lanes);
            b[i] = V::load_aligned(to + stride + i * lanes);
        });
        for (int j = 0; j < count; ++j) {
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

/// Adds the product of matrices of a strip's visits.
template <class V>
void blend_features(int strip, int visits, Index stride, LaneCanvas<V>& canvas) {
    constexpr int lanes = static_cast<int>(V::size);
    auto* const sums = canvas.sums.data() + strip * lanes * stride;
    Index c = 0;
    const auto blocks = [&]<int P>(std::integral_constant<int, P>) {
        for (; c + P * lanes <= stride; c += P * lanes)
            blend_channels<P>(StripVisits<V>{canvas.weight, canvas.of, visits},
                              canvas.feature.data() + c, stride, sums + c);
    };
    blocks(std::integral_constant<int, 4>());
    blocks(std::integral_constant<int, 2>());
    blocks(std::integral_constant<int, 1>());
}

/// Blends a group's visits of a strip. C few channels, or any number for C = 0. `first` is the
/// group's first entry, counted from the tile's. Returns true if the strip can still take a
/// contribution.
template <class V, int C, class A>
bool blend_strip(const LaneBlend<A, V>& blend, int strip, [[maybe_unused]] Index first,
                 [[maybe_unused]] Index stride, LaneCanvas<V>& canvas) {
    using T = typename V::value_type;
    using State = LaneState<A::outputs, C>;
    constexpr int lanes = static_cast<int>(V::size);
    T* const at = canvas.state.data() + strip * (State::vectors * lanes);
    std::array<V, std::size_t(State::vectors)> state;
    unrolled<State::vectors>([&](auto i) { state[i] = V::load_aligned(at + i * lanes); });
    [[maybe_unused]] int visits = 0;
    blend.along(canvas.group, strip, state[0],
                [&](int k, const LaneEntry<V>& entry, const Contribution<V>& c)
                    __attribute__((always_inline)) {
        const V& w = c.weight;
        if constexpr (A::outputs.depth)
            state[State::depth] = state[State::depth] + w * V(entry.depth);
        if constexpr (A::outputs.contributor) {
            const V before = state[State::most], self(static_cast<T>(first + k));
            state[State::contributor] = select(w > before, self, state[State::contributor]);
            state[State::most] = max(w, before);
        }
        unrolled<C>([&](auto i) __attribute__((always_inline)) {
            state[State::sums + i] = state[State::sums + i] + w * V(entry.colour[i]);
        });
        if constexpr (C == 0) {
            w.store_aligned(canvas.weight[visits]);
            canvas.of[visits] = static_cast<std::uint8_t>(k);
            visits += any(w > V(T(0))) ? 1 : 0;
        }
    });
    unrolled<State::vectors>([&](auto i) { state[i].store_aligned(at + i * lanes); });
    if constexpr (C == 0) blend_features(strip, visits, stride, canvas);
    return blend.any_open(state[0]);
}

/// Draws tiles [first, last) of one row of tiles, which hold no Gaussian, row of pixels by row.
template <class T, Outputs O>
void draw_background(const Scene<T>& scene, Index first, Index last, Raster<T, O>& out) {
    const Index channels = scene.channels(), n = scene.right(last - 1) - scene.left(first);
    const auto pixels = [&](int y) {
        return out.feature.pixels.data() + scene.pixel(scene.left(first), y) * channels;
    };
    const int top = scene.top(first);
    T* to = pixels(top);
    for (Index x = 0; x < n; ++x)
        for (Index c = 0; c < channels; ++c) *to++ = scene.background[c];
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

/// Completes a strip's pixels over the background, and puts them where they belong.
template <class V, int C, class A>
void write_strip(const Scene<typename V::value_type>& scene, const Strips<V>& strips, int strip,
                 LaneCanvas<V>& canvas, Raster<typename V::value_type, A::outputs>& out) {
    using T = typename V::value_type;
    const Index tile = strips.tile;
    using Tile = Strips<V>;
    using State = LaneState<A::outputs, C>;
    constexpr int lanes = Tile::lanes;
    const Index channels = C > 0 ? C : scene.channels();
    T* const state = canvas.state.data() + strip * (State::vectors * lanes);
    const V behind = abs(V::load_aligned(state));
    alignas(64) T alpha[V::size], pixel[std::size_t(std::max(C, 1))][V::size];
    (V(T(1)) - behind).store_aligned(alpha);
    unrolled<C>([&](auto c) __attribute__((always_inline)) {
        (V::load_aligned(state + (State::sums + c) * lanes) + behind * V(scene.background[c]))
            .store_aligned(pixel[c]);
    });
    const int left = Tile::side(strip) * Tile::wide, top = Tile::row(strip);
    const int wide = std::min(Tile::wide, strips.width - left);
    const int high = std::min(Tile::high, strips.height - top);
    for (int y = 0; y < high; ++y) {
        Index p = scene.pixel(scene.left(tile) + left, scene.top(tile) + top + y);
        T* to = out.feature.pixels.data() + p * channels;
        for (int x = 0; x < wide; ++x, ++p, to += channels) {
            const int lane = Tile::lane(x, y);
            out.alpha.pixels.data()[p] = alpha[lane];
            if constexpr (A::outputs.depth)
                out.depth.pixels.data()[p] = state[State::depth * lanes + lane];
            if constexpr (A::outputs.contributor) {
                const auto entry = static_cast<Index>(state[State::contributor * lanes + lane]);
                out.contributor.pixels.data()[p] =
                    state[State::most * lanes + lane] > T(0)
                        ? scene.member(scene.begin(tile) + entry).source
                        : no_contributor;
            }
            unrolled<C>([&](auto c) { to[c] = pixel[c][lane]; });
            if constexpr (C == 0) {
                const Index stride = padded_channels<V>(channels);
                const T* const sum = canvas.sums.data() + (strip * lanes + lane) * stride;
                const T* const back = scene.background.data();
                const T share = std::abs(state[lane]);
                Index c = 0;
                for (; c + lanes <= channels; c += lanes)
                    (V::load_aligned(sum + c) + V(share) * V::load_unaligned(back + c))
                        .store_unaligned(to + c);
                for (; c < channels; ++c) to[c] = sum[c] + share * back[c];
            }
        }
    }
}

/// Draws strips of one tile, which holds Gaussians. C few channels, or any number for C = 0.
template <class V, int C, class A>
void blend_tile_lanes(const Scene<typename V::value_type>& scene, const A& accuracy,
                      const DrawnTile& what, Raster<typename V::value_type, A::outputs>& out,
                      LaneCanvas<V>& canvas) {
    using T = typename V::value_type;
    const Index tile = what.tile;
    const StripMask& drawn = what.strips;
    using Tile = Strips<V>;
    if constexpr (A::order == BlendOrder::by_peak) return blend_tile(scene, accuracy, tile, out);
    constexpr int lanes = Tile::lanes;
    constexpr Index most = C > 0 ? LaneGroup<V>::usual : LaneGroup<V>::most;
    using State = LaneState<A::outputs, C>;
    constexpr Index state_stride = State::vectors * lanes;
    const Index channels = C > 0 ? C : scene.channels();
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

    const StripMask inside = strips.inside(drawn);
    StripMask open = inside;
    // Features are prefetched a few entries ahead in the first group, and those of the next group
    // with each strip.
    const FetchRecords<T> records(scene, tile, end);
    constexpr Index each = (most + Tile::count - 1) / Tile::count, soon = 8;
    const Index first_end = std::min<Index>(end, begin + most);
    for (Index i = begin; i < std::min(end, begin + soon); ++i) fetch_record(scene, i);
    const auto fetch = [&](Index entry) __attribute__((always_inline)) {
        records(entry);
        if (entry + soon < first_end) fetch_features(scene, entry + soon);
    };
    Index k = begin;
    while (k < end && !open.none()) {
        const Index next = std::min<Index>(end, k + most);
        canvas.group.template fill<C>(scene, strips, scene.top(tile), k, next, fetch);
        if constexpr (C == 0) copy_features<V>(scene, k, next, stride, canvas.feature.data());
        for (int s = 0; s < Tile::count; ++s) {
            for (Index i = s * each; i < std::min(most, (s + 1) * each) && next + i < end; ++i)
                fetch_features(scene, next + i);
            if (canvas.group.reaching[s] != 0 && open.has(s) &&
                !blend_strip<V, C>(blend, s, k - begin, stride, canvas))
                open.clear(s);
        }
        k = next;
    }
    out.trace.used[static_cast<std::size_t>(tile)] = k - begin;

    for (int strip = 0; strip < Tile::count; ++strip)
        if (inside.has(strip)) write_strip<V, C, A>(scene, strips, strip, canvas, out);
}

/// Draws tiles.
template <class V, int C, class A>
void blend_tiles_lanes(const Scene<typename V::value_type>& scene, const A& accuracy,
                       const DrawnTiles& drawn, Raster<typename V::value_type, A::outputs>& out,
                       LaneCanvas<V>& canvas) {
    const auto empty = [&](Index t) { return scene.begin(t) == scene.end(t); };
    for (Index k = drawn.begin; k < drawn.end;) {
        const Index first = drawn.tile(k);
        Index last = first;
        while (k < drawn.end && drawn.tile(k) == last && empty(last) &&
               scene.top(last) == scene.top(first)) {
            ++k;
            ++last;
        }
        if (last > first)
            draw_background(scene, first, last, out);
        else
            blend_tile_lanes<V, C>(scene, accuracy, {first, drawn.mask(k++)}, out, canvas);
    }
}

} // namespace rye::detail
