// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_weights.hpp: gradients of a network's weights: products over points of the
/// layers' inputs and their cotangents, all layers by one kernel, in fixed slices of the points
/// whose sums are added in order (mlp_weight_merge.hpp). Products with ones make the sums of
/// cotangents, which biases and frame inputs take.
#pragma once

#include <rye/nn/cuda/mlp_weight_cut.hpp>

namespace rye::detail {

/// Partial sums of a slice, for layers of at most `wide_` outputs. Eight warps have half of a
/// block's inputs by a quarter of its outputs each; the next points are copied to shared memory
/// meanwhile.
template <int N, int wide_, int depth_ = N == 1 ? 32 : 16, int stages_ = N == 3 ? 2 : 3>
struct MlpWeightKernel {
    static constexpr const char* name = "network's weights";
    using Cut = MlpWeightCut<wide_>;
    static constexpr int threads = 256, blocks = Cut::together;
    static constexpr int depth = depth_; ///< points at a time
    static constexpr int stages = stages_;
    static constexpr int tall = Cut::high / 32, wide = Cut::wide / 32; ///< operands of a warp
    using Input = PlaneRows<N, depth, Cut::high>;
    using Cotangent = PlaneRows<N, depth, Cut::wide>;
    struct Stage {
        Input input;
        Cotangent cotangent;
    };
    struct Shared {
        Stage stage[std::size_t(stages)];
    };
    Cut cut;
    const std::uint16_t* kept;
    float* partial; ///< [blocks] warps x sums of a lane x 32, then sums of cotangents

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        int l = 0;
        while (l + 1 < cut.layers && cut.layer[l + 1].first <= block.index()) ++l;
        const MlpWeightLayer& layer = cut.layer[l];
        const int tiles = Cut::tiles(layer), at_block = block.index() - layer.first;
        const int tile = at_block % tiles, s = at_block / tiles;
        const std::uint32_t count = cut.of.among(cut.points);
        const std::uint32_t slice = Cut::points_of(count, layer.slices);
        const std::uint32_t begin = static_cast<std::uint32_t>(s) * slice;
        const std::uint32_t end = rye::min(begin + slice, count);
        if (begin >= end) return;
        auto sums = block.template of_warps<Sums<W>>();
        auto copies = block.template of_warps<Copies<W>>();
        block.each_warp([&](int w) {
            sums[w].begin(part(layer, tile, w), w);
            copies[w].begin(*this, layer, tile, {begin, end}, w);
            repeated<stages - 1>([&](auto i) {
                if (begin + i * depth < end) copies[w].next(*this, shared.stage[0], i, end);
                W::end_copies();
            });
            W::template wait_for_copies<stages - 2>();
        });
        // The whole block alike, so that warps stay together.
        const bool all =
            layer.columns.all() >= (tile + 1) * Cut::high && padded_16(layer.out) == Cut::wide;
        int now = 0;
        for (std::uint32_t at = begin; at < end; at += depth) {
            block.each_warp([&](int w) {
                const int free = now == 0 ? stages - 1 : now - 1;
                if (at + (stages - 1) * depth < end)
                    copies[w].next(*this, shared.stage[0], free, end);
                W::end_copies();
                if (all && tile == 0)
                    sums[w].template add<true, true>(shared.stage[0], now, w);
                else if (all)
                    sums[w].template add<true, false>(shared.stage[0], now, w);
                else
                    sums[w].template add<false, true>(shared.stage[0], now, w);
                W::template wait_for_copies<stages - 2>();
            });
            now = now + 1 == stages ? 0 : now + 1;
        }
        block.each_warp([&](int w) {
            float* const to = partial + Index(block.index()) * Cut::of_block;
            sums[w].store(to + Index(w) * (Cut::of_lane * 32));
            if (tile == 0) sums[w].store_sums(to + Cut::numbers, w);
        });
    }

  private:
    /// Part of a warp's inputs and outputs that exists.
    struct Own {
        int rows;  ///< operands of 16 inputs
        int pairs; ///< operands of 16 outputs
        int first; ///< first of those
    };
    RYE_DEVICE static Own part(const MlpWeightLayer& layer, int tile, int w) {
        const int rows = (layer.columns.all() - tile * Cut::high) / 16 - w / 4 * tall;
        const int share = Cut::own(layer), first = w % 4 * share;
        return {rye::max(0, rye::min(rows, int(tall))),
                rye::max(0, rye::min(share, padded_16(layer.out) / 16 - first)), first};
    }

    /// A warp's sums: of its inputs by its outputs, and of half of its outputs by ones.
    template <class W>
    struct Sums {
        using F = typename W::F;
        using U = typename W::U;
        Array<F, 4> sum[std::size_t(tall)][std::size_t(wide)];
        Array<F, 4> of_ones[std::size_t(wide / 2)];

        Own own;
        U left_place, right_place; ///< places of the first stage

        RYE_DEVICE void begin(const Own& of, int w) {
            own = of;
            left_place = Input::left_transposed_place(W::lane(), w / 4 * tall * 16);
            right_place = Cotangent::right_place(W::lane(), 16 * of.first);
            repeated<wide>([&](auto n) {
                repeated<4>([&](auto k) {
                    repeated<tall>([&](auto m) { sum[m][n][k] = F(0.0F); });
                    of_ones[n / 2][k] = F(0.0F);
                });
            });
        }
        /// `all`: all warps have all rows and pairs. `ones`: with sums of cotangents. Of the stage
        /// `now` behind the first.
        template <bool all, bool ones>
        RYE_DEVICE void add(const Stage& stage, int now, int w) {
            const U moved(static_cast<std::uint32_t>(now) * std::uint32_t(sizeof(Stage)));
            const U left_at = left_place + moved, right_at = right_place + moved;
            Planes<W, N, 4> one;
            repeated<N>([&](auto p) {
                const U both(p == 0 ? 0x3F803F80U : 0U);
                one[p] = {{both, both, both, both}};
            });
            repeated<depth / 16>([&](auto k) {
                Planes<W, N, 4> left[std::size_t(tall)];
                repeated<tall>([&](auto m) {
                    if (all || m < own.rows)
                        left[m] = stage.input.template left_transposed<W>(left_at, m, k);
                });
                repeated<wide / 2>([&](auto pair) {
                    if (all || pair < own.pairs) {
                        const auto right = stage.cotangent.template right<W>(right_at, pair, k);
                        repeated<tall>([&](auto m) {
                            if (all || m < own.rows) {
                                multiply<W, N>(sum[m][2 * pair], left[m], right[0]);
                                multiply<W, N>(sum[m][2 * pair + 1], left[m], right[1]);
                            }
                        });
                        if constexpr (ones) {
                            Planes<W, N, 2> half;
                            repeated<N>([&](auto p) {
                                repeated<2>([&](auto r) {
                                    half[p][r] = w < 4 ? right[0][p][r] : right[1][p][r];
                                });
                            });
                            multiply<W, N>(of_ones[pair], one, half);
                        }
                    }
                });
            });
        }
        RYE_DEVICE void store(float* to) const {
            repeated<tall>([&](auto m) {
                repeated<wide>([&](auto n) {
                    if (m < own.rows && n < 2 * own.pairs)
                        repeated<4>([&](auto k) {
                            W::write(to + 32 * ((m * wide + n) * 4 + k), W::lane(), sum[m][n][k]);
                        });
                });
            });
        }
        RYE_DEVICE void store_sums(float* to, int w) const {
            repeated<wide / 2>([&](auto pair) {
                if (pair < own.pairs)
                    repeated<2>([&](auto k) {
                        const U column =
                            U(static_cast<std::uint32_t>(16 * (own.first + pair) + w / 4 * 8 + k)) +
                            W::lane() % U(4U) * U(2U);
                        W::write_where(W::lane() < U(4U), to, column, of_ones[pair][k]);
                    });
            });
        }
    };

    struct Range {
        std::uint32_t first, end; ///< points
    };
    /// A warp's copies of a tile's inputs and of the cotangents: two rows of inputs at a time, and
    /// one or two of cotangents.
    template <class W>
    struct Copies {
        using U = typename W::U;
        using M = typename W::M;
        static constexpr int in_quads = Cut::high / 8, out_quads = Cut::wide / 8;
        static constexpr int out_rows = 32 / out_quads;
        static_assert(in_quads == 16 && depth % 16 == 0);
        const Quad4* cotangent;
        U in, in_apart, in_point; ///< quads of the next points' inputs, from point to point
        U out, out_point;
        std::uint32_t out_apart;
        U in_to, out_to; ///< quads of the first stage
        M in_own, out_own;
        std::uint32_t plane_apart; ///< points

        RYE_DEVICE void begin(const MlpWeightKernel& kernel, const MlpWeightLayer& layer, int tile,
                              const Range& of, int w) {
            const auto number = [](int x) { return U(static_cast<std::uint32_t>(x)); };
            const U lane = W::lane();
            const int hiddens = layer.columns.input_at() / 8,
                      inputs = layer.columns.all() / 8 - hiddens;
            const U quad = number(tile * in_quads) + lane % number(in_quads);
            const auto of_hidden = quad < number(hiddens);
            const U row = number(2 * w) + lane / number(in_quads);
            in_apart = select(of_hidden, number(hiddens), number(inputs));
            in_point = U(of.first) + row;
            in =
                select(of_hidden, U(layer.hidden) + quad, U(layer.input) + quad - number(hiddens)) +
                in_point * in_apart;
            in_to = row * number(Input::stride / 8) + lane % number(in_quads);
            in_own = quad < number(hiddens + inputs);
            cotangent = reinterpret_cast<const Quad4*>(layer.cotangent);
            out_apart = static_cast<std::uint32_t>(padded_16(layer.out) / 8);
            const U out_quad = lane % number(out_quads);
            const U out_row = number(out_rows * w) + lane / number(out_quads);
            out_point = U(of.first) + out_row;
            out = out_quad + out_point * U(out_apart);
            out_own = out_quad < U(out_apart);
            out_to = out_row * number(Cotangent::stride / 8) + out_quad;
            plane_apart = kernel.cut.points;
        }
        /// Starts to copy the next points to the stage `slot` behind the first; zeros from `end` on
        /// and where there are no numbers.
        RYE_DEVICE void next(const MlpWeightKernel& kernel, Stage& stage, int slot,
                             std::uint32_t end) {
            const U moved(static_cast<std::uint32_t>(slot) * std::uint32_t(sizeof(Stage) / 16));
            auto* const to_in = reinterpret_cast<Quad4*>(&stage.input.at[0][0][0]);
            const U in_at = in_to + moved;
            expanded<N * depth / 16>([&](auto j) {
                constexpr std::uint32_t plane = 16 * decltype(j)::value / depth,
                                        first = 16 * decltype(j)::value % depth;
                W::copy4_or_zero(in_own && in_point + U(first) < U(end), to_in,
                                 in_at + U((plane * depth + first) * (Input::stride / 8)),
                                 reinterpret_cast<const Quad4*>(kernel.kept),
                                 in + U(plane * plane_apart + first) * in_apart);
            });
            auto* const to_out = reinterpret_cast<Quad4*>(&stage.cotangent.at[0][0][0]);
            const U out_at = out_to + moved;
            constexpr int rows = 8 * out_rows; // of all warps
            expanded<N * depth / rows>([&](auto j) {
                constexpr std::uint32_t plane = rows * decltype(j)::value / depth,
                                        first = rows * decltype(j)::value % depth;
                W::copy4_or_zero(out_own && out_point + U(first) < U(end), to_out,
                                 out_at + U((plane * depth + first) * (Cotangent::stride / 8)),
                                 cotangent,
                                 out + U((plane * plane_apart + first) * out_apart));
            });
            in_point = in_point + U(std::uint32_t(depth));
            in = in + in_apart * U(std::uint32_t(depth));
            out_point = out_point + U(std::uint32_t(depth));
            out = out + U(depth * out_apart);
        }
    };
};

} // namespace rye::detail
