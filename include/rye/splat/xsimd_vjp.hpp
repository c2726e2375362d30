// SPDX-License-Identifier: Apache-2.0
/// rye/splat/xsimd_vjp.hpp: the reverse walk of a tile in vectors. The forward walk is repeated
/// without colours, laying down alpha and transmittance; then, far to near, as in splat/vjp.hpp,
/// an entry at a time over its strips, so that its sums stay in registers.
#pragma once

#include <rye/splat/vjp.hpp>
#include <rye/splat/xsimd_lanes.hpp>

namespace rye {

/// Memory of one thread's tiles.
template <class V>
struct LaneTape : Workspaces::Space {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    using Group = LaneGroup<V>;

    /// A recorded group: which strips its entries added to, and where each strip's steps end.
    struct Recorded {
        std::uint32_t strips[Group::words][Group::most];
        Index end[Tile::count];
    };
    LaneGroup<V> group;
    alignas(64) T transmittance[tile_pixels], left[tile_pixels];
    alignas(64) T behind[tile_pixels], g_alpha[tile_pixels], g_depth[tile_pixels];
    alignas(64) T weight[tile_pixels];
    std::vector<Recorded> groups;
    Lines<T> steps;          ///< alpha and transmittance of each step: two vectors
    Index used = 0;          ///< steps
    Lines<T> cotangent;      ///< strip by strip: a vector a channel, zeros behind the channels
    Lines<T> feature;        ///< of a group, padded
    Lines<T> background;     ///< padded
};

/// Repeats the forward walk of a tile onto the tape.
template <class V, class A>
void record_tile(const Scene<typename V::value_type>& scene, const A& accuracy, Index tile,
                 const Strips<V>& strips, LaneTape<V>& tape) {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    constexpr int lanes = Tile::lanes;
    const LaneBlend<A, V> blend(accuracy);
    LaneGroup<V>& group = tape.group;
    strips.start(tape.transmittance);
    std::fill_n(tape.left, tile_pixels, T(0));
    tape.groups.clear();
    tape.used = 0;
    std::uint32_t open[LaneGroup<V>::words];
    const Index begin = scene.begin(tile), end = begin + scene.used(tile);
    for (Index k = begin; k < end && open_strips<V>(tape.transmittance, open);) {
        const Index next = std::min<Index>(end, k + LaneGroup<V>::most);
        fetch_ahead(scene, next, std::min<Index>(end, next + LaneGroup<V>::most));
        group.fill(scene, strips, scene.top(tile), k, next, open);
        auto& recorded = tape.groups.emplace_back();
        std::copy_n(group.strips[0], LaneGroup<V>::words * LaneGroup<V>::most, recorded.strips[0]);
        T* const steps = tape.steps.grow(
            (tape.used + Tile::count * LaneGroup<V>::most) * 2 * lanes, tape.used * 2 * lanes);
        T* to = steps + tape.used * 2 * lanes;
        for (int s = 0; s < Tile::count; ++s) {
            const int row = s % tile_edge, side = s / tile_edge, at = s * lanes;
            V t = V::load_aligned(tape.transmittance + at);
            for (std::uint32_t todo = group.entries_of(s); todo != 0; todo &= todo - 1) {
                const int entry = std::countr_zero(todo);
                const auto& shared = group.shared[entry];
                const V v = V::load_aligned(shared.v + side * lanes) + V(shared.down[row]);
                const V exponent = V::load_aligned(shared.exponent + side * lanes) - v * v;
                const LaneShare<V> share = blend(exponent, V(group.cut[entry]),
                                                 V(group.floor[entry]), t, tape.left + at);
                share.alpha.store_aligned(to);
                share.before.store_aligned(to + lanes);
                to += 2 * lanes;
            }
            t.store_aligned(tape.transmittance + at);
            recorded.end[s] = (to - steps) / (2 * lanes);
        }
        tape.used = (to - steps) / (2 * lanes);
        k = next;
    }
}

/// <cotangent, colour> of a strip's pixels, from `stride` vectors: C few channels, else eights. One
/// function for entries and background, so that equal colours give equal sums.
template <class V, int C>
[[gnu::always_inline]] inline V along(const typename V::value_type* cotangent,
                                      const typename V::value_type* colour, Index stride) {
    constexpr int lanes = static_cast<int>(V::size);
    constexpr int parts = C > 0 ? C : 8;         // sums that do not wait for each other
    std::array<V, std::size_t(parts)> sum;
    unrolled<parts>(
        [&](auto i) { sum[i] = V::load_aligned(cotangent + i * lanes) * V(colour[i]); });
    if constexpr (C == 0) {
        for (Index c = parts; c < stride; c += parts)
            unrolled<parts>([&](auto i) {
                sum[i] = sum[i] + V::load_aligned(cotangent + (c + i) * lanes) * V(colour[c + i]);
            });
        unrolled<4>([&](auto i) { sum[i] = sum[i] + sum[i + 4]; });
        return (sum[0] + sum[2]) + (sum[1] + sum[3]);
    } else {
        unrolled<C - 1>([&](auto i) { sum[0] = sum[0] + sum[i + 1]; });
        return sum[0];
    }
}

/// The cotangents of a tile's pixels, strip by strip, and that of the background seen through it.
template <class V, int C>
void load_cotangents(const Scene<typename V::value_type>& scene,
                     const RasterCotangent<typename V::value_type>& g, Index tile,
                     const Strips<V>& strips, Index stride, LaneTape<V>& tape) {
    using T = typename V::value_type;
    constexpr int lanes = Strips<V>::lanes;
    const Index channels = C > 0 ? C : scene.feature.rows();
    T* const cotangent = tape.cotangent.reserve(stride * tile_pixels);
    if (stride != channels || strips.width < tile_edge || strips.height < tile_edge)
        std::fill_n(cotangent, stride * tile_pixels, T(0));
    std::fill_n(tape.g_alpha, tile_pixels, T(0));
    std::fill_n(tape.g_depth, tile_pixels, T(0));
    for (int y = 0; y < strips.height; ++y) {
        const Index from = scene.pixel(scene.left(tile), scene.top(tile) + y);
        const T* gp = g.feature.data() + from * channels;
        for (int x = 0; x < strips.width; ++x) {
            const int at = Strips<V>::at(x, y);
            T* const to = cotangent + at / lanes * lanes * stride + at % lanes;
            for (Index c = 0; c < channels; ++c) to[c * lanes] = *gp++;
            if (g.alpha != nullptr) tape.g_alpha[at] = g.alpha->data()[from + x];
            if (g.depth != nullptr) tape.g_depth[at] = g.depth->data()[from + x];
        }
    }
    T* const background = tape.background.reserve(stride);
    std::fill_n(background, stride, T(0));
    std::copy_n(scene.background.data(), channels, background);
    for (int at = 0; at < tile_pixels; at += lanes)
        along<V, C>(cotangent + at * stride, background, stride).store_aligned(tape.behind + at);
}

/// One entry of the reverse walk, into its slot. C few channels, or any number for C = 0; only
/// `Extra` if alpha or depth has a cotangent.
template <class V, int C, bool Extra, class A>
struct LaneReverse {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    static constexpr int lanes = Tile::lanes;

    const Strips<V>& strips;
    LaneTape<V>& tape;
    Index channels, stride;
    V alpha_max;
    const T* cotangent;
    Index* cursor;           ///< of each strip: steps that are left

    void operator()(const Splat<T>& s, const std::uint32_t* reached, const T* feature, T* slot) {
        const V zero(T(0));
        std::array<V, 8> sum;                // as in SplatCotangent
        sum.fill(zero);
        std::array<V, std::size_t(std::max(C, 1))> colour;
        colour.fill(zero);
        V opacity = zero, depth = zero;
        const V z(s.depth), floor(s.floor);
        const T* const steps = tape.steps.lines[0].x;
        alignas(64) T down[tile_edge];
        unrolled<Tile::sides>([&](auto i) {
            (V(s.vy) * (V::load_aligned(strips.y + i * lanes) - V(s.y)))
                .store_aligned(down + i * lanes);
        });
        for (int side = 0; side < Tile::sides; ++side) {
            std::uint32_t rows = rows_of(reached, side);
            if (rows == 0) continue;
            const V dx = V::load_aligned(strips.x + side * lanes) - V(s.x);
            const V u = V(s.ux) * dx, across = V(s.vx) * dx;
            V g0 = zero, g1 = zero, g2 = zero;                   // sums of g, g v, g v^2
            for (; rows != 0; rows &= rows - 1) {
                const int row = std::countr_zero(rows), strip = side * tile_edge + row;
                const int at = strip * lanes;
                const T* const step = steps + --cursor[strip] * 2 * lanes;
                const T* const g_strip = cotangent + at * stride;
                const V alpha = V::load_aligned(step), before = V::load_aligned(step + lanes);
                const V weight = alpha * before;
                if constexpr (C > 0)
                    unrolled<C>([&](auto c) {
                        colour[c] = colour[c] + V::load_aligned(g_strip + c * lanes) * weight;
                    });
                else
                    weight.store_aligned(tape.weight + at);
                const V behind = V::load_aligned(tape.behind + at);
                V more = along<V, C>(g_strip, feature, stride) - behind;
                if constexpr (Extra) {
                    const V gz = V::load_aligned(tape.g_depth + at);
                    more = more + (V::load_aligned(tape.g_alpha + at) + gz * z);
                    depth = depth + weight * gz;
                }
                more = select(weight > zero, more, zero);
                (behind + alpha * more).store_aligned(tape.behind + at);
                const V g_raw = select(alpha < alpha_max, before * more, zero);
                V g = g_raw * alpha;
                if constexpr (A::has_floor) {
                    opacity = opacity + g;
                    g = g + g_raw * floor;
                }
                const V v = across + V(down[row]);
                const V gv = g * v;
                g0 = g0 + g;
                g1 = g1 + gv;
                g2 = g2 + gv * v;
            }
            const V gu = g0 * u;
            sum[0] = sum[0] + gu;
            sum[1] = sum[1] + g1;
            sum[2] = sum[2] + gu * u;
            sum[3] = sum[3] + g1 * u;
            sum[4] = sum[4] + g2;
            sum[5] = sum[5] + g0;
        }
        if constexpr (A::has_floor) sum[5] = opacity;
        sum[6] = depth;
        lane_sums(sum, slot);
        if constexpr (C > 0) {
            std::array<V, 8> padded;
            padded.fill(zero);
            unrolled<C>([&](auto c) { padded[c] = colour[c]; });
            lane_sums(padded, slot + Slots<T>::head);
        } else {
            gather_features(reached, slot + Slots<T>::head);
        }
    }

  private:
    /// The rows of a side, a bit each, from the words of an entry's strips.
    static std::uint32_t rows_of(const std::uint32_t* reached, int side) {
        const int bit = side * tile_edge;
        return reached[bit / 32] >> (bit % 32) & ((1U << tile_edge) - 1);
    }
    /// Sums of weight times cotangent, eight channels at a time.
    void gather_features(const std::uint32_t* reached, T* to) {
        for (Index c = 0; c < channels; c += 8) {
            std::array<V, 8> sum;
            sum.fill(V(T(0)));
            for (int side = 0; side < Tile::sides; ++side)
                for (std::uint32_t rows = rows_of(reached, side); rows != 0; rows &= rows - 1) {
                    const int at = (side * tile_edge + std::countr_zero(rows)) * lanes;
                    const V weight = V::load_aligned(tape.weight + at);
                    const T* const g = cotangent + at * stride + c * lanes;
                    unrolled<8>([&](auto i) {
                        sum[i] = sum[i] + V::load_aligned(g + i * lanes) * weight;
                    });
                }
            lane_sums(sum, to + c);
        }
    }
};

/// Asks for the slots of entries, to be written. Always inlined, as fetch_ahead.
template <class T>
[[gnu::always_inline]] inline void fetch_slots(const Scene<T>& scene, const Slots<T>& slots,
                                               Index begin, Index end) {
    constexpr Index line = 64 / static_cast<Index>(sizeof(T));
    for (Index k = begin; k < end; ++k)
        for (Index c = 0; c < slots.stride; c += line)
            __builtin_prefetch(slots[scene.slot(k)] + c, 1);
}

/// Gradients of one tile's pixels, into the slots of its entries.
template <class V, int C, bool Extra, class A>
void blend_tile_vjp_lanes(const Scene<typename V::value_type>& scene, const A& accuracy,
                          const RasterCotangent<typename V::value_type>& g, Index tile,
                          RasterScratch<typename V::value_type>& scratch, LaneTape<V>& tape) {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    if (scene.used(tile) == 0) return;
    if constexpr (A::order == BlendOrder::by_peak) {
        std::vector<Hit<T>> hits;
        return blend_tile_vjp(scene, accuracy, g, tile, scratch, hits);
    }
    const Tile strips(scene, tile);
    const Index channels = scene.feature.rows();
    const Index stride = C > 0 ? C : padded_channels<V>(channels);
    record_tile<V>(scene, accuracy, tile, strips, tape);
    load_cotangents<V, C>(scene, g, tile, strips, stride, tape);

    Index cursor[Tile::count];
    LaneReverse<V, C, Extra, A> reverse{strips,
                                 tape,
                                 channels,
                                 stride,
                                 V(static_cast<T>(accuracy.alpha_max)),
                                 tape.cotangent.lines[0].x,
                                 cursor};
    T* const feature = tape.feature.reserve(LaneGroup<V>::most * stride);
    const auto first_of = [&](std::size_t group) {
        return scene.begin(tile) + static_cast<Index>(group) * LaneGroup<V>::most;
    };
    for (std::size_t i = tape.groups.size(); i-- > 0;) {
        const auto& group = tape.groups[i];
        std::copy_n(group.end, Tile::count, cursor);
        const Index first = first_of(i);
        const Index end =
            std::min<Index>(scene.begin(tile) + scene.used(tile), first + LaneGroup<V>::most);
        copy_features<V, C>(scene, first, end, stride, feature);
        if (i > 0) {
            fetch_features(scene, first_of(i - 1), first);
            fetch_slots(scene, scratch.slots, first_of(i - 1), first);
        }
        for (Index entry = end; entry-- > first;) {
            std::uint32_t reached[LaneGroup<V>::words], any_strip = 0;
            for (int w = 0; w < LaneGroup<V>::words; ++w)
                any_strip |= reached[w] = group.strips[w][entry - first];
            if (any_strip == 0) continue;
            const Index slot = scene.slot(entry);
            scratch.slots.touched[static_cast<std::size_t>(slot)] = 1;
            reverse(scene.splat(entry), reached, feature + (entry - first) * stride,
                    scratch.slots[slot]);
        }
    }
}

} // namespace rye
