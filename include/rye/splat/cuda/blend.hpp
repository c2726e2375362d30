// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/blend.hpp: tiles drawn on a device: a block a tile, a warp a strip of 8 x 8
/// pixels. Lists are sorted here, as far as a pixel is open. Between parts of a list warps do not
/// wait for one another: each takes the visits of its own strip, 16 at a time. For the vjp it keeps
/// the visits of every group and the transmittance in front of them.
#pragma once

#include <rye/backend/cuda/halves.hpp>
#include <rye/splat/cuda/nearest.hpp>
#include <rye/splat/cuda/products.hpp>
#include <rye/splat/cuda/strip_output.hpp>

namespace rye::detail {

/// Visits that a warp has found and not walked yet, in a ring.
template <bool colours, bool entries>
struct FoundVisits {
    static constexpr std::uint32_t capacity = 64;
    Quad4 place[capacity]; ///< u0, ux, v0, vx
    Quad4 shape[capacity]; ///< vy, log2 o, depth, floor
    Quad4 colour[colours ? capacity : 1];
    std::uint32_t owner[capacity];
    std::uint32_t place_of[capacity]; ///< places of the pairs (Gaussian, tile), for a vjp
    std::uint32_t entry[entries ? capacity : 1]; ///< numbers in the tile's list
};

/// Draws the pixels of a tile, near to far, C channels at a time.
template <class A, int C>
struct BlendKernel {
    using Layout = ChannelLayout<C>;
    static constexpr const char* name = "blend";
    static constexpr bool admits_next = true, waits_on_device = true;
    static constexpr bool halves = Layout::products && A::payload == Payload::half;
    static constexpr int threads = 128, blocks = Layout::products ? 3 : 4;
    static constexpr int N = planes_of<A>;
    using Found = FoundVisits<!Layout::products, A::outputs.contributor>;
    /// Shared memory of a block.
    struct Shared {
        NearestKeys nearest;
        Found found[tile_strips];
        std::uint32_t open[tile_strips];
    };
    FrameMemory memory;
    DeviceScene scene;
    DeviceImages images;
    A accuracy;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        if (memory.report->overflow != 0) return;
        const std::uint32_t tile = memory.order[block.index()];
        const std::uint32_t begin = memory.begin[tile];
        auto state = block.template of_warps<StripSums<W, A, C>>();
        block.each_warp([&](int w) { start<W>(state[w], tile, w); });
        NearestFirst<Block> list(shared.nearest, memory.key + begin,
                                 memory.begin[tile + 1] - begin);
        bool open = true;
        while (open) {
            const std::uint32_t before = list.taken, part = list.next(block);
            if (part == 0) break;
            if constexpr (Layout::products || A::outputs.contributor)
                block.each_thread([&](int t) {
                    for (std::uint32_t k = static_cast<std::uint32_t>(t); k < part; k += threads) {
                        const auto pair = static_cast<std::uint32_t>(shared.nearest.key[k]);
                        const std::uint32_t owner = memory.groups > 0 ? memory.owner[pair] : pair;
                        if constexpr (Layout::products)
                            shared.nearest.key[k] = std::uint64_t(pair) << 32U | owner;
                        if constexpr (A::outputs.contributor)
                            memory.sorted[begin + before + k] = owner;
                    }
                });
            block.each_warp([&](int w) {
                StripSums<W, A, C>& s = state[w];
                const StripPixels<W> pixels(tile, memory.columns, w, scene.width, scene.height);
                walk<W>(shared, s, pixels, tile, w, before, part);
                if (list.taken == list.n) flush<W>(shared, s, pixels, w);
                W::write_where(W::lane() == typename W::U(0), shared.open,
                               typename W::U(static_cast<std::uint32_t>(w)),
                               typename W::U(s.open ? 1U : 0U));
            });
            open = (shared.open[0] | shared.open[1] | shared.open[2] | shared.open[3]) != 0;
        }
        block.each_warp([&](int w) {
            if (memory.groups > 0) keep_strip<W>(state[w], tile, w);
            StripOutput<A, C>{memory, scene, images}.template write<W>(state[w], tile, w, begin);
        });
    }

  private:
    template <class W>
    RYE_DEVICE void start(StripSums<W, A, C>& s, std::uint32_t tile, int w) const {
        using F = typename W::F;
        using U = typename W::U;
        const StripPixels<W> pixels(tile, memory.columns, w, scene.width, scene.height);
        expanded<8>([&](auto j) {
            s.transmittance[j] = select(pixels.inside(U(j)), F(1.0F), F(0.0F));
            if constexpr (!Layout::products) expanded<C>([&](auto c) { s.colour[j][c] = F(0.0F); });
            if constexpr (A::outputs.depth) s.depth[j] = F(0.0F);
            if constexpr (A::outputs.contributor) {
                s.most[j] = F(0.0F);
                s.contributor[j] = U(no_contributor);
            }
        });
        if constexpr (Layout::products)
            repeated<4>([&](auto m) {
                repeated<C / 8>(
                    [&](auto n) { repeated<4>([&](auto k) { s.sums[m][n][k] = F(0.0F); }); });
            });
        s.open = W::any(s.transmittance[0] > F(0.0F));
        s.found = s.done = 0;
        s.group = s.last = none_of;
        if (memory.groups > 0 && s.open) s.group = W::take_one(&memory.report->groups);
    }

    /// Walks a part of the list: finds the strip's visits, 32 entries at a time.
    template <class W>
    RYE_DEVICE void walk(Shared& shared, StripSums<W, A, C>& s, const StripPixels<W>& pixels,
                         std::uint32_t tile, int w, std::uint32_t before,
                         std::uint32_t part) const {
        using F = typename W::F;
        using U = typename W::U;
        const TileCentre centre(scene, tile, memory.columns);
        const float least = least_exponent(accuracy);
        Found& found = shared.found[w];
        const auto* const records = reinterpret_cast<const Quad4*>(memory.record);
        Array<F, 4> place, shape;
        U owner, pair;
        [[maybe_unused]] U next_owner, next_pair;
        // Keys have the pair's place, or its Gaussian if nothing is kept. Those of many channels
        // have both: registers are scarce there.
        const auto at_entry = [&](auto half, std::uint32_t at) {
            const U entry = U(at) + W::lane();
            return W::template read_half<half>(shared.nearest.key,
                                               select(entry < U(part), entry, U(0)));
        };
        const auto locate = [&]([[maybe_unused]] std::uint32_t at) {
            if constexpr (!Layout::products) {
                next_pair = at_entry(Constant<0>{}, at);
                next_owner = memory.groups > 0 ? W::read(memory.owner, next_pair) : next_pair;
            }
        };
        const auto fetch = [&](std::uint32_t at) {
            const auto valid = U(at) + W::lane() < U(part);
            if constexpr (Layout::products)
                owner = at_entry(Constant<0>{}, at);
            else
                owner = next_owner, pair = next_pair;
            place = W::read4_where(valid, records, owner * U(2));
            shape = W::read4_where(valid, records, owner * U(2) + U(1));
            locate(at + 32);
        };
        locate(0);
        fetch(0);
        for (std::uint32_t at = 0; at < part && s.open; at += 32) {
            const U entry = U(at) + W::lane(), own_owner = owner;
            [[maybe_unused]] const U own_pair = pair;
            const auto valid = entry < U(part);
            const TileSplat<W> splat(place, shape, centre.x, centre.y);
            fetch(at + 32); // the next 32, while these are walked
            const auto visited = valid && splat.reaches(w, accuracy, least);
            const std::uint32_t lanes = W::ballot(visited);
            if (lanes == 0) continue;
            const U to = (U(s.found) + W::below(lanes)) % U(Found::capacity);
            W::write4_where(visited, found.place, to,
                            Array<F, 4>{{splat.u0, splat.ux, splat.v0, splat.vx}});
            W::write4_where(visited, found.shape, to,
                            Array<F, 4>{{splat.vy, splat.log2_opacity, splat.depth, splat.floor}});
            if constexpr (!Layout::products) {
                const U stride(static_cast<std::uint32_t>(scene.feature.rows));
                Array<F, 4> colour;
                expanded<4>([&](auto c) {
                    colour[c] = F(0.0F);
                    if constexpr (c < C)
                        if (c < scene.channels)
                            colour[c] =
                                W::read_where(visited, scene.feature.data + scene.first_channel,
                                              own_owner * stride + U(c), 0.0F);
                });
                W::write4_where(visited, found.colour, to, colour);
            }
            W::write_where(visited, found.owner, to, own_owner);
            if constexpr (!Layout::products)
                W::write_where(visited, found.place_of, to, own_pair);
            else if (memory.groups > 0)
                W::write_where(visited, found.place_of, to, at_entry(Constant<1>{}, at));
            if constexpr (A::outputs.contributor)
                W::write_where(visited, found.entry, to, U(before) + entry);
            s.found += W::bits_set(lanes);
            W::sync();
            for (; s.found - s.done >= group_visits && s.open; s.done += group_visits)
                group<W>(found, s, pixels);
            W::sync();
        }
    }

    /// Blends the last visits, filled up to a whole group by visits that reach no pixel.
    template <class W>
    RYE_DEVICE void flush(Shared& shared, StripSums<W, A, C>& s, const StripPixels<W>& pixels,
                          int w) const {
        using F = typename W::F;
        using U = typename W::U;
        if (!s.open || s.found == s.done) return;
        Found& found = shared.found[w];
        const U at = U(s.done) + W::lane();
        const auto idle = W::lane() < U(group_visits) && !(at < U(s.found));
        const U to = at % U(Found::capacity);
        const Array<F, 4> zero{{F(0.0F), F(0.0F), F(0.0F), F(0.0F)}};
        W::write4_where(idle, found.place, to, zero);
        W::write4_where(idle, found.shape, to, Array<F, 4>{{F(0.0F), F(-1e30F), F(0.0F), F(0.0F)}});
        if constexpr (!Layout::products) W::write4_where(idle, found.colour, to, zero);
        W::write_where(idle, found.owner, to, U(none_of));
        W::sync();
        group<W>(found, s, pixels);
        s.done += group_visits;
    }

    /// Keeps a group's visits, and the transmittance in front of it, for the vjp.
    template <class W>
    RYE_DEVICE void keep(const Found& found, StripSums<W, A, C>& s, std::uint32_t at) const {
        using U = typename W::U;
        const std::uint32_t group = s.group;
        if (group < memory.groups) {
            const auto own = own_rows<W>(s.transmittance);
            W::write2(memory.transmittance + std::size_t(group) * 64, W::lane(), own[0], own[1]);
            const U half = W::lane() % U(group_visits);
            const auto first = W::lane() < U(group_visits);
            const U owner = W::read(found.owner, U(at) + half);
            const U place = W::read(found.place_of, U(at) + half);
            W::write(memory.visits + std::size_t(group) * 32, W::lane(),
                     select(first, owner, place));
            W::write_where(W::lane() == U(0), memory.before, U(group), U(s.last));
            s.last = group;
        }
        s.group = W::take_one(&memory.report->groups); // the next group, early to hide latency
    }

    /// Keeps a strip's last group, and lists it with those that have as many.
    template <class W>
    RYE_DEVICE void keep_strip(const StripSums<W, A, C>& s, std::uint32_t tile, int w) const {
        using U = typename W::U;
        const std::uint32_t strip = tile * tile_strips + static_cast<std::uint32_t>(w);
        const auto first = W::lane() == U(0);
        W::write_where(first, memory.last, U(strip), U(s.last));
        if (s.last == none_of) return;
        const std::uint32_t of = FrameMemory::class_of(s.done / group_visits);
        const std::uint32_t at = W::take_one(memory.walked + of);
        W::write_where(first, memory.walked_of, U(of * memory.tiles * tile_strips + at), U(strip));
    }

    template <class W>
    RYE_DEVICE void group(const Found& found, StripSums<W, A, C>& s,
                          const StripPixels<W>& pixels) const {
        using F = typename W::F;
        using U = typename W::U;
        const WarpBlend<W, A, true, !Layout::products> rules(accuracy);
        const std::uint32_t at = s.done % Found::capacity;
        if (memory.groups > 0) keep<W>(found, s, at);
        const U first = U(at) + W::lane() % U(4) * U(4);
        const Visits<W, A> v(
            [&](auto i) {
                const Array<F, 4> place = W::read4(found.place, first + U(i));
                const Array<F, 4> shape = W::read4(found.shape, first + U(i));
                TileSplat<W> r;
                r.u0 = place[0], r.ux = place[1], r.v0 = place[2], r.vx = place[3];
                r.vy = shape[0], r.log2_opacity = shape[1], r.depth = shape[2], r.floor = shape[3];
                return r;
            },
            pixels.x, pixels.y, accuracy);
        rows<W>(found, s, v, rules, first);
        auto open = rules.one_visit.open(s.transmittance[0]);
        repeated<7>([&](auto j) { open = open || rules.one_visit.open(s.transmittance[j + 1]); });
        s.open = W::any(open);
    }

    /// Blends a group's visits into all rows of the strip by the rules `by`.
    template <class W, class Rules>
    RYE_DEVICE void rows([[maybe_unused]] const Found& found, StripSums<W, A, C>& s,
                         const Visits<W, A>& v, const Rules& by, const typename W::U& first) const {
        using F = typename W::F;
        using U = typename W::U;
        const auto row = [&](auto j) {
            const Taken<W> t = by.take(v, j, s.transmittance[j]);
            s.transmittance[j] = by.behind(t, s.transmittance[j]);
            if constexpr (A::outputs.depth)
                repeated<4>([&](auto i) {
                    s.depth[j] = W::fma(t.visit[i].weight, v.depth[i], s.depth[j]);
                });
            if constexpr (A::outputs.contributor)
                repeated<4>([&](auto i) {
                    const auto more = t.visit[i].weight > s.most[j];
                    s.most[j] = select(more, t.visit[i].weight, s.most[j]);
                    s.contributor[j] =
                        select(more, W::read(found.entry, first + U(i)), s.contributor[j]);
                });
            return t;
        };
        if constexpr (halves) {
            U owner[4];
            repeated<4>([&](auto i) { owner[i] = W::read(found.owner, first + U(i)); });
            Array<U, 2> features[std::size_t(C / 8)];
            repeated<C / 8>([&](auto n) {
                F x[4];
                read_features<W>(x, scene, owner, n);
                features[n] = {{pack_halves<W>(x[0], x[1]), pack_halves<W>(x[2], x[3])}};
            });
            expanded<4>([&](auto m) {
                const Taken<W> a = row(Constant<2 * m>{});
                const Taken<W> b = row(Constant<2 * m + 1>{});
                const auto pair = [](const Taken<W>& t, int i) {
                    return pack_halves<W>(t.visit[i].weight, t.visit[i + 1].weight);
                };
                const Array<U, 4> weights{{pair(a, 0), pair(b, 0), pair(a, 2), pair(b, 2)}};
                repeated<C / 8>(
                    [&](auto n) { multiply_halves<W>(s.sums[m][n], weights, features[n]); });
            });
        } else if constexpr (Layout::products) {
            U owner[4];
            repeated<4>([&](auto i) { owner[i] = W::read(found.owner, first + U(i)); });
            Planes<W, N, 2> features[std::size_t(C / 8)];
            repeated<C / 8>(
                [&](auto n) { features[n] = features_over_visits<W, N>(scene, owner, n); });
            expanded<4>([&](auto m) {
                const Taken<W> a = row(Constant<2 * m>{});
                const Taken<W> b = row(Constant<2 * m + 1>{});
                Planes<W, N, 4> weights;
                split<W, N>(weights, 0, a.visit[0].weight, a.visit[1].weight);
                split<W, N>(weights, 1, b.visit[0].weight, b.visit[1].weight);
                split<W, N>(weights, 2, a.visit[2].weight, a.visit[3].weight);
                split<W, N>(weights, 3, b.visit[2].weight, b.visit[3].weight);
                repeated<C / 8>(
                    [&](auto n) { multiply<W, N>(s.sums[m][n], weights, features[n]); });
            });
        } else {
            Array<F, 4> colour[4];
            repeated<4>([&](auto i) { colour[i] = W::read4(found.colour, first + U(i)); });
            repeated<8>([&](auto j) {
                const Taken<W> t = row(j);
                repeated<C>([&](auto c) {
                    repeated<4>([&](auto i) {
                        s.colour[j][c] = W::fma(t.visit[i].weight, colour[i][c], s.colour[j][c]);
                    });
                });
            });
        }
    }
};

} // namespace rye::detail
