// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_weights.hpp: gradients of a network's weights: products over points of the
/// layers' inputs and their cotangents, all layers by one kernel, in fixed slices of the points
/// whose sums are added in order (mlp_weight_merge.hpp). Products with ones make the sums of
/// cotangents, which biases and frame inputs take.
#pragma once

#include <rye/nn/cuda/mlp_weight_cut.hpp>

namespace rye {

/// Partial sums of a slice. Eight warps have half of a block's inputs by a quarter of its outputs
/// each; the next points are copied to shared memory meanwhile.
template <int N, int depth_ = N == 1 ? 32 : 16, int stages_ = N == 3 ? 2 : 3>
struct MlpWeightKernel {
    static constexpr const char* name = "network's weights";
    static constexpr int threads = 256, blocks = 1;
    using Cut = MlpWeightCut;
    static constexpr int depth = depth_; ///< points at a time
    static constexpr int stages = stages_;
    static constexpr int tall = Cut::high / 32, wide = Cut::wide / 32; ///< operands of a warp
    struct Stage {
        PlaneRows<N, depth, Cut::high> input;
        PlaneRows<N, depth, Cut::wide> cotangent;
    };
    struct Shared {
        Stage stage[std::size_t(stages)];
    };
    Cut cut;
    const std::uint16_t* kept;
    float* partial; ///< of a block: warps x sums of a lane x 32, then sums of cotangents

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
        block.each_warp([&](int w) {
            sums[w].clear();
            expanded<stages - 1>([&](auto i) {
                fetch<W>(layer, tile, shared.stage[i], begin + i * depth, end, w);
                W::end_copies();
            });
            W::template wait_for_copies<stages - 2>();
        });
        int now = 0;
        for (std::uint32_t at = begin; at < end; at += depth) {
            block.each_warp([&](int w) {
                fetch<W>(layer, tile, shared.stage[(now + stages - 1) % stages],
                         at + (stages - 1) * depth, end, w);
                W::end_copies();
                const Own own = part(layer, tile, w);
                if (own.rows == tall && own.pairs == wide / 2 && tile == 0)
                    sums[w].template add<true, true>(shared.stage[now], own, w);
                else if (own.rows == tall && own.pairs == wide / 2)
                    sums[w].template add<true, false>(shared.stage[now], own, w);
                else
                    sums[w].template add<false, true>(shared.stage[now], own, w);
                W::template wait_for_copies<stages - 2>();
            });
            now = (now + 1) % stages;
        }
        block.each_warp([&](int w) {
            float* const to = partial + Index(block.index()) * Cut::of_block;
            const Own own = part(layer, tile, w);
            sums[w].store(to + Index(w) * (Cut::of_lane * 32), own);
            if (tile == 0) sums[w].store_sums(to + Cut::numbers, own, w);
        });
    }

  private:
    /// What of a warp's inputs and outputs there is.
    struct Own {
        int rows;  ///< operands of 16 inputs
        int pairs; ///< operands of 16 outputs
        int first; ///< of those
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

        RYE_DEVICE void clear() {
            expanded<wide>([&](auto n) {
                expanded<4>([&](auto k) {
                    expanded<tall>([&](auto m) { sum[m][n][k] = F(0.0F); });
                    of_ones[n / 2][k] = F(0.0F);
                });
            });
        }
        /// `all`: the warp has all rows and pairs. `ones`: with sums of cotangents.
        template <bool all, bool ones>
        RYE_DEVICE void add(const Stage& stage, const Own& own, int w) {
            Planes<W, N, 4> one;
            expanded<N>([&](auto p) {
                const U both(p == 0 ? 0x3F803F80U : 0U);
                one[p] = {{both, both, both, both}};
            });
            expanded<depth / 16>([&](auto k) {
                Planes<W, N, 4> left[std::size_t(tall)];
                expanded<tall>([&](auto m) {
                    if (all || m < own.rows)
                        left[m] = stage.input.template left_transposed<W>(w / 4 * tall + m, k);
                });
                expanded<wide / 2>([&](auto pair) {
                    if (all || pair < own.pairs) {
                        const auto right = stage.cotangent.template right<W>(own.first + pair, k);
                        expanded<tall>([&](auto m) {
                            if (all || m < own.rows) {
                                multiply<W, N>(sum[m][2 * pair], left[m], right[0]);
                                multiply<W, N>(sum[m][2 * pair + 1], left[m], right[1]);
                            }
                        });
                        if constexpr (ones) {
                            Planes<W, N, 2> half;
                            expanded<N>([&](auto p) {
                                expanded<2>([&](auto r) {
                                    half[p][r] = w < 4 ? right[0][p][r] : right[1][p][r];
                                });
                            });
                            multiply<W, N>(of_ones[pair], one, half);
                        }
                    }
                });
            });
        }
        RYE_DEVICE void store(float* to, const Own& own) const {
            expanded<tall>([&](auto m) {
                expanded<wide>([&](auto n) {
                    if (m < own.rows && n < 2 * own.pairs)
                        expanded<4>([&](auto k) {
                            W::write(to + 32 * ((m * wide + n) * 4 + k), W::lane(), sum[m][n][k]);
                        });
                });
            });
        }
        RYE_DEVICE void store_sums(float* to, const Own& own, int w) const {
            expanded<wide / 2>([&](auto pair) {
                if (pair < own.pairs)
                    expanded<2>([&](auto k) {
                        const U column =
                            U(static_cast<std::uint32_t>(16 * (own.first + pair) + w / 4 * 8 + k)) +
                            W::lane() % U(4U) * U(2U);
                        W::write_where(W::lane() < U(4U), to, column, of_ones[pair][k]);
                    });
            });
        }
    };

    /// Starts to copy points [at, at + depth) of a tile's inputs and of the cotangents, as far as
    /// there are any; zeros for points from `end` on.
    template <class W>
    RYE_DEVICE void fetch(const MlpWeightLayer& layer, int tile, Stage& stage, std::uint32_t at,
                          std::uint32_t end, int w) const {
        if (at >= end) return;
        if (at + depth <= end)
            fetch_some<W, true>(layer, tile, stage, at, end, w);
        else
            fetch_some<W, false>(layer, tile, stage, at, end, w);
    }
    template <class W, bool all>
    RYE_DEVICE void fetch_some(const MlpWeightLayer& layer, int tile, Stage& stage,
                               std::uint32_t at, std::uint32_t end, int w) const {
        using U = typename W::U;
        const auto number = [](int x) { return U(static_cast<std::uint32_t>(x)); };
        const auto copy = [&](const auto& own, auto* to, const U& i, const Quad4* from, const U& k,
                              const U& point) {
            W::copy4_ahead(own && point < U(end), to, i, from, k);
            if constexpr (!all) {
                const typename W::F zero(0.0F);
                W::write4_where(own && point >= U(end), to, i, {{zero, zero, zero, zero}});
            }
        };
        constexpr int left_quads = Cut::high / 8, right_quads = Cut::wide / 8;
        constexpr int left_stride = PlaneRows<N, depth, Cut::high>::stride / 8,
                      right_stride = PlaneRows<N, depth, Cut::wide>::stride / 8;
        static_assert(left_quads == 16 && right_quads == 32 && depth % 16 == 0);
        const U lane = W::lane();
        {
            const int hiddens = layer.columns.input_at() / 8,
                      inputs = layer.columns.all() / 8 - hiddens;
            const U quad = number(tile * left_quads) + lane % number(left_quads);
            const auto of_hidden = quad < number(hiddens);
            const U from =
                select(of_hidden, U(layer.hidden) + quad, U(layer.input) + quad - number(hiddens));
            const U apart = select(of_hidden, number(hiddens), number(inputs));
            const auto own = quad < number(hiddens + inputs);
            auto* const to = reinterpret_cast<Quad4*>(&stage.input.at[0][0][0]);
            expanded<N * depth / 16>([&](auto j) {
                constexpr int plane = 16 * decltype(j)::value / depth,
                              first = 16 * decltype(j)::value % depth;
                const U row = number(first + 2 * w) + lane / number(left_quads);
                const U point = U(at) + row;
                copy(
                    own, to,
                    (row + number(plane * depth)) * number(left_stride) + lane % number(left_quads),
                    reinterpret_cast<const Quad4*>(kept),
                    from + (U(std::uint32_t(plane) * cut.points) + point) * apart, point);
            });
        }
        const int outs = padded_16(layer.out) / 8;
        auto* const to = reinterpret_cast<Quad4*>(&stage.cotangent.at[0][0][0]);
        expanded<N * depth / 8>([&](auto j) {
            constexpr int plane = 8 * decltype(j)::value / depth,
                          first = 8 * decltype(j)::value % depth;
            const std::uint32_t point = at + static_cast<std::uint32_t>(first + w);
            copy(lane < number(outs), to, number((plane * depth + first + w) * right_stride) + lane,
                 reinterpret_cast<const Quad4*>(layer.cotangent),
                 U((std::uint32_t(plane) * cut.points + point) * static_cast<std::uint32_t>(outs)) +
                     lane,
                 U(point));
        });
    }
};

} // namespace rye
