// SPDX-License-Identifier: Apache-2.0
/// rye/splat/lanes/vjp.hpp: the reverse walk of a tile in vectors. The forward walk is repeated
/// without colours, strip by strip, laying down alpha and transmittance of each visit; then, far to
/// near, as in splat/plain/vjp.hpp, an entry at a time over its visits, so that its sums stay in
/// registers.
#pragma once

#include <bit>
#include <cstdint>
#include <cstring>

#include <rye/core/bit_cast.hpp>
#include <rye/splat/lanes/along.hpp>
#include <rye/splat/lanes/group.hpp>
#include <rye/splat/plain/vjp.hpp>

namespace rye {

namespace detail {

/// A group of entries on the tape.
template <class V>
struct TapeGroup {
    using Tile = Strips<V>;
    static constexpr int words = (Tile::count + 63) / 64;
    /// [entries] Visits of the entry: a bit for each strip.
    std::uint64_t strips[std::size_t(LaneGroup<V>::usual)][std::size_t(words)];
    Index end[std::size_t(Tile::count)];  ///< [strips] end of the strip's visits
};

/// Memory of one thread's tiles.
template <class V>
struct LaneTape : Workspaces::Space {
    using T = typename V::value_type;
    using Tile = Strips<V>;

    LaneGroup<V> group;
    alignas(64) T transmittance[tile_pixels];
    alignas(64) T behind[tile_pixels], g_alpha[tile_pixels], g_depth[tile_pixels];
    std::vector<TapeGroup<V>> groups;
    AlignedArray<T> steps;              ///< [visits] alpha and transmittance, two vectors;
                                        ///< group by group, strip by strip, from near to far
    AlignedArray<T> cotangent;          ///< [strips] a vector a channel, zeros behind them
    // For many channels, as many as a slot has features:
    AlignedArray<T> background;
    AlignedArray<T> feature;            ///< features of a group
    // For an entry's visits:
    std::uint8_t strip[Tile::count + 8];
    alignas(64) T along[Tile::count][V::size];
    alignas(64) T weight[Tile::count][V::size];
};

/// Repeats the forward walk of a tile onto the tape; returns the number of entries that it took.
template <class V, class A>
Index record_tile(const Scene<typename V::value_type>& scene, const A& accuracy, Index tile,
                  const Strips<V>& strips, LaneTape<V>& tape) {
    using T = typename V::value_type;
    using Group = LaneGroup<V>;
    constexpr int lanes = Strips<V>::lanes, count = Strips<V>::count;
    const LaneBlend<A, V> blend(accuracy);
    Group& group = tape.group;
    StripMask open = strips.inside(all_strips);
    strips.start(all_strips, tape.transmittance, lanes);
    tape.groups.clear();
    Index used = 0, k = scene.begin(tile);
    const Index end = k + scene.used(tile);
    const FetchRecords<T> fetch(scene, tile, end);
    while (k < end && !open.none()) {
        const Index next = std::min<Index>(end, k + Group::usual);
        group.template fill<0>(scene, strips, scene.top(tile), k, next, fetch);
        TapeGroup<V>& laid = tape.groups.emplace_back();
        T* const steps = tape.steps.grow((used + (next - k) * count) * 2 * lanes,
                                         used * 2 * lanes);
        for (int s = 0; s < count; ++s) {
            if (group.reaching[s] != 0 && open.has(s)) {
                V t = V::load_aligned(tape.transmittance + s * lanes);
                blend.along(group, s, t,
                            [&](int entry, const LaneEntry<V>&, const Contribution<V>& c)
                                __attribute__((always_inline)) {
                    T* const to = steps + used * 2 * lanes;
                    c.alpha.store_aligned(to);
                    c.before.store_aligned(to + lanes);
                    laid.strips[entry][s / 64] |= std::uint64_t(1) << (s % 64);
                    ++used;
                });
                t.store_aligned(tape.transmittance + s * lanes);
                if (!blend.any_open(t)) open.clear(s);
            }
            laid.end[s] = used;
        }
        k = next;
    }
    return k - scene.begin(tile);
}

/// Places of the bits that are set in a byte, a byte each, from the first in memory on.
inline constexpr auto bit_places = [] {
    std::array<std::uint64_t, 256> table{};
    for (std::size_t byte = 0; byte < 256; ++byte) {
        std::array<std::uint8_t, 8> places{};
        std::size_t n = 0;
        for (std::uint8_t bit = 0; bit < 8; ++bit)
            if ((byte >> bit & 1U) != 0) places[n++] = bit;
        table[byte] = rye::bit_cast<std::uint64_t>(places);
    }
    return table;
}();

/// Returns the strips of an entry's visits, in order; up to seven numbers behind them are written
/// too.
template <class V>
int list_strips(const std::uint64_t* words, std::uint8_t* strip) {
    constexpr std::uint64_t every_byte = 0x0101010101010101U;
    int n = 0;
    for (int b = 0; b < Strips<V>::count / 8; ++b) {
        const std::size_t byte = words[b / 8] >> (8 * (b % 8)) & 0xFFU;
        const std::uint64_t places =
            detail::bit_places[byte] + every_byte * static_cast<std::uint64_t>(8 * b);
        std::memcpy(strip + n, &places, 8);
        n += std::popcount(byte);
    }
    return n;
}

/// Loads the cotangents of a tile's pixels, strip by strip, and that of the background seen through
/// it.
template <class V, int C>
void load_cotangents(const Scene<typename V::value_type>& scene,
                     const RasterCotangent<typename V::value_type>& g, const Strips<V>& strips,
                     Index stride, LaneTape<V>& tape) {
    using T = typename V::value_type;
    const Index tile = strips.tile;
    using Tile = Strips<V>;
    constexpr int lanes = Tile::lanes;
    const Index channels = C > 0 ? C : scene.channels();
    T* const cotangent = tape.cotangent.reserve(stride * tile_pixels);
    if (stride != channels || strips.width < tile_edge || strips.height < tile_edge)
        std::fill_n(cotangent, stride * tile_pixels, T(0));
    std::fill_n(tape.g_alpha, tile_pixels, T(0));
    std::fill_n(tape.g_depth, tile_pixels, T(0));
    for (int y = 0; y < strips.height; ++y) {
        const Index from = scene.pixel(scene.left(tile), scene.top(tile) + y);
        const T* gp = g.feature.data() + from * channels;
        for (int x = 0; x < strips.width; ++x) {
            const int strip = Tile::strip(x, y), lane = Tile::lane(x, y);
            T* const to = cotangent + strip * lanes * stride + lane;
            for (Index c = 0; c < channels; ++c) to[c * lanes] = *gp++;
            if (g.alpha != nullptr)
                tape.g_alpha[strip * lanes + lane] = g.alpha->data()[from + x];
            if (g.depth != nullptr)
                tape.g_depth[strip * lanes + lane] = g.depth->data()[from + x];
        }
    }
    if constexpr (C > 0) {
        std::array<V, std::size_t(C)> background;
        unrolled<C>([&](auto c) { background[c] = V(scene.background[c]); });
        for (int at = 0; at < tile_pixels; at += lanes)
            along<V, C>(cotangent + at * stride, background).store_aligned(tape.behind + at);
    } else {
        T* const background = tape.background.reserve(stride);
        std::fill_n(background, stride, T(0));
        std::copy_n(scene.background.data(), channels, background);
        std::array<std::uint8_t, std::size_t(Tile::count)> all;
        for (int s = 0; s < Tile::count; ++s)
            all[static_cast<std::size_t>(s)] = static_cast<std::uint8_t>(s);
        along_strips<V>(cotangent, {all.data(), Tile::count}, background, stride, tape.along,
                        NoSums());
        std::copy_n(tape.along[0], tile_pixels, tape.behind);
    }
}

/// The reverse walk of one entry, into its slot. C few channels, or any number for C = 0; `Extra`
/// only if alpha or depth has a cotangent.
template <class V, int C, bool Extra, class A>
struct LaneReverse {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    static constexpr int lanes = Tile::lanes;

    const Strips<V>& strips;
    LaneTape<V>& tape;
    Index stride;
    LaneBlend<A, V> blend;
    const T* cotangent;
    const T* visits_end[Tile::count];    ///< [strips] end of the strip's visits on the tape

    /// Starts a group; to be called before its last entry.
    void start(const TapeGroup<V>& group) {
        for (int s = 0; s < Tile::count; ++s)
            visits_end[s] = tape.steps.data() + group.end[s] * (2 * lanes);
    }

    /// Walks an entry of `visits` visits, whose strips are on the tape.
    void operator()(const Splat<T>& s, int visits, const T* feature, T* slot) {
        const V zero(T(0));
        const std::uint8_t* const strip = tape.strip;
        std::array<V, 8> sum;                // as in SplatCotangent
        sum.fill(zero);
        std::array<V, std::size_t(std::max(C, 1))> colour, colour_sum;
        colour_sum.fill(zero);
        if constexpr (C > 0)
            unrolled<C>([&](auto c) { colour[c] = V(feature[c]); });
        else if (reads_once())
            walk_channels({strip, visits}, feature, slot + PartialGradients<T>::head);
        else
            along_strips<V>(cotangent, {strip, visits}, feature, stride, tape.along, NoSums());
        const struct {
            V floor, depth;
        } layer{V(s.floor), V(s.depth)};
        alignas(64) T us[Tile::columns], across[Tile::columns], down[tile_edge];
        unrolled<Tile::columns / lanes>([&](auto i) __attribute__((always_inline)) {
            const V dx = V::load_aligned(strips.x + i * lanes) - V(s.x);
            (V(s.ux) * dx).store_aligned(us + i * lanes);
            (V(s.vx) * dx).store_aligned(across + i * lanes);
        });
        unrolled<tile_edge / lanes>([&](auto i) __attribute__((always_inline)) {
            (V(s.vy) * (V::load_aligned(strips.y + i * lanes) - V(s.y)))
                .store_aligned(down + i * lanes);
        });
        // Copies of its own: stores of vectors could be to anything.
        T* const behinds = tape.behind;
        const T* const g_tile = cotangent;
        const LaneBlend<A, V> rules = blend;
        for (int i = 0; i < visits; ++i) {
            const std::size_t here = strip[i], at = here * lanes;
            const int side = Tile::side(strip[i]), row = Tile::row(strip[i]);
            const T* const step = visits_end[here] -= 2 * lanes;
            const V alpha = V::load_aligned(step), before = V::load_aligned(step + lanes);
            const Contribution<V> c{{alpha, alpha}, before, alpha * before};
            ColourCotangent<V> g_colour;
            if constexpr (C > 0) {
                const T* const g_strip = g_tile + at * C;
                unrolled<C>([&](auto k) __attribute__((always_inline)) {
                    colour_sum[k] = colour_sum[k] + V::load_aligned(g_strip + k * lanes) * c.weight;
                });
                g_colour.colour = along<V, C>(g_strip, colour);
            } else {
                c.weight.store_aligned(tape.weight[i]);
                g_colour.colour = V::load_aligned(tape.along[i]);
            }
            const V u = Tile::along_rows(us, side);
            const V v = Tile::along_rows(across, side) + Tile::down_rows(down, row);
            V behind = V::load_aligned(behinds + at);
            if constexpr (Extra) {
                const PixelCotangent<V> g{g_colour, V::load_aligned(tape.g_alpha + at),
                                          V::load_aligned(tape.g_depth + at)};
                rules.take_vjp(c, u, v, layer, g, behind, sum);
            } else {
                rules.take_vjp(c, u, v, layer, g_colour, behind, sum);
            }
            behind.store_aligned(behinds + at);
        }
        lane_sums(sum, slot);
        if constexpr (C > 0) {
            std::array<V, 8> padded;
            padded.fill(zero);
            unrolled<C>([&](auto c) { padded[c] = colour_sum[c]; });
            lane_sums(padded, slot + PartialGradients<T>::head);
        } else if (!reads_once()) {
            weigh_strips<V>(cotangent, {strip, visits}, stride, tape.weight,
                            slot + PartialGradients<T>::head);
        }
    }

  private:
    /// True if reading the cotangents of many channels once is worth the weights computed before:
    /// not for eight channels, nor where eight colours and eight sums do not fit in registers.
    bool reads_once() const { return LoadsFours<V> && stride > 8; }

    /// Computes <cotangent, colour> of all visits and the slot's features.
    void walk_channels(VisitedStrips visited, const T* feature, T* to) {
        for (Index v = 0; v < visited.count; ++v) {
            const T* const step = visits_end[visited.strip[v]] - 2 * lanes;
            (V::load_aligned(step) * V::load_aligned(step + lanes)).store_aligned(tape.weight[v]);
        }
        along_strips<V>(cotangent, visited, feature, stride, tape.along,
                        WeightedSums<V>{tape.weight, to, {}});
    }
};

/// Prefetches the slot of an entry, to be written. Always inlined, as fetch_record.
template <class T>
[[gnu::always_inline]] inline void fetch_slot(const Scene<T>& scene,
                                              const PartialGradients<T>& slots, Index entry) {
    constexpr Index line = 64 / static_cast<Index>(sizeof(T));
    for (Index c = 0; c < slots.stride; c += line) prefetch_to_write(slots[scene.slot(entry)] + c);
}

/// Adds the gradients of one tile's pixels to the slots of its entries.
template <class V, int C, bool Extra, class A>
void blend_tile_vjp_lanes(const Scene<typename V::value_type>& scene, const A& accuracy,
                          const TileCotangent<typename V::value_type>& cotangent,
                          RasterScratch<typename V::value_type>& scratch, LaneTape<V>& tape) {
    using T = typename V::value_type;
    const Index tile = cotangent.tile;
    constexpr Index most = LaneGroup<V>::usual;
    if (scene.used(tile) == 0) return;
    if constexpr (A::order == BlendOrder::by_peak) {
        std::vector<PixelContribution<T>> hits;
        return blend_tile_vjp(scene, accuracy, cotangent, scratch, hits);
    }
    const Strips<V> strips(scene, tile);
    const Index channels = scene.channels();
    const Index stride = C > 0 ? C : scratch.slots.features();
    const Index begin = scene.begin(tile);
    const Index entries = record_tile<V>(scene, accuracy, tile, strips, tape);
    const Index last = (entries - 1) / most * most;
    const auto fetch = [&](Index entry) __attribute__((always_inline)) {
        fetch_features(scene, entry);
        fetch_slot(scene, scratch.slots, entry);
    };
    for (Index k = entries; k-- > std::max<Index>(0, entries - most);) fetch(begin + k);
    load_cotangents<V, C>(scene, cotangent.images, strips, stride, tape);

    LaneReverse<V, C, Extra, A> reverse{
        strips, tape, stride, LaneBlend<A, V>(accuracy), tape.cotangent.data(), {}};
    const bool copied = C == 0 && stride != channels;    // if channels do not fill vectors
    T* const feature = tape.feature.reserve(copied ? most * stride : 1);
    for (Index group = last; group >= 0; group -= most) {
        const Index end = std::min(entries, group + most);
        const TapeGroup<V>& laid = tape.groups[static_cast<std::size_t>(group / most)];
        reverse.start(laid);
        if (copied) copy_features<V>(scene, begin + group, begin + end, stride, feature);
        for (Index k = end; k-- > group;) {
            if (k >= most) fetch(begin + k - most);
            const int visits = list_strips<V>(laid.strips[k - group], tape.strip);
            if (visits == 0) continue;
            const Index slot = scene.slot(begin + k);
            scratch.slots.touched[static_cast<std::size_t>(slot)] = 1;
            const T* const f =
                copied ? feature + (k - group) * stride : scene.feature_of(begin + k);
            reverse(scene.splat(begin + k), visits, f, scratch.slots[slot]);
        }
    }
}

} // namespace detail

} // namespace rye
