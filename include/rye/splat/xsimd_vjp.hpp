// SPDX-License-Identifier: Apache-2.0
/// rye/splat/xsimd_vjp.hpp: the reverse walk of a tile in vectors. The forward walk is repeated
/// without colours, laying down alpha and transmittance; then, far to near, as in splat/vjp.hpp,
/// an entry at a time over its strips, so that its sums stay in registers.
#pragma once

#include <rye/splat/xsimd_lanes.hpp>

namespace rye {

/// Memory of one thread's tiles.
template <class V>
struct LaneTape {
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
    alignas(64) T along[tile_pixels], weight[tile_pixels];
    std::vector<Recorded> groups;
    Lines<T> steps;          ///< alpha and transmittance of each step: two vectors
    Index used = 0;          ///< steps
    Lines<T> cotangent;      ///< channels x tile_pixels, strip by strip, zeros behind the channels
    Lines<T> feature;        ///< of one entry, padded
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

/// The cotangents of a tile's pixels, strip by strip, and that of the background seen through it.
template <class V>
void load_cotangents(const Scene<typename V::value_type>& scene,
                     const RasterCotangent<typename V::value_type>& g, Index tile,
                     const Strips<V>& strips, Index stride, LaneTape<V>& tape) {
    using T = typename V::value_type;
    const Index channels = scene.feature.rows();
    T* const cotangent = tape.cotangent.reserve(stride * tile_pixels);
    std::fill_n(cotangent, stride * tile_pixels, T(0));
    std::fill_n(tape.g_alpha, tile_pixels, T(0));
    std::fill_n(tape.g_depth, tile_pixels, T(0));
    for (int y = 0; y < strips.height; ++y) {
        const Index from = scene.pixel(scene.left(tile), scene.top(tile) + y);
        const T* gp = g.feature.data() + from * channels;
        for (int x = 0; x < strips.width; ++x) {
            const int at = Strips<V>::at(x, y);
            for (Index c = 0; c < channels; ++c) cotangent[c * tile_pixels + at] = *gp++;
            if (g.alpha != nullptr) tape.g_alpha[at] = g.alpha->data()[from + x];
            if (g.depth != nullptr) tape.g_depth[at] = g.depth->data()[from + x];
        }
    }
    // As `along` of an entry, so that equal colours give equal sums.
    for (int at = 0; at < tile_pixels; at += Strips<V>::lanes) {
        V sum(T(0));
        for (Index c = 0; c < channels; ++c)
            sum = sum + V::load_aligned(cotangent + c * tile_pixels + at) *
                            V(scene.background[c]);
        sum.store_aligned(tape.behind + at);
    }
}

/// One entry of the reverse walk, into its slot. C few channels, or any number for C = 0.
template <class V, int C, class A>
struct LaneReverse {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    static constexpr int lanes = Tile::lanes;

    const Strips<V>& strips;
    LaneTape<V>& tape;
    Index stride;
    V alpha_max;
    const T* cotangent;
    Index* cursor;           ///< of each strip: steps that are left

    void operator()(const Splat<T>& s, const std::uint32_t* reached, const T* feature, T* slot) {
        const V zero(T(0));
        std::array<V, 8> sum;                // as in SplatCotangent
        sum.fill(zero);
        std::array<V, 8> colour;
        colour.fill(zero);
        if constexpr (C == 0) look_along(reached, feature);
        const V z(s.depth), floor(s.floor), x(s.x), ux(s.ux), vx(s.vx), vy(s.vy), y(s.y);
        for (int side = 0; side < Tile::sides; ++side) {
            const std::uint32_t rows = rows_of(reached, side);
            if (rows == 0) continue;
            const V dx = V::load_aligned(strips.x + side * lanes) - x;
            const V u = ux * dx, across = vx * dx;
            V g0 = zero, g1 = zero, g2 = zero;                   // sums of g, g v, g v^2
            for (std::uint32_t left = rows; left != 0; left &= left - 1) {
                const int row = std::countr_zero(left), strip = side * tile_edge + row;
                const int at = strip * lanes;
                const T* step = tape.steps.lines[0].x + --cursor[strip] * 2 * lanes;
                const V alpha = V::load_aligned(step), before = V::load_aligned(step + lanes);
                const V weight = alpha * before;
                V along = zero;
                if constexpr (C > 0)
                    unrolled<C>([&](auto c) __attribute__((always_inline)) {
                        const V gc = V::load_aligned(cotangent + c * tile_pixels + at);
                        along = along + gc * V(feature[c]);
                        colour[c] = colour[c] + gc * weight;
                    });
                else
                    along = V::load_aligned(tape.along + at), weight.store_aligned(tape.weight + at);
                const V gz = V::load_aligned(tape.g_depth + at);
                const V behind = V::load_aligned(tape.behind + at);
                const V extra = V::load_aligned(tape.g_alpha + at) + gz * z;
                const V more = select(weight > zero, (along - behind) + extra, zero);
                (behind + alpha * more).store_aligned(tape.behind + at);
                const V g_raw = select(alpha < alpha_max, before * more, zero);
                V g = g_raw * alpha;
                sum[5] = sum[5] + g;
                if constexpr (A::has_floor) g = g + g_raw * floor;
                const V v = across + vy * (V(strips.y[row]) - y);
                const V gv = g * v;
                g0 = g0 + g;
                g1 = g1 + gv;
                g2 = g2 + gv * v;
                sum[6] = sum[6] + weight * gz;
            }
            const V gu = g0 * u;
            sum[0] = sum[0] + gu;
            sum[1] = sum[1] + g1;
            sum[2] = sum[2] + gu * u;
            sum[3] = sum[3] + g1 * u;
            sum[4] = sum[4] + g2;
        }
        lane_sums(sum, slot);
        if constexpr (C > 0)
            lane_sums(colour, slot + Slots<T>::head);
        else
            gather_features(reached, slot + Slots<T>::head);
    }

  private:
    /// The rows of a side, a bit each, from the words of an entry's strips.
    static std::uint32_t rows_of(const std::uint32_t* reached, int side) {
        const int bit = side * tile_edge;
        return reached[bit / 32] >> (bit % 32) & ((1U << tile_edge) - 1);
    }
    template <class F>
    static void each_strip(const std::uint32_t* reached, F&& f) {
        for (int side = 0; side < Tile::sides; ++side)
            for (std::uint32_t left = rows_of(reached, side); left != 0; left &= left - 1)
                f((side * tile_edge + std::countr_zero(left)) * lanes);
    }
    /// <cotangent, feature> of each pixel.
    void look_along(const std::uint32_t* reached, const T* feature) {
        each_strip(reached, [&](int at) {
            V along(T(0));
            const T* g = cotangent + at;
            for (Index c = 0; c < stride; c += 8, g += 8 * tile_pixels)
                unrolled<8>([&](auto i) {
                    along = along + V::load_aligned(g + i * tile_pixels) * V(feature[c + i]);
                });
            along.store_aligned(tape.along + at);
        });
    }
    /// Sums of weight times cotangent, eight channels at a time.
    void gather_features(const std::uint32_t* reached, T* to) {
        for (Index c = 0; c < stride; c += 8) {
            std::array<V, 8> sum;
            sum.fill(V(T(0)));
            each_strip(reached, [&](int at) {
                const V weight = V::load_aligned(tape.weight + at);
                const T* g = cotangent + c * tile_pixels + at;
                unrolled<8>([&](auto i) {
                    sum[i] = sum[i] + V::load_aligned(g + i * tile_pixels) * weight;
                });
            });
            lane_sums(sum, to + c);
        }
    }
};

/// Gradients of one tile's pixels, into the slots of its entries.
template <class V, int C, class A>
void blend_tile_vjp_lanes(const Scene<typename V::value_type>& scene, const A& accuracy,
                          const RasterCotangent<typename V::value_type>& g, Index tile,
                          RasterScratch<typename V::value_type>& scratch, LaneTape<V>& tape) {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    if (scene.used(tile) == 0) return;
    const Tile strips(scene, tile);
    const Index channels = scene.feature.rows();
    const Index stride = C > 0 ? C : (channels + 7) / 8 * 8;
    record_tile<V>(scene, accuracy, tile, strips, tape);
    load_cotangents(scene, g, tile, strips, stride, tape);

    Index cursor[Tile::count];
    LaneReverse<V, C, A> reverse{strips,
                                 tape,
                                 stride,
                                 V(static_cast<T>(accuracy.alpha_max)),
                                 tape.cotangent.lines[0].x,
                                 cursor};
    T* const feature = tape.feature.reserve(stride);
    Index entry = scene.begin(tile) + std::min<Index>(
        scene.used(tile), static_cast<Index>(tape.groups.size()) * LaneGroup<V>::most);
    for (std::size_t i = tape.groups.size(); i-- > 0;) {
        const auto& group = tape.groups[i];
        std::copy_n(group.end, Tile::count, cursor);
        const Index first = scene.begin(tile) + static_cast<Index>(i) * LaneGroup<V>::most;
        for (; entry-- > first;) {
            std::uint32_t reached[LaneGroup<V>::words], any_strip = 0;
            for (int w = 0; w < LaneGroup<V>::words; ++w)
                any_strip |= reached[w] = group.strips[w][entry - first];
            if (any_strip == 0) continue;
            const Index slot = scene.slot(entry);
            copy_features<C>(scene, entry, entry + 1, stride, feature);
            scratch.slots.touched[static_cast<std::size_t>(slot)] = 1;
            reverse(scene.splat(entry), reached, feature, scratch.slots[slot]);
        }
        ++entry;
    }
}

} // namespace rye
