// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_weight_merge.hpp: sums of the slices of mlp_weights.hpp, in their order, added
/// to the gradients of weights, biases and frame inputs.
#pragma once

#include <rye/nn/cuda/mlp_weight_cut.hpp>

namespace rye::detail {

/// Destination of a layer's gradient.
struct MlpWeightTarget {
    float* weight; ///< out x (hidden + input + frame inputs); added to
    float* bias;   ///< added to
    float* sum;    ///< [out] sums of cotangents over points
    int first;     ///< block
};

/// Adds the slices, in their order, to the gradients of all layers' weights and biases.
template <int wide>
struct MlpMergeKernel {
    static constexpr const char* name = "merge of weights";
    static constexpr int threads = 128, blocks = 8;
    static constexpr int at_once = 8; ///< slices that are read together
    using Cut = MlpWeightCut<wide>;
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
                repeated<at_once>(
                    [&](auto k) { part[k] = s + k < used ? from[(s + k) * apart] : 0.0F; });
                repeated<at_once>([&](auto k) { x += part[k]; });
            }
            *at += x;
            if (number >= Cut::numbers) to.sum[number - Cut::numbers] = x;
        });
    }

  private:
    /// The weight whose sum is that number of a tile's block, or null.
    RYE_DEVICE static float* weight(const MlpWeightLayer& layer, const MlpWeightTarget& to,
                                    int tile, int number) {
        constexpr int tiles = wide / 32; // a warp's, along its outputs
        const int lane = number % 32, k = number / 32 % 4, n = number / 128 % tiles,
                  m = number / (128 * tiles) % 4, w = number / (512 * tiles);
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
    const float* sum;    ///< [out] sums of cotangents over points
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
                    W::write_where(
                        there, of.g_weight + first, at,
                        F(W::read_where(there, of.g_weight + first, at, 0.0F) + F(sum * own)));
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

} // namespace rye::detail
