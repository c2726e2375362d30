// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/reverse.hpp: the way back over tiles on a device, from far to near, as the blend
/// walked them. Each group of visits begins with the transmittance that was kept; what is behind a
/// visit is followed as its difference from what is behind the group, which is exactly 0 as long as
/// colours are equal. Neither divides by 1 - alpha.
/// A pair of a tile and a Gaussian owns a slot for its partial gradient, numbers of SplatCotangent
/// and features; strips are added in order.
#pragma once

#include <rye/splat/cuda/products.hpp>

namespace rye {

/// What a warp keeps of its pixels on the way back.
template <class W, int C, bool extra>
struct StripCotangents {
    using F = typename W::F;
    F behind[8];                             ///< <cotangent, what is behind>
    F colour[8][ChannelLayout<C>::products ? 1 : C];
    F alpha[extra ? 8 : 1], depth[extra ? 8 : 1];
};

/// extra: cotangents of alpha or depth are given.
template <class A, int C, bool extra>
struct ReverseKernel {
    using Layout = ChannelLayout<C>;
    static constexpr const char* name = "reverse walk";
    static constexpr int N = planes_of<A>;
    static constexpr int threads = 128, blocks = Layout::products ? (N < 3 ? 2 : 1) : 3;
    /// Numbers of a visit that are summed over lanes, and of its row in shared memory.
    static constexpr int sums = Layout::products ? 8 : 7 + C;
    static constexpr int row = Layout::products ? Layout::stride : sums;
    static constexpr int of_pixel = Staged<A, C>::row;  ///< halves
    struct Shared {
        Staged<A, C> staged;
        alignas(16) float visit[strips][Layout::batch * row];
        alignas(16) std::uint16_t cotangent[Layout::products ? strips : 1][N]
                                           [Layout::products ? 64 : 1][of_pixel];
    };
    FrameMemory memory;
    DeviceScene scene;
    DeviceCotangent image;
    A accuracy;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        if (memory.report->overflow != 0) return;
        const std::uint32_t tile = memory.order[block.index()];
        std::uint32_t batch = memory.last[tile];
        if (batch == no_batch) return;
        const std::uint32_t begin = memory.begin[tile];
        const Stager<A, C> stager(memory, scene, accuracy, tile);
        auto state = block.template of_warps<StripCotangents<W, C, extra>>();
        block.each_thread([&](int t) {
            stager.template none<Block>(shared.staged, t);
            cotangents<Block>(shared, tile, t);
        });
        block.each_warp([&](int w) { start<W>(shared, state[w], tile, w); });
        while (batch != no_batch) {
            const auto& kept = reinterpret_cast<const Kept*>(memory.walked)[batch];
            stage(block, shared, stager, kept, begin);
            block.each_warp([&](int w) {
                walk<W>(shared, state[w], tile, w, batch, kept.groups >> (8 * w) & 0xFFU);
            });
            block.each_thread([&](int t) {
                write<Block>(shared, kept, begin, batch, t);
            });
            batch = kept.before;
        }
    }

  private:
    using Kept = WalkedBatch<Layout::words>;

    /// The planes of the image's cotangent, pixel by pixel.
    template <class Block>
    RYE_DEVICE void cotangents(Shared& shared, std::uint32_t tile, int t) const {
        if constexpr (Layout::products) {
            constexpr int pairs = Layout::padded / 2;
            for (int k = t; k < tile_pixels * pairs; k += threads) {
                const int pixel = k / pairs, pair = k % pairs;
                const int w = pixel / 64, x = w % 2 * strip_edge + pixel % 8,
                          y = w / 2 * strip_edge + pixel / 8 % 8;
                const int px = static_cast<int>(tile % memory.columns) * tile_edge + x;
                const int py = static_cast<int>(tile / memory.columns) * tile_edge + y;
                float two[2];
                for (int i = 0; i < 2; ++i) {
                    const int c = 2 * pair + i;
                    two[i] = c < scene.channels && px < scene.width && py < scene.height
                                 ? image.feature.data[(Index(py) * scene.width + px) *
                                                      image.feature.rows +
                                                  scene.first_channel + c]
                                 : 0.0F;
                }
                unrolled<N>([&](auto p) {
                    const std::uint32_t word = Block::pack(two[0], two[1]);
                    reinterpret_cast<std::uint32_t*>(shared.cotangent[w][p][pixel % 64])[pair] =
                        word;
                    two[0] -= Block::low(word);
                    two[1] -= Block::high(word);
                });
            }
        }
    }

    template <class W>
    RYE_DEVICE void start(const Shared& shared, StripCotangents<W, C, extra>& s,
                          std::uint32_t tile, int w) const {
        using F = typename W::F;
        using U = typename W::U;
        const StripPixels<W> pixels(tile, memory.columns, w, scene.width, scene.height);
        const auto of = [&](const DeviceColumns<const float>& from, auto j, int channel) {
            if (from.data == nullptr) return F(0.0F);
            return W::read_where(pixels.inside(U(j)), from.data,
                                 pixels.pixel(U(j)) * U(static_cast<std::uint32_t>(from.rows)) +
                                     U(static_cast<std::uint32_t>(channel)),
                                 0.0F);
        };
        if constexpr (Layout::products) {
            const FeaturesOverChannels<W, Staged<A, C>> background(shared.staged);
            unrolled<4>([&](auto m) {
                const auto product = along<W>(shared, w, m, background);
                s.behind[2 * m] = product[0][0];
                s.behind[2 * m + 1] = product[0][2];
            });
        } else {
            unrolled<8>([&](auto j) {
                Array<F, 4> background;
                unrolled<C>([&](auto c) {
                    s.colour[j][c] = c < scene.channels
                                         ? of(image.feature, j, int(scene.first_channel) + c)
                                         : F(0.0F);
                    background[c] = F(scene.background_of(c));
                });
                s.behind[j] = along<W>(s.colour[j], background);
            });
        }
        if constexpr (extra)
            unrolled<8>([&](auto j) {
                s.alpha[j] = scene.first_channel == 0 ? of(image.alpha, j, 0) : F(0.0F);
                s.depth[j] = scene.first_channel == 0 ? of(image.depth, j, 0) : F(0.0F);
            });
    }

    /// <cotangent, colour>: one function for Gaussians and background, so that equal colours give
    /// equal sums.
    template <class W, class F>
    RYE_DEVICE static F along(const F (&cotangent)[C], const Array<F, 4>& colour) {
        F s = cotangent[0] * colour[0];
        unrolled<C - 1>([&](auto c) { s = W::fma(cotangent[c + 1], colour[c + 1], s); });
        return s;
    }
    /// The same of two rows of pixels and 16 visits, by matrices.
    template <class W, class M>
    RYE_DEVICE Array<Array<typename W::F, 4>, 2> along(
        const Shared& shared, int w, M m,
        const FeaturesOverChannels<W, Staged<A, C>>& features) const {
        using F = typename W::F;
        Array<Array<F, 4>, 2> s;
        unrolled<2>([&](auto n) { unrolled<4>([&](auto k) { s[n][k] = F(0.0F); }); });
        unrolled<Layout::padded / 16>([&](auto c) {
            Planes<W, N, 4> pixels;
            unrolled<N>([&](auto p) {
                pixels[p] = W::template tiles<false>(&shared.cotangent[w][p][0][0],
                                                     tile_of<W>(m, c));
            });
            unrolled<2>([&](auto n) { multiply<W, N>(s[n], pixels, features.of[n][c]); });
        });
        return s;
    }
    /// Rows of pixels 2 m and 2 m + 1 and 16 channels: where this lane's row begins [bytes].
    template <class W>
    RYE_DEVICE static typename W::U tile_of(int m, int c) {
        using U = typename W::U;
        return (U(static_cast<std::uint32_t>(16 * m)) + W::lane() % U(16)) * U(2 * of_pixel) +
               W::lane() / U(16) * U(16) + U(static_cast<std::uint32_t>(32 * c));
    }

    template <class Block>
    RYE_DEVICE void stage(Block& block, Shared& shared, const Stager<A, C>& stager,
                          const Kept& kept, std::uint32_t begin) const {
        block.each_thread([&](int t) {
            stager.template entry<false>(shared.staged, t, kept.count, [&](std::uint32_t e) {
                return memory.sorted_owner[begin + kept.start + e];
            });
            Stager<A, C>::again(shared.staged, t,
                                [&](int s, int word) { return kept.visits[s][word]; });
        });
        if constexpr (Layout::products)
            block.each_thread([&](int t) {
                stager.template features<Block>(shared.staged, t, kept.count);
            });
        block.each_warp([&](int w) {
            Stager<A, C>::template list<typename Block::Warp>(shared.staged, w);
        });
    }

    template <class W>
    RYE_DEVICE void walk(Shared& shared, StripCotangents<W, C, extra>& s, std::uint32_t tile,
                         int w, std::uint32_t batch, std::uint32_t groups) const {
        using U = typename W::U;
        const StripPixels<W> pixels(tile, memory.columns, w, scene.width, scene.height);
        const Transmittance<W, A> rules(accuracy);
        for (std::uint32_t g = groups; g-- > 0;) {
            const auto* const kept = reinterpret_cast<const Quad4*>(
                memory.transmittance + (std::size_t(batch) * (strips * Layout::groups) +
                                        static_cast<std::size_t>(w) * Layout::groups + g) * 64);
            const U column = W::lane() / U(4) * U(2);
            const auto low = W::read4(kept, column), high = W::read4(kept, column + U(1));
            group<W>(shared, s, pixels, rules, w, g, low, high);
        }
    }

    /// Sums over the pixels of each of a lane's visits.
    template <class W>
    struct Moments {
        using F = typename W::F;
        F one[4], y[4], yy[4];               ///< of h, h y, h y^2; y in rows
        F alpha[A::has_floor ? 4 : 1], depth[extra ? 4 : 1];
        F colour[Layout::products ? 1 : 4][Layout::products ? 1 : C];

        RYE_DEVICE Moments() {
            unrolled<4>([&](auto i) {
                one[i] = y[i] = yy[i] = F(0.0F);
                if constexpr (A::has_floor) alpha[i] = F(0.0F);
                if constexpr (extra) depth[i] = F(0.0F);
                if constexpr (!Layout::products)
                    unrolled<C>([&](auto c) { colour[i][c] = F(0.0F); });
            });
        }
    };

    /// One row of pixels: from <cotangent, colour> of its visits to their sums.
    template <class W, class J>
    RYE_DEVICE Taken<W> one_row(StripCotangents<W, C, extra>& s, Moments<W>& sum,
                                const Visits<W, A, C>& v, const Transmittance<W, A>& rules, J j,
                                const typename W::F& before,
                                const Array<typename W::F, 4>& along_visit) const {
        using F = typename W::F;
        F alpha[4], more[4];
        unrolled<4>([&](auto i) { alpha[i] = v.alpha(i, j, rules.least, rules.alpha_max); });
        const Taken<W> t = rules.take(alpha, before);
        unrolled<4>([&](auto i) {
            more[i] = along_visit[i] - s.behind[j];
            if constexpr (extra)
                more[i] = more[i] + W::fma(s.depth[j], v.depth[i], s.alpha[j]);
        });
        // b, from its value behind the group: over the own visits from 0, then over the lanes.
        F own = t.alpha[3] * more[3];
        unrolled<3>([&](auto i) {
            own = W::fma(t.alpha[2 - i], more[2 - i] - own, own);
        });
        const F third = W::template quad_down<3>(own, 0.0F);
        const F second = W::fma(W::template quad_down<2>(t.product, 1.0F), third,
                                W::template quad_down<2>(own, 0.0F));
        F b = W::fma(W::template quad_down<1>(t.product, 1.0F), second,
                     W::template quad_down<1>(own, 0.0F));
        unrolled<4>([&](auto k) {
            constexpr int i = 3 - k;
            const F m = more[i] - b;
            b = W::fma(t.alpha[i], m, b);
            F h;
            if constexpr (A::has_floor) {
                const F slope = select(t.weight[i] > F(0.0F) && t.alpha[i] < rules.alpha_max,
                                       t.before[i] * m, F(0.0F));
                h = slope * t.alpha[i];
                sum.alpha[i] = sum.alpha[i] + h;
                h = W::fma(slope, v.floor[i], h);
            } else {
                h = select(t.alpha[i] < rules.alpha_max, t.weight[i] * m, F(0.0F));
            }
            constexpr float y = static_cast<float>(J()) - 3.5F;
            sum.one[i] = sum.one[i] + h;
            sum.y[i] = W::fma(h, F(y), sum.y[i]);
            sum.yy[i] = W::fma(h, F(y * y), sum.yy[i]);
            if constexpr (extra) sum.depth[i] = W::fma(t.weight[i], s.depth[j], sum.depth[i]);
            if constexpr (!Layout::products)
                unrolled<C>([&](auto c) {
                    sum.colour[i][c] = W::fma(t.weight[i], s.colour[j][c], sum.colour[i][c]);
                });
        });
        s.behind[j] = s.behind[j] + W::template of_quad<0>(b);
        return t;
    }

    template <class W>
    RYE_DEVICE void group(Shared& shared, StripCotangents<W, C, extra>& s,
                          const StripPixels<W>& pixels, const Transmittance<W, A>& rules, int w,
                          std::uint32_t g, const Array<typename W::F, 4>& low,
                          const Array<typename W::F, 4>& high) const {
        using F = typename W::F;
        using U = typename W::U;
        const Visits<W, A, C> v(shared.staged, w, g, pixels.x, pixels.y, accuracy);
        Moments<W> sum;
        const auto before = [&](auto j) {
            if constexpr (j < 4)
                return low[j];
            else
                return high[j - 4];
        };
        if constexpr (Layout::products) {
            const FeaturesOverChannels<W, Staged<A, C>> features(shared.staged, w, g);
            Array<F, 4> colour[C / 8];
            unrolled<C / 8>([&](auto n) { unrolled<4>([&](auto k) { colour[n][k] = F(0.0F); }); });
            unrolled<4>([&](auto m) {
                const auto product = along<W>(shared, w, m, features);
                const auto one = [&](auto odd) {
                    const Constant<2 * m + odd> j;
                    const Array<F, 4> of_row{{product[0][2 * odd], product[0][2 * odd + 1],
                                              product[1][2 * odd], product[1][2 * odd + 1]}};
                    return one_row<W>(s, sum, v, rules, j, before(j), of_row);
                };
                const Taken<W> a = one(Constant<0>{});
                const Taken<W> b = one(Constant<1>{});
                Planes<W, N, 4> weights;     // transposed: a row a position
                split<W, N>(weights, 0, a.weight[0], a.weight[1]);
                split<W, N>(weights, 1, a.weight[2], a.weight[3]);
                split<W, N>(weights, 2, b.weight[0], b.weight[1]);
                split<W, N>(weights, 3, b.weight[2], b.weight[3]);
                unrolled<N>([&](auto p) {
                    unrolled<4>([&](auto k) { weights[p][k] = W::transpose(weights[p][k]); });
                });
                unrolled<(C + 15) / 16>([&](auto c) {
                    Planes<W, N, 2> left, right;
                    unrolled<N>([&](auto p) {
                        const auto t = W::template tiles<true>(&shared.cotangent[w][p][0][0],
                                                               tile_of<W>(m, c));
                        left[p] = {{t[0], t[1]}};
                        right[p] = {{t[2], t[3]}};
                    });
                    multiply<W, N>(colour[2 * c], weights, left);
                    if constexpr (2 * c + 1 < C / 8)
                        multiply<W, N>(colour[2 * c + 1], weights, right);
                });
            });
            const U visit = U(16 * g) + visit_at<W>(W::lane() / U(4));
            const U at = visit * U(row) + U(Layout::head) + W::lane() % U(4) * U(2);
            unrolled<C / 8>([&](auto n) {
                W::write2(shared.visit[w], (at + U(8 * n)) / U(2), colour[n][0], colour[n][1]);
                W::write2(shared.visit[w], (at + U(8 * n + 2 * row)) / U(2), colour[n][2],
                          colour[n][3]);
            });
        } else {
            Array<F, 4> colour[4];
            unrolled<4>([&](auto i) { colour[i] = W::read4(shared.staged.colour, v.entry[i]); });
            unrolled<8>([&](auto j) {
                Array<F, 4> of_row;
                unrolled<4>([&](auto i) { of_row[i] = along<W>(s.colour[j], colour[i]); });
                one_row<W>(s, sum, v, rules, j, before(j), of_row);
            });
        }
        add_lanes<W>(shared, v, sum, w, g);
    }

    /// From rows to offsets (u, v), and over the eight columns: by halves, each lane going on with
    /// one of them.
    template <class W>
    RYE_DEVICE void add_lanes(Shared& shared, const Visits<W, A, C>& v, const Moments<W>& sum,
                              int w, std::uint32_t g) const {
        using F = typename W::F;
        using U = typename W::U;
        constexpr int count = (4 * sums + 7) / 8 * 8;
        F x[count];
        unrolled<count>([&](auto k) {
            if constexpr (k >= 4 * sums) x[k] = F(0.0F);
        });
        unrolled<4>([&](auto i) {
            F* const to = x + i * sums;
            const F gv = W::fma(v.v[i], sum.one[i], v.vy[i] * sum.y[i]);
            const F gu = v.u[i] * sum.one[i];
            to[0] = gu;
            to[1] = gv;
            to[2] = gu * v.u[i];
            to[3] = gv * v.u[i];
            to[4] = W::fma(v.v[i], gv,
                           v.vy[i] * W::fma(v.v[i], sum.y[i], v.vy[i] * sum.yy[i]));
            if constexpr (A::has_floor)
                to[5] = sum.alpha[i];
            else
                to[5] = sum.one[i];
            if constexpr (extra)
                to[6] = sum.depth[i];
            else
                to[6] = F(0.0F);
            if constexpr (Layout::products)
                to[7] = F(0.0F);
            else
                unrolled<C>([&](auto c) { to[7 + c] = sum.colour[i][c]; });
        });
        halve<W, 16, count>(x);
        halve<W, 8, count / 2>(x);
        halve<W, 4, count / 4>(x);
        unrolled<count / 8>([&](auto k) {
            const U flat = W::lane() / U(4) * U(count / 8) + U(k);
            const U first = (U(16 * g) + W::lane() % U(4) * U(4)) * U(row);
            const U at = row == sums ? flat : flat / U(sums) * U(row) + flat % U(sums);
            W::write_where(flat < U(4 * sums), shared.visit[w], first + at, x[k]);
        });
    }
    template <class W, int apart, int n, class F>
    RYE_DEVICE static void halve(F* x) {
        using U = typename W::U;
        const auto upper = (W::lane() & U(apart)) > U(0);
        unrolled<n / 2>([&](auto k) {
            const F keep = select(upper, x[k + n / 2], x[k]);
            const F give = select(upper, x[k], x[k + n / 2]);
            x[k] = keep + W::template across<apart>(give);
        });
    }

    /// The slots of a batch: rows of the strips that visited an entry, in their order.
    template <class Block>
    RYE_DEVICE void write(const Shared& shared, const Kept& kept, std::uint32_t begin,
                          std::uint32_t batch, int t) const {
        constexpr int quads = Layout::stride / 4;
        for (int k = t; k < static_cast<int>(kept.count) * quads; k += threads) {
            const int e = k / quads, quad = k % quads;
            Quad4 total{0, 0, 0, 0};
            bool any = false;
            for (int s = 0; s < strips; ++s) {
                const std::uint32_t own = shared.staged.word[s][e / 32];
                if ((own >> (e % 32) & 1U) == 0) continue;
                int rank = Block::bits_set(own & ((1U << (e % 32)) - 1U));
                for (int i = 0; i < e / 32; ++i) rank += Block::bits_set(shared.staged.word[s][i]);
                if (rank >= static_cast<int>(kept.groups >> (8 * s) & 0xFFU) * group_visits)
                    continue;
                any = true;
                const float* const from = shared.visit[s] + rank * row;
                const auto at = [&](int i) {
                    const int n = 4 * quad + i;
                    if constexpr (Layout::products) return from[n];
                    const int c = n - Layout::head;
                    if (n < 7) return from[n];
                    return c >= 0 && c < C ? from[7 + c] : 0.0F;
                };
                total.x += at(0);
                total.y += at(1);
                total.z += at(2);
                total.w += at(3);
            }
            if (!any) continue;
            const std::uint32_t slot = batch * static_cast<std::uint32_t>(Layout::batch) +
                                       static_cast<std::uint32_t>(e);
            reinterpret_cast<Quad4*>(memory.partial)[std::size_t(slot) * quads +
                                                     static_cast<std::size_t>(quad)] = total;
            if (quad == 0)
                memory.slot[memory.sorted_place[begin + kept.start +
                                                static_cast<std::uint32_t>(e)]] = slot;
        }
    }
};

} // namespace rye
