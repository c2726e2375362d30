// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_weights.hpp: gradients of a network's weights: products over points of the
/// layers' inputs and their cotangents, all layers by one kernel, in fixed slices of the points
/// whose sums are added in order. Products with ones make the sums of cotangents, which biases and
/// frame inputs take.
#pragma once

#include <rye/nn/cuda/mlp_kernels.hpp>

namespace rye {

/// The inputs of a layer side by side, each in whole operands: hidden, points'.
struct MlpColumns {
    int hidden, input; ///< numbers of the layer's two inputs; 0: it does not take that one
    RYE_HD int input_at() const { return padded_16(hidden); }
    RYE_HD int all() const { return padded_16(hidden) + padded_16(input); }
};

/// A layer's part of the work: blocks of `high` inputs by all outputs by a slice of the points.
struct MlpWeightLayer {
    MlpColumns columns;
    int out;
    const std::uint16_t* cotangent; ///< planes x points x padded_16(out)
    std::uint32_t hidden, input;    ///< where those lie among what was kept [groups of 8]
    int slices, first;              ///< slices of the points; first block
};

/// What the gradients of a network's weights are cut into. It follows from shapes alone, so that
/// sums keep their order.
struct MlpWeightCut {
    static constexpr int high = 128, wide = 256; ///< inputs and outputs of a block, at most
    static constexpr int aim = 132; ///< blocks: one for each unit of the largest devices
    static constexpr std::uint32_t least = 256; ///< points of a slice
    static constexpr int warps = 8, of_lane = 128;       ///< sums
    static constexpr int numbers = warps * of_lane * 32; ///< of a block, without sums of cotangents
    static constexpr int of_block = numbers + wide;
    MlpWeightLayer layer[DeviceMlpNetwork::most_layers];
    int layers, all;      ///< blocks
    std::uint32_t points; ///< that there is room for
    DevicePoints of;

    RYE_HD static int tiles(const MlpWeightLayer& l) { return (l.columns.all() + high - 1) / high; }
    /// Operands of 16 outputs of each of four warps, at most.
    RYE_HD static int own(const MlpWeightLayer& l) { return (padded_16(l.out) / 16 + 3) / 4; }
    /// Sets slices and blocks.
    void divide() {
        const auto cost = [](const MlpWeightLayer& l) { // of a tile: copies, products, waiting
            const int rows = rye::min(l.columns.all(), int(high)), columns = padded_16(l.out);
            return rows + columns + rows * columns / 256 + 96;
        };
        int total = 0;
        for (int l = 0; l < layers; ++l) total += tiles(layer[l]) * cost(layer[l]);
        all = 0;
        for (int l = 0; l < layers; ++l) {
            layer[l].slices = rye::max(1, (cost(layer[l]) * aim + total / 2) / rye::max(total, 1));
            layer[l].first = all;
            all += tiles(layer[l]) * layer[l].slices;
        }
    }
    /// Points of a slice of so many, a multiple of 64.
    RYE_HD static std::uint32_t points_of(std::uint32_t count, int slices) {
        const auto most = static_cast<std::uint32_t>(slices), parts = (count + 63) / 64;
        return rye::max((parts + most - 1) / most * 64, std::uint32_t(least));
    }
};

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
                        const auto right =
                            stage.cotangent.template right<W>(own.first + pair, k);
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
                copy(own, to,
                     (row + number(plane * depth)) * number(left_stride) +
                         lane % number(left_quads),
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

/// Where a layer's gradient goes.
struct MlpWeightTarget {
    float* weight; ///< out x (hidden + input + frame inputs); added to
    float* bias;   ///< added to
    float* sum;    ///< of cotangents over points, out
    int first;     ///< block
};

/// Adds the slices, in their order, to the gradients of all layers' weights and biases.
struct MlpMergeKernel {
    static constexpr const char* name = "merge of weights";
    static constexpr int threads = 128, blocks = 8;
    static constexpr int at_once = 8; ///< slices that are read together
    using Cut = MlpWeightCut;
    static_assert(Cut::of_block % threads == 0);
    struct Shared {};
    Cut cut;
    const float* partial;
    MlpWeightTarget target[DeviceMlpNetwork::most_layers];
    int all = 0; ///< blocks

    /// After the cut has all layers; weight, bias and sum of layer l.
    void set(int l, const MlpWeightTarget& to) {
        target[l] = to;
        target[l].first = all;
        all += Cut::tiles(cut.layer[l]) * (Cut::of_block / threads);
    }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        int l = 0;
        while (l + 1 < cut.layers && target[l + 1].first <= block.index()) ++l;
        const MlpWeightLayer& layer = cut.layer[l];
        const MlpWeightTarget& to = target[l];
        const int first = (block.index() - to.first) * threads;
        const int tile = first / Cut::of_block;
        const std::uint32_t count = cut.of.among(cut.points);
        const std::uint32_t slice = Cut::points_of(count, layer.slices);
        const auto used = static_cast<int>((count + slice - 1) / slice);
        const Index apart = Index(Cut::tiles(layer)) * Cut::of_block;
        block.each_thread([&](int t) {
            const int number = first % Cut::of_block + t;
            float* at = nullptr;
            if (number < Cut::numbers)
                at = weight(layer, to, tile, number);
            else if (tile == 0 && number - Cut::numbers < layer.out)
                at = to.bias + (number - Cut::numbers);
            if (at == nullptr) return;
            const float* const from =
                partial + (Index(layer.first) + tile) * Cut::of_block + number;
            float x = 0;
            for (int s = 0; s < used; s += at_once) {
                float part[std::size_t(at_once)];
                expanded<at_once>(
                    [&](auto k) { part[k] = s + k < used ? from[(s + k) * apart] : 0.0F; });
                expanded<at_once>([&](auto k) { x += part[k]; });
            }
            *at += x;
            if (number >= Cut::numbers) to.sum[number - Cut::numbers] = x;
        });
    }

  private:
    /// The weight whose sum is that number of a tile's block, or null.
    RYE_DEVICE static float* weight(const MlpWeightLayer& layer, const MlpWeightTarget& to,
                                    int tile, int number) {
        const int lane = number % 32, k = number / 32 % 4, n = number / 128 % 8,
                  m = number / 1024 % 4, w = number / 4096;
        const int own = 2 * Cut::own(layer);
        const int row = tile * Cut::high + w / 4 * 64 + 16 * m + k / 2 * 8 + lane / 4;
        const int o = 8 * (w % 4 * own + n) + lane % 4 * 2 + k % 2;
        if (n >= own || o >= layer.out) return nullptr;
        const MlpColumns& columns = layer.columns;
        if (row < columns.hidden) return to.weight + Index(row) * layer.out + o;
        const int input = row - columns.input_at();
        return input >= 0 && input < columns.input
                   ? to.weight + Index(columns.hidden + input) * layer.out + o
                   : nullptr;
    }
};

/// A layer that takes frame inputs.
struct MlpFrameLayer {
    const float* weight; ///< out x frame inputs
    float* g_weight;     ///< added to
    const float* sum;    ///< of cotangents over points, out
    int out;
};

/// Gradients of the weights of the frame inputs, sum frame^T, which are added, and of the frame
/// inputs themselves: W^T sum of all layers, written, or with `add` added. A warp has an input.
struct MlpFrameKernel {
    static constexpr const char* name = "gradient of frame inputs";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {};
    MlpFrameLayer layer[DeviceMlpNetwork::most_layers];
    int layers, frame_inputs;
    const float* frame;
    bool add;
    float* to; ///< or null

    Index blocks_of() const { return (Index(frame_inputs) * 32 + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        using W = typename Block::Warp;
        using F = typename W::F;
        using U = typename W::U;
        block.each_warp([&](int w) {
            const int f = block.index() * (threads / 32) + w;
            if (f >= frame_inputs) return;
            const F own(frame[f]);
            F x(0.0F);
            for (int l = 0; l < layers; ++l) {
                const MlpFrameLayer& of = layer[l];
                const Index first = Index(f) * of.out;
                for (int o = 0; o < of.out; o += 32) {
                    const U at = U(static_cast<std::uint32_t>(o)) + W::lane();
                    const auto there = at < U(static_cast<std::uint32_t>(of.out));
                    const F sum = W::read_where(there, of.sum, at, 0.0F);
                    x = x + F(W::read_where(there, of.weight + first, at, 0.0F) * sum);
                    W::write_where(there, of.g_weight + first, at,
                                   F(W::read_where(there, of.g_weight + first, at, 0.0F) +
                                     F(sum * own)));
                }
            }
            if (to == nullptr) return;
            x = x + W::template across<16>(x);
            x = x + W::template across<8>(x);
            x = x + W::template across<4>(x);
            x = x + W::template across<2>(x);
            x = x + W::template across<1>(x);
            const U one = W::lane();
            const F before = add ? F(to[f]) : F(0.0F);
            W::write_where(one < U(1U), to + f, one, F(before + x));
        });
    }
};

} // namespace rye
