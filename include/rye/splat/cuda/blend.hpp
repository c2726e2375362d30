// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/blend.hpp: tiles drawn on a device: a block a tile, a warp a strip of 8 x 8
/// pixels. Lists are sorted here, as far as a pixel is open. For the vjp it keeps which entries were
/// walked, and every 16 visits the transmittance of a strip's pixels.
#pragma once

#include <rye/splat/cuda/nearest.hpp>
#include <rye/splat/cuda/products.hpp>

namespace rye {

/// What a warp keeps of its pixels while it draws them.
template <class W, class A, int C>
struct StripSums {
    using F = typename W::F;
    using U = typename W::U;
    static constexpr bool products = ChannelLayout<C>::products;
    F transmittance[8];
    F colour[8][products ? 1 : C];           ///< of the lane's visits
    Array<F, 4> sums[products ? 4 : 1][products ? C / 8 : 1];
    F depth[A::outputs.depth ? 8 : 1];
    F most[A::outputs.contributor ? 8 : 1];
    U contributor[A::outputs.contributor ? 8 : 1]; ///< its number in the tile's list
    bool open;
};

template <class A, int C>
struct BlendKernel {
    using Layout = ChannelLayout<C>;
    static constexpr const char* name = "blend";
    static constexpr int threads = 128, blocks = Layout::products ? 3 : 5;
    struct Shared {
        NearestKeys nearest;
        Staged<A, C> staged;
        std::uint32_t batch, last;
        std::uint32_t open[strips], groups[strips];
    };
    FrameMemory memory;
    DeviceScene scene;
    DeviceImages images;
    A accuracy;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        using U = typename W::U;
        if (memory.report->overflow != 0) return;
        const std::uint32_t tile = memory.order[block.index()];
        const std::uint32_t begin = memory.begin[tile];
        const Stager<A, C> stager(memory, scene, accuracy, tile);
        auto state = block.template of_warps<StripSums<W, A, C>>();
        block.each_warp([&](int w) {
            if (w == 0) W::write_where(W::lane() == U(0), &shared.last, U(0), U(no_batch));
            start<W>(state[w], tile, w);
        });
        NearestFirst<Block> list(shared.nearest, memory.key + begin,
                                 memory.begin[tile + 1] - begin);
        bool open = true;
        while (open) {
            const std::uint32_t before = list.taken, part = list.next(block);
            if (part == 0) break;
            resolve(block, shared, begin + before, part);
            for (std::uint32_t at = 0; at < part && open; at += Layout::batch) {
                const std::uint32_t count = rye::min(part - at, std::uint32_t(Layout::batch));
                stage(block, shared, stager, at, count);
                block.each_warp([&](int w) {
                    walk<W>(shared, state[w], tile, w, before + at);
                });
                keep(block, shared, before + at, count);
                open = (shared.open[0] | shared.open[1] | shared.open[2] | shared.open[3]) != 0;
            }
        }
        block.each_warp([&](int w) {
            if (w == 0)
                W::write_where(W::lane() == U(0), memory.last, U(tile), U(shared.last));
            finish<W>(state[w], tile, w, begin);
        });
    }

  private:
    using Kept = WalkedBatch<Layout::words>;

    template <class W>
    RYE_DEVICE void start(StripSums<W, A, C>& s, std::uint32_t tile, int w) const {
        using F = typename W::F;
        using U = typename W::U;
        const StripPixels<W> pixels(tile, memory.columns, w, scene.width, scene.height);
        unrolled<8>([&](auto j) {
            s.transmittance[j] = select(pixels.inside(U(j)), F(1.0F), F(0.0F));
            if constexpr (!Layout::products)
                unrolled<C>([&](auto c) { s.colour[j][c] = F(0.0F); });
            if constexpr (A::outputs.depth) s.depth[j] = F(0.0F);
            if constexpr (A::outputs.contributor) {
                s.most[j] = F(0.0F);
                s.contributor[j] = U(no_contributor);
            }
        });
        if constexpr (Layout::products)
            unrolled<4>([&](auto m) {
                unrolled<C / 8>([&](auto n) {
                    unrolled<4>([&](auto k) { s.sums[m][n][k] = F(0.0F); });
                });
            });
        s.open = W::any(s.transmittance[0] > F(0.0F));
    }

    /// From sorted keys to Gaussians: keys become (Gaussian, place).
    template <class Block>
    RYE_DEVICE void resolve(Block& block, Shared& shared, std::uint32_t at,
                            std::uint32_t part) const {
        block.each_thread([&](int t) {
            for (std::uint32_t k = static_cast<std::uint32_t>(t); k < part; k += threads) {
                const auto place = static_cast<std::uint32_t>(shared.nearest.key[k]);
                const std::uint32_t owner = memory.owner[place];
                shared.nearest.key[k] = owner;
                memory.sorted_place[at + k] = place;
                memory.sorted_owner[at + k] = owner;
            }
        });
    }

    template <class Block>
    RYE_DEVICE void stage(Block& block, Shared& shared, const Stager<A, C>& stager,
                          std::uint32_t at, std::uint32_t count) const {
        block.each_thread([&](int t) {
            std::uint32_t batch = no_batch;
            if (t == 0 && memory.batches > 0) batch = block.add(&memory.report->batches, 1U);
            stager.template none<Block>(shared.staged, t);
            stager.template entry<true>(shared.staged, t, count, [&](std::uint32_t e) {
                return static_cast<std::uint32_t>(shared.nearest.key[at + e]);
            });
            if (t == 0) shared.batch = batch < memory.batches ? batch : no_batch;
        });
        if constexpr (Layout::products)
            block.each_thread([&](int t) {
                stager.template features<Block>(shared.staged, t, count);
            });
        block.each_warp([&](int w) {
            Stager<A, C>::template list<typename Block::Warp>(shared.staged, w);
        });
    }

    /// The visits of a strip to its entries.
    template <class W>
    RYE_DEVICE void walk(Shared& shared, StripSums<W, A, C>& s, std::uint32_t tile, int w,
                         std::uint32_t first) const {
        using U = typename W::U;
        const StripPixels<W> pixels(tile, memory.columns, w, scene.width, scene.height);
        const Transmittance<W, A> rules(accuracy);
        const std::uint32_t groups =
            (shared.staged.visits[w] + group_visits - 1) / group_visits;
        std::uint32_t g = 0;
        for (; g < groups && s.open; ++g) {
            if (shared.batch != no_batch) {
                const auto own = own_rows<W>(s.transmittance);
                W::write2(memory.transmittance +
                              (std::size_t(shared.batch) * (strips * Layout::groups) +
                               static_cast<std::size_t>(w) * Layout::groups + g) * 64,
                          W::lane(), own[0], own[1]);
            }
            group<W>(shared, s, pixels, rules, w, g, first);
            auto open = rules.open(s.transmittance[0]);
            unrolled<7>([&](auto j) { open = open || rules.open(s.transmittance[j + 1]); });
            s.open = W::any(open);
        }
        const auto one = W::lane() == U(0);
        W::write_where(one, shared.groups, U(static_cast<std::uint32_t>(w)), U(g));
        W::write_where(one, shared.open, U(static_cast<std::uint32_t>(w)), U(s.open ? 1U : 0U));
    }

    template <class W>
    RYE_DEVICE void group(const Shared& shared, StripSums<W, A, C>& s,
                          const StripPixels<W>& pixels, const Transmittance<W, A>& rules, int w,
                          std::uint32_t g, [[maybe_unused]] std::uint32_t first) const {
        using F = typename W::F;
        const Visits<W, A, C> v(shared.staged, w, g, pixels.x, pixels.y, accuracy);
        const auto row = [&](auto j) {
            F alpha[4];
            unrolled<4>([&](auto i) { alpha[i] = v.alpha(i, j, rules.least, rules.alpha_max); });
            const Taken<W> t = rules.take(alpha, s.transmittance[j]);
            s.transmittance[j] = rules.behind(t, s.transmittance[j]);
            if constexpr (A::outputs.depth)
                unrolled<4>([&](auto i) {
                    s.depth[j] = W::fma(t.weight[i], v.depth[i], s.depth[j]);
                });
            if constexpr (A::outputs.contributor)
                unrolled<4>([&](auto i) {
                    const auto more = t.weight[i] > s.most[j];
                    s.most[j] = select(more, t.weight[i], s.most[j]);
                    s.contributor[j] =
                        select(more, v.entry[i] + typename W::U(first), s.contributor[j]);
                });
            return t;
        };
        if constexpr (Layout::products) {
            const FeaturesOverVisits<W, Staged<A, C>, C> features(shared.staged, w, g);
            unrolled<4>([&](auto m) {
                const Taken<W> a = row(Constant<2 * m>{});
                const Taken<W> b = row(Constant<2 * m + 1>{});
                Planes<W, Staged<A, C>::N, 4> weights;
                split<W, Staged<A, C>::N>(weights, 0, a.weight[0], a.weight[1]);
                split<W, Staged<A, C>::N>(weights, 1, b.weight[0], b.weight[1]);
                split<W, Staged<A, C>::N>(weights, 2, a.weight[2], a.weight[3]);
                split<W, Staged<A, C>::N>(weights, 3, b.weight[2], b.weight[3]);
                unrolled<C / 8>([&](auto n) {
                    multiply<W, Staged<A, C>::N>(s.sums[m][n], weights, features.of[n]);
                });
            });
        } else {
            Array<F, 4> colour[4];
            unrolled<4>([&](auto i) { colour[i] = W::read4(shared.staged.colour, v.entry[i]); });
            unrolled<8>([&](auto j) {
                const Taken<W> t = row(j);
                unrolled<C>([&](auto c) {
                    unrolled<4>([&](auto i) {
                        s.colour[j][c] = W::fma(t.weight[i], colour[i][c], s.colour[j][c]);
                    });
                });
            });
        }
    }

    /// Keeps for the vjp how a batch was walked.
    template <class Block>
    RYE_DEVICE void keep(Block& block, Shared& shared, std::uint32_t start,
                         std::uint32_t count) const {
        if (memory.batches == 0) return;
        block.each_thread([&](int t) {
            if (shared.batch == no_batch) return;
            auto& to = reinterpret_cast<Kept*>(memory.walked)[shared.batch];
            if (t == 0) {
                to.before = shared.last;
                to.start = start;
                to.count = count;
                to.groups = shared.groups[0] | shared.groups[1] << 8U | shared.groups[2] << 16U |
                            shared.groups[3] << 24U;
                shared.last = shared.batch;
            }
            if (t < strips * Layout::words)
                to.visits[t / Layout::words][t % Layout::words] =
                    shared.staged.word[t / Layout::words][t % Layout::words];
        });
    }

    template <class W>
    RYE_DEVICE void finish(StripSums<W, A, C>& s, std::uint32_t tile, int w,
                           [[maybe_unused]] std::uint32_t begin) const {
        using F = typename W::F;
        using U = typename W::U;
        const StripPixels<W> pixels(tile, memory.columns, w, scene.width, scene.height);
        unrolled<8>([&](auto j) {
            s.transmittance[j] = W::max(s.transmittance[j], -s.transmittance[j]);
        });
        const U q = W::lane() % U(4);
        const U row[2] = {q * U(2), q * U(2) + U(1)};
        const auto quad = [](const F& x) {
            const F pair = x + W::template across<1>(x);
            return pair + W::template across<2>(pair);
        };
        const auto put = [&](const F(&x)[8], float* to, std::uint32_t stride, std::uint32_t at) {
            const auto own = own_rows<W>(x);
            unrolled<2>([&](auto k) {
                W::write_where(pixels.inside(row[k]), to,
                               pixels.pixel(row[k]) * U(stride) + U(at), own[k]);
            });
        };
        const auto stride = static_cast<std::uint32_t>(images.feature.rows);
        const auto from = static_cast<std::uint32_t>(scene.first_channel);
        if constexpr (Layout::products) {
            const bool pairs = scene.channels == C && stride % 2 == 0 && from % 2 == 0 &&
                               reinterpret_cast<std::uintptr_t>(images.feature.data) % 8 == 0;
            unrolled<4>([&](auto m) {
                unrolled<C / 8>([&](auto n) {
                    const U c = q * U(2) + U(8 * n);
                    const auto of = [&](const U& channel) {
                        return W::read_where(channel < U(static_cast<std::uint32_t>(scene.channels)),
                                             scene.background + from, channel, 0.0F);
                    };
                    const F left = of(c), right = of(c + U(1));
                    unrolled<2>([&](auto k) {
                        const F end = s.transmittance[2 * m + k];
                        const F a = W::fma(end, left, s.sums[m][n][2 * k]);
                        const F b = W::fma(end, right, s.sums[m][n][2 * k + 1]);
                        const auto in = pixels.inside(U(2 * m + k));
                        const U to = pixels.pixel(U(2 * m + k)) * U(stride) + U(from) + c;
                        const U channels(static_cast<std::uint32_t>(scene.channels));
                        if (pairs) {
                            W::write2_where(in, images.feature.data, to / U(2), a, b);
                        } else {
                            W::write_where(in && c < channels, images.feature.data, to, a);
                            W::write_where(in && c + U(1) < channels, images.feature.data,
                                           to + U(1), b);
                        }
                    });
                });
            });
        } else {
            unrolled<C>([&](auto c) {
                F x[8];
                unrolled<8>([&](auto j) {
                    x[j] = W::fma(s.transmittance[j], F(scene.background_of(c)),
                                  quad(s.colour[j][c]));
                });
                if (c < scene.channels) put(x, images.feature.data, stride, from + c);
            });
        }
        if (scene.first_channel != 0) return;
        F x[8];
        unrolled<8>([&](auto j) { x[j] = F(1.0F) - s.transmittance[j]; });
        put(x, images.alpha.data, 1, 0);
        if constexpr (A::outputs.depth) {
            unrolled<8>([&](auto j) { x[j] = quad(s.depth[j]); });
            if (images.depth.data != nullptr) put(x, images.depth.data, 1, 0);
        }
        if constexpr (A::outputs.contributor) contributors<W>(s, pixels, begin);
    }

    /// Of the four lanes of a pixel the largest weight; of equal ones the nearest.
    template <class W>
    RYE_DEVICE void contributors(StripSums<W, A, C>& s, const StripPixels<W>& pixels,
                                 std::uint32_t begin) const {
        using F = typename W::F;
        using U = typename W::U;
        const auto better = [](F& most, U& who, const F& other, const U& other_who) {
            const auto take = other > most || (other == most && other_who < who);
            most = select(take, other, most);
            who = select(take, other_who, who);
        };
        unrolled<8>([&](auto j) {
            better(s.most[j], s.contributor[j], W::template across<1>(s.most[j]),
                   W::template across<1>(s.contributor[j]));
            better(s.most[j], s.contributor[j], W::template across<2>(s.most[j]),
                   W::template across<2>(s.contributor[j]));
        });
        const auto own = own_rows<W>(s.contributor);
        if (images.contributor.data == nullptr) return;
        unrolled<2>([&](auto k) {
            const U row = W::lane() % U(4) * U(2) + U(k);
            const auto has = own[k] < U(no_contributor);
            const U at = select(has, own[k] + U(begin), U(0));
            const U who = select(has, W::read(memory.sorted_owner, at), U(no_contributor));
            W::write_where(pixels.inside(row), images.contributor.data, pixels.pixel(row), who);
        });
    }
};

} // namespace rye
