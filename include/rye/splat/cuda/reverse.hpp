// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/reverse.hpp: the way back over strips on a device, from far to near, a warp a
/// strip, by the groups of visits that the blend kept. The colour behind a visit is tracked as its
/// difference from the colour behind the group, which is exactly 0 as long as colours are equal;
/// transmittance is the kept one, and nothing is divided by 1 - alpha.
/// A visit owns a slot for its partial gradient, numbers of SplatCotangent and features.
#pragma once

#include <rye/splat/cuda/products.hpp>
#include <rye/splat/cuda/reverse_step.hpp>

namespace rye::detail {

/// extra: cotangents of alpha or depth are given.
template <class A, int C, bool extra>
struct ReverseKernel {
    using Layout = ChannelLayout<C>;
    using Step = ReverseStep<A, C, extra>;
    static constexpr const char* name = "reverse walk";
    static constexpr int N = planes_of<A>;
    static constexpr int threads = 32, blocks = Layout::products && N > 2 ? 8 : 12;
    static constexpr int of_pixel = Layout::padded + 8; ///< halves; rows begin in other banks
    static constexpr int of_visit = Layout::products ? Layout::padded + 8 : 4; ///< features
    /// A group of visits, copied from device memory while another is walked.
    struct Ahead {
        Quad4 record[2 * group_visits];
        Quad4 transmittance[16];
        alignas(16) float feature[std::size_t(group_visits * of_visit)];
    };
    /// Shared memory of a block.
    struct Shared {
        Ahead ahead[2];
        alignas(16) std::uint16_t
            cotangent[std::size_t(N)][Layout::products ? 64 : 1][std::size_t(of_pixel)];
    };
    FrameMemory memory;
    DeviceScene scene;
    DeviceCotangent image;
    A accuracy;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        if (memory.report->overflow != 0) return;
        const std::uint32_t strip = strip_of(static_cast<std::uint32_t>(block.index()));
        if (strip == none_of) return;
        const std::uint32_t tile = strip / tile_strips;
        const int w = static_cast<int>(strip % tile_strips);
        const std::uint32_t last = memory.last[strip];
        block.each_warp([&](int) {
            const StripPixels<W> pixels(tile, memory.columns, w, scene.width, scene.height);
            const TileCentre centre(scene, tile, memory.columns);
            StripCotangents<W, C, extra> s;
            start<W>(shared, s, pixels);
            W::sync(); // the warp has read a row that is overwritten now
            // A group's number is known two groups before it is walked, its Gaussians one.
            Next<W> now = next<W>(last), soon = next<W>(memory.before[last]);
            std::uint32_t late = soon.group != none_of ? memory.before[soon.group] : none_of;
            copy<W>(shared.ahead[0], now);
            W::end_copies();
            for (int side = 0;; side ^= 1) {
                if (soon.group != none_of) copy<W>(shared.ahead[side ^ 1], soon);
                W::end_copies();
                const Next<W> then = next<W>(late);
                if (late != none_of) late = memory.before[late];
                W::wait_for_copies();
                group<W>(shared, shared.ahead[side], s, pixels, centre, now, w);
                W::sync();
                if (soon.group == none_of) break;
                now = soon;
                soon = then;
            }
        });
    }

  private:
    /// Returns the strip that is walked by block k: those of most groups first, so that no long
    /// walk begins last; none_of if there are fewer.
    RYE_DEVICE std::uint32_t strip_of(std::uint32_t k) const {
        constexpr int n = int(FrameMemory::classes);
        std::uint32_t strips[n], of = none_of;
        repeated<n>([&](auto c) { strips[c] = memory.walked[c]; });
        repeated<n>([&](auto c) {
            constexpr int last = n - 1;
            if (of != none_of) return;
            if (k < strips[last - c])
                of = static_cast<std::uint32_t>(last - c);
            else
                k -= strips[last - c];
        });
        return of == none_of ? none_of : memory.walked_of[of * memory.tiles * tile_strips + k];
    }

    /// A group, and the Gaussian and the place of visit lane % 16.
    template <class W>
    struct Next {
        std::uint32_t group;
        typename W::U owner, place;
    };
    template <class W>
    RYE_DEVICE Next<W> next(std::uint32_t group) const {
        using U = typename W::U;
        if (group == none_of) return {group, U(none_of), U(0)};
        const std::uint32_t* const visits = memory.visits + std::size_t(group) * 32;
        const U visit = W::lane() % U(group_visits);
        return {group, W::read(visits, visit), W::read(visits, visit + U(group_visits))};
    }

    template <class W>
    RYE_DEVICE void copy(Ahead& to, const Next<W>& n) const {
        using F = typename W::F;
        using U = typename W::U;
        const U visit = W::lane() % U(group_visits), half = W::lane() / U(group_visits);
        const auto has = n.owner < U(none_of);
        W::copy4_ahead(has, to.record, visit * U(2) + half,
                       reinterpret_cast<const Quad4*>(memory.record), n.owner * U(2) + half);
        W::write4_where(
            !has, to.record, visit * U(2) + half,
            Array<F, 4>{{F(0.0F), select(half > U(0), F(-1e30F), F(0.0F)), F(0.0F), F(0.0F)}});
        W::copy4_ahead(
            half == U(0), to.transmittance, visit,
            reinterpret_cast<const Quad4*>(memory.transmittance) + std::size_t(n.group) * 16,
            visit);
        const float* const from = scene.feature.data + scene.first_channel;
        const U stride(static_cast<std::uint32_t>(scene.feature.rows));
        const bool quads = Layout::products && scene.channels % 4 == 0 &&
                           scene.feature.rows % 4 == 0 &&
                           reinterpret_cast<std::uintptr_t>(from) % 16 == 0;
        if (quads) {
            repeated<Layout::padded / 8>([&](auto k) {
                const U quad = half + U(2 * k);
                const auto drawn = quad * U(4) < U(static_cast<std::uint32_t>(scene.channels));
                const U at = visit * U(of_visit / 4) + quad;
                W::copy4_ahead(has && drawn, reinterpret_cast<Quad4*>(to.feature), at,
                               reinterpret_cast<const Quad4*>(from),
                               n.owner * (stride / U(4)) + quad);
                W::write4_where(!(has && drawn), reinterpret_cast<Quad4*>(to.feature), at,
                                Array<F, 4>{{F(0.0F), F(0.0F), F(0.0F), F(0.0F)}});
            });
        } else {
            for (int k = 0; k < Layout::padded / 2; ++k) {
                const U channel = half + U(static_cast<std::uint32_t>(2 * k));
                const auto drawn = channel < U(static_cast<std::uint32_t>(scene.channels));
                const U at = visit * U(of_visit) + channel;
                W::copy_ahead(has && drawn, to.feature, at, from, n.owner * stride + channel);
                W::write_where(!(has && drawn), to.feature, at, F(0.0F));
            }
        }
    }

    template <class W>
    RYE_DEVICE void start(Shared& shared, StripCotangents<W, C, extra>& s,
                          const StripPixels<W>& pixels) const {
        using F = typename W::F;
        using U = typename W::U;
        const auto of = [&](const DeviceColumns<const float>& from, auto j, int channel) {
            if (from.data == nullptr) return F(0.0F);
            return W::read_where(pixels.inside(U(j)), from.data,
                                 pixels.pixel(U(j)) * U(static_cast<std::uint32_t>(from.rows)) +
                                     U(static_cast<std::uint32_t>(channel)),
                                 0.0F);
        };
        if constexpr (Layout::products) {
            planes<W>(shared, pixels);
            // As a visit of the background's colour.
            float* const row = shared.ahead[0].feature;
            for (std::uint32_t k = 0; k < static_cast<std::uint32_t>(Layout::padded); k += 32) {
                const U channel = U(k) + W::lane();
                const auto drawn = channel < U(static_cast<std::uint32_t>(scene.channels));
                W::write_where(
                    channel < U(Layout::padded), row, channel,
                    W::read_where(drawn, scene.background + scene.first_channel, channel, 0.0F));
            }
            W::sync();
            const auto background = over_channels<W>(row, U(0), U(0));
            repeated<4>([&](auto m) {
                const auto product = along<W>(shared, m, background);
                s.behind[2 * m] = product[0][0];
                s.behind[2 * m + 1] = product[0][2];
            });
        } else {
            repeated<8>([&](auto j) {
                Array<F, 4> background;
                repeated<C>([&](auto c) {
                    s.colour[j][c] = c < scene.channels
                                         ? of(image.feature, j, int(scene.first_channel) + c)
                                         : F(0.0F);
                    background[c] = F(scene.background_of(c));
                });
                s.behind[j] = Step::template along<W>(s.colour[j], background);
            });
        }
        if constexpr (extra)
            repeated<8>([&](auto j) {
                s.alpha[j] = scene.first_channel == 0 ? of(image.alpha, j, 0) : F(0.0F);
                s.depth[j] = scene.first_channel == 0 ? of(image.depth, j, 0) : F(0.0F);
            });
    }

    /// Writes the planes of the strip's cotangents: a row a pixel.
    template <class W>
    RYE_DEVICE void planes(Shared& shared, const StripPixels<W>& pixels) const {
        using F = typename W::F;
        using U = typename W::U;
        constexpr std::uint32_t pairs = Layout::padded / 2;
        const auto drawn = static_cast<std::uint32_t>(scene.channels);
        for (std::uint32_t k = 0; k < 64 * pairs; k += 32) {
            const U flat = U(k) + W::lane();
            const U pixel = flat / U(pairs), channel = flat % U(pairs) * U(2);
            const U x = pixel % U(8), y = pixel / U(8);
            const auto inside = pixels.inside(x, y);
            const U from = pixels.pixel(x, y) * U(static_cast<std::uint32_t>(image.feature.rows)) +
                           U(static_cast<std::uint32_t>(scene.first_channel)) + channel;
            F a = W::read_where(inside && channel < U(drawn), image.feature.data, from, 0.0F);
            F b = W::read_where(inside && channel + U(1) < U(drawn), image.feature.data,
                                from + U(1), 0.0F);
            repeated<N>([&](auto p) {
                const U word = W::pack(a, b);
                W::write_word(&shared.cotangent[p][0][0], pixel * U(of_pixel / 2) + flat % U(pairs),
                              word);
                a = a - W::low(word);
                b = b - W::high(word);
            });
        }
        W::sync();
    }

    static constexpr int steps = Layout::padded / 16;
    template <class W>
    using OverChannels = Array<Array<Planes<W, N, 2>, std::size_t(steps)>, 2>;

    /// Returns features as operands: of the visits at positions lane / 4 and 8 more.
    template <class W>
    RYE_DEVICE static OverChannels<W> over_channels(const float* rows, const typename W::U& first,
                                                    const typename W::U& second) {
        OverChannels<W> r;
        repeated<steps>([&](auto c) {
            r[0][c] = features_over_channels<W, N>(rows, of_visit, first, c);
            r[1][c] = features_over_channels<W, N>(rows, of_visit, second, c);
        });
        return r;
    }

    /// Returns <cotangent, colour> of two rows of pixels and 16 visits, by matrices.
    template <class W, class M>
    RYE_DEVICE Array<Array<typename W::F, 4>, 2> along(const Shared& shared, M m,
                                                       const OverChannels<W>& features) const {
        using F = typename W::F;
        Array<Array<F, 4>, 2> s;
        repeated<2>([&](auto n) { repeated<4>([&](auto k) { s[n][k] = F(0.0F); }); });
        repeated<steps>([&](auto c) {
            Planes<W, N, 4> pixels;
            repeated<N>([&](auto p) {
                pixels[p] = W::template tiles<false>(&shared.cotangent[p][0][0], tile_of<W>(m, c));
            });
            repeated<2>([&](auto n) { multiply<W, N>(s[n], pixels, features[n][c]); });
        });
        return s;
    }
    /// Returns rows of pixels 2 m and 2 m + 1 and 16 channels: where this lane's row begins
    /// [bytes].
    template <class W>
    RYE_DEVICE static typename W::U tile_of(int m, int c) {
        using U = typename W::U;
        return (U(static_cast<std::uint32_t>(16 * m)) + W::lane() % U(16)) * U(2 * of_pixel) +
               W::lane() / U(16) * U(16) + U(static_cast<std::uint32_t>(32 * c));
    }

    template <class W>
    RYE_DEVICE void group(const Shared& shared, const Ahead& ahead, StripCotangents<W, C, extra>& s,
                          const StripPixels<W>& pixels, const TileCentre& centre,
                          const Next<W>& now, int w) const {
        using U = typename W::U;
        const U column = W::lane() / U(4) * U(2), first = W::lane() % U(4) * U(4);
        const auto low = W::read4(ahead.transmittance, column),
                   high = W::read4(ahead.transmittance, column + U(1));
        const auto before = [&](auto j) {
            if constexpr (j < 4)
                return low[j];
            else
                return high[j - 4];
        };
        const Visits<W, A> v(
            [&](auto i) {
                const U at = (first + U(i)) * U(2);
                return TileSplat<W>(W::read4(ahead.record, at), W::read4(ahead.record, at + U(1)),
                                    centre.x, centre.y);
            },
            pixels.x, pixels.y, accuracy);
        float* const partial =
            memory.partial + std::size_t(now.group) * (group_visits * Layout::stride);
        typename Step::template Moments<W> sum;
        with_rules<W, !Layout::products>(accuracy, v, [&](const auto& rules) {
            rows<W>(shared, ahead, s, sum, v, rules, before, first, partial);
        });
        Step::template add_lanes<W>(v, sum, partial);
        // Pairs of a Gaussian and a tile learn of their slots.
        const auto has = W::lane() < U(group_visits) && now.owner < U(none_of);
        const auto strip = static_cast<std::uint32_t>(w);
        W::set_bit(has, memory.touched, now.place / U(8),
                   now.place % U(8) * U(tile_strips) + U(strip));
        const U place = now.place * U(tile_strips) + U(strip);
        W::write_where(has, reinterpret_cast<std::uint32_t*>(memory.slot), place,
                       U(now.group * group_visits) + W::lane());
    }

    /// Steps back over all rows of the strip, and writes what features get.
    template <class W, class Rules, class Before>
    RYE_DEVICE void rows([[maybe_unused]] const Shared& shared, const Ahead& ahead,
                         StripCotangents<W, C, extra>& s, typename Step::template Moments<W>& sum,
                         const Visits<W, A>& v, const Rules& rules, const Before& before,
                         [[maybe_unused]] const typename W::U& first,
                         [[maybe_unused]] float* partial) const {
        using F = typename W::F;
        using U = typename W::U;
        if constexpr (Layout::products) {
            const U position = W::lane() / U(4);
            const OverChannels<W> features = over_channels<W>(ahead.feature, visit_at<W>(position),
                                                              visit_at<W>(position + U(8)));
            Array<F, 4> colour[std::size_t(C / 8)];
            repeated<C / 8>([&](auto n) { repeated<4>([&](auto k) { colour[n][k] = F(0.0F); }); });
            expanded<4>([&](auto m) {
                const auto product = along<W>(shared, m, features);
                const auto one = [&](auto odd) {
                    const Constant<2 * m + odd> j;
                    const Array<F, 4> of_row{{product[0][2 * odd], product[0][2 * odd + 1],
                                              product[1][2 * odd], product[1][2 * odd + 1]}};
                    return Step::template one_row<W>(s, sum, v, rules, j, before(j), of_row);
                };
                const Taken<W> a = one(Constant<0>{});
                const Taken<W> b = one(Constant<1>{});
                Planes<W, N, 4> weights; // transposed: a row a position
                split<W, N>(weights, 0, a.visit[0].weight, a.visit[1].weight);
                split<W, N>(weights, 1, a.visit[2].weight, a.visit[3].weight);
                split<W, N>(weights, 2, b.visit[0].weight, b.visit[1].weight);
                split<W, N>(weights, 3, b.visit[2].weight, b.visit[3].weight);
                repeated<N>([&](auto p) {
                    repeated<4>([&](auto k) { weights[p][k] = W::transpose(weights[p][k]); });
                });
                expanded<(C + 15) / 16>([&](auto c) {
                    Planes<W, N, 2> left, right;
                    repeated<N>([&](auto p) {
                        const auto t =
                            W::template tiles<true>(&shared.cotangent[p][0][0], tile_of<W>(m, c));
                        left[p] = {{t[0], t[1]}};
                        right[p] = {{t[2], t[3]}};
                    });
                    multiply<W, N>(colour[2 * c], weights, left);
                    if constexpr (2 * c + 1 < C / 8)
                        multiply<W, N>(colour[2 * c + 1], weights, right);
                });
            });
            const U at = visit_at<W>(position) * U(Layout::stride) + U(Layout::head) +
                         W::lane() % U(4) * U(2);
            repeated<C / 8>([&](auto n) {
                W::write2(partial, (at + U(8 * n)) / U(2), colour[n][0], colour[n][1]);
                W::write2(partial, (at + U(8 * n + 2 * Layout::stride)) / U(2), colour[n][2],
                          colour[n][3]);
            });
        } else {
            Array<F, 4> colour[4];
            repeated<4>([&](auto i) {
                colour[i] = W::read4(reinterpret_cast<const Quad4*>(ahead.feature), first + U(i));
            });
            expanded<8>([&](auto j) {
                Array<F, 4> of_row;
                repeated<4>(
                    [&](auto i) { of_row[i] = Step::template along<W>(s.colour[j], colour[i]); });
                Step::template one_row<W>(s, sum, v, rules, j, before(j), of_row);
            });
        }
    }
};

} // namespace rye::detail
