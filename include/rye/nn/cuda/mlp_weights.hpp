// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_weights.hpp: gradients of a network's weights: products over points of a
/// layer's cotangents and its inputs, in fixed slices of the points whose sums are added in order.
/// A column of ones beside the inputs makes the sums of cotangents, which biases and frame inputs
/// take.
#pragma once

#include <rye/nn/cuda/mlp_kernels.hpp>

namespace rye {

/// The inputs of a layer side by side, each in whole operands: hidden, points'; then one of ones.
struct MlpColumns {
    int hidden, input; ///< numbers of the layer's two inputs; 0: it does not take that one
    RYE_HD int input_at() const { return padded_16(hidden); }
    RYE_HD int one_at() const { return padded_16(hidden) + padded_16(input); }
    RYE_HD int all() const { return one_at() + 1; }
};

/// What is the same for both kernels of the weights of a layer: slices of the points.
struct MlpSlices {
    static constexpr int most = 64;
    static constexpr std::uint32_t least = 256; ///< points of one
    /// Points of a slice, a multiple of 64.
    RYE_HD static std::uint32_t points(std::uint32_t count) {
        const std::uint32_t parts = (count + 63) / 64;
        return rye::max((parts + most - 1) / most * 64, std::uint32_t(least));
    }
    /// Slices that have points.
    RYE_HD static int used(std::uint32_t count) {
        return static_cast<int>((count + points(count) - 1) / points(count));
    }
};

/// Gradients of a layer's weights over a slice of the points: `high` outputs by 128 inputs a block,
/// whose numbers are copied to shared memory while those before are multiplied.
template <int N, int high_>
struct MlpWeightKernel {
    static constexpr const char* name = "network's weights";
    static constexpr int threads = 256, blocks = N == 1 ? 2 : 1;
    static constexpr int high = high_, wide = 128; ///< outputs, inputs
    static constexpr int depth = N == 1 ? 64 : 32; ///< points at a time
    static constexpr int tall = high / 32;         ///< operands of 16 outputs a warp
    static_assert(high == 64 || high == 128);
    struct Stage {
        PlaneRows<N, depth, high> cotangent;
        PlaneRows<N, depth, wide> input;
    };
    struct Shared {
        Stage stage[2];
    };
    MlpColumns columns;
    int out;
    std::uint32_t points; ///< that there is room for
    DevicePoints of;
    const std::uint16_t* cotangent; ///< planes x points x padded_16(out)
    const std::uint16_t* hidden;
    const std::uint16_t* input;
    float* partial; ///< slices x columns.all() x padded_16(out)

    RYE_HD int tiles_high() const { return (out + high - 1) / high; }
    RYE_HD int tiles_wide() const { return (columns.one_at() + wide - 1) / wide; }
    Index blocks_of() const { return Index(tiles_high()) * tiles_wide() * MlpSlices::most; }

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        const int tile = block.index() / MlpSlices::most, s = block.index() % MlpSlices::most;
        const Corner corner{tile / tiles_wide() * high, tile % tiles_wide() * wide};
        const std::uint32_t count = of.among(points);
        const std::uint32_t slice = MlpSlices::points(count);
        const std::uint32_t begin = static_cast<std::uint32_t>(s) * slice;
        const std::uint32_t end = rye::min(begin + slice, count);
        if (begin >= end) return;
        auto sums = block.template of_warps<Sums<W>>();
        block.each_warp([&](int w) {
            sums[w].clear();
            fetch<W>(shared.stage[0], begin, end, corner, w);
            W::end_copies();
        });
        int now = 0;
        for (std::uint32_t at = begin; at < end; at += depth) {
            block.each_warp([&](int w) {
                if (at + depth < end) fetch<W>(shared.stage[1 - now], at + depth, end, corner, w);
                W::end_copies();
                W::wait_for_copies();
            });
            block.each_warp([&](int w) { sums[w].add(shared.stage[now], corner.column == 0, w); });
            now = 1 - now;
        }
        block.each_warp([&](int w) { write(sums[w], s, corner, w); });
    }

  private:
    struct Corner {
        int row, column;
    };
    /// A warp's high / 2 outputs by 32 inputs, and sixteen of its outputs by the ones.
    template <class W>
    struct Sums {
        using F = typename W::F;
        using U = typename W::U;
        Array<F, 4> sum[std::size_t(tall)][4];
        Array<F, 4> of_ones;

        RYE_DEVICE void clear() {
            expanded<tall>([&](auto m) {
                expanded<4>([&](auto n) { expanded<4>([&](auto k) { sum[m][n][k] = F(0.0F); }); });
            });
            expanded<4>([&](auto k) { of_ones[k] = F(0.0F); });
        }
        RYE_DEVICE void add(const Stage& stage, bool ones, int w) {
            Planes<W, N, 2> one;
            expanded<N>([&](auto p) {
                const U both = p == 0 ? select(W::lane() < U(4), U(0x3F803F80U), U(0)) : U(0);
                one[p] = {{both, both}};
            });
            for (int k = 0; k < depth / 16; ++k) {
                Planes<W, N, 4> left[std::size_t(tall)];
                expanded<tall>([&](auto m) {
                    left[m] = stage.cotangent.template left_transposed<W>(w / 4 * tall + m, k);
                });
                expanded<2>([&](auto n) {
                    const auto right = stage.input.template right<W>(w % 4 * 2 + n, k);
                    expanded<tall>([&](auto m) {
                        multiply<W, N>(sum[m][2 * n], left[m], right[0]);
                        multiply<W, N>(sum[m][2 * n + 1], left[m], right[1]);
                    });
                });
                if (ones)
                    expanded<tall>([&](auto m) {
                        if (w % 4 == m) multiply<W, N>(of_ones, left[m], one);
                    });
            }
        }
    };

    /// Starts to copy points [at, at + depth) of the block's rows and columns; zeros beside what
    /// there is. A lane has eight numbers of a point.
    template <class W>
    RYE_DEVICE void fetch(Stage& stage, std::uint32_t at, std::uint32_t end, Corner corner,
                          int w) const {
        using U = typename W::U;
        const auto number = [](int x) { return U(static_cast<std::uint32_t>(x)); };
        constexpr int left_quads = high / 8, stride_left = PlaneRows<N, depth, high>::stride / 8,
                      stride_right = PlaneRows<N, depth, wide>::stride / 8;
        const U lane = W::lane(), quad = lane - number(left_quads); // of the inputs
        const auto is_left = lane < number(left_quads);
        const auto is_right = lane >= number(left_quads) && quad < number(wide / 8);
        const U row = number(corner.row / 8) + lane, column = number(corner.column / 8) + quad;
        const int outs = padded_16(out) / 8, hiddens = columns.input_at() / 8,
                  inputs = columns.one_at() / 8 - hiddens;
        const auto of_left = is_left && row < number(outs);
        const auto of_hidden = is_right && column < number(hiddens);
        const auto of_input =
            is_right && column >= number(hiddens) && column < number(hiddens + inputs);
        auto* const to_left = reinterpret_cast<Quad4*>(&stage.cotangent.at[0][0][0]);
        auto* const to_right = reinterpret_cast<Quad4*>(&stage.input.at[0][0][0]);
        const typename W::F nothing(0.0F);
        const Array<typename W::F, 4> zero{{nothing, nothing, nothing, nothing}};
        for (int k = w; k < N * depth; k += threads / 32) {
            const int plane = k / depth;
            const std::uint32_t point = at + static_cast<std::uint32_t>(k % depth);
            const bool there = point < end;
            const auto inside = [&](const auto& m) { return m && number(there ? 1 : 0) > U(0); };
            const auto first = [&](int quads) { // of the point
                return U((static_cast<std::uint32_t>(plane) * points + point) *
                         static_cast<std::uint32_t>(quads));
            };
            const U left_at = number(k * stride_left) + lane,
                    right_at = number(k * stride_right) + quad;
            W::copy4_ahead(inside(of_left), to_left, left_at,
                           reinterpret_cast<const Quad4*>(cotangent), first(outs) + row);
            W::copy4_ahead(inside(of_hidden), to_right, right_at,
                           reinterpret_cast<const Quad4*>(hidden), first(hiddens) + column);
            W::copy4_ahead(inside(of_input), to_right, right_at,
                           reinterpret_cast<const Quad4*>(input),
                           first(inputs) + column - number(hiddens));
            W::write4_where(is_left && !inside(of_left), to_left, left_at, zero);
            W::write4_where(is_right && !inside(of_hidden || of_input), to_right, right_at, zero);
        }
    }

    template <class W>
    RYE_DEVICE void write(const Sums<W>& sums, int s, Corner corner, int w) const {
        using U = typename W::U;
        const auto rows = static_cast<std::uint32_t>(padded_16(out));
        const auto ones = static_cast<std::uint32_t>(columns.one_at());
        float* const to = partial + Index(s) * columns.all() * Index(rows);
        const U across = W::lane() % U(4) * U(2);
        expanded<tall>([&](auto m) {
            const U top = U(static_cast<std::uint32_t>(corner.row + w / 4 * (high / 2) + 16 * m)) +
                          W::lane() / U(4);
            expanded<4>([&](auto n) {
                expanded<4>([&](auto k) {
                    const U r = top + U(std::uint32_t(k / 2 * 8));
                    const U c =
                        U(static_cast<std::uint32_t>(corner.column + w % 4 * 32 + 8 * n + k % 2)) +
                        across;
                    W::write_where(r < U(rows) && c < U(ones), to, c * U(rows) + r,
                                   sums.sum[m][n][k]);
                });
            });
            if (corner.column == 0 && w % 4 == m)
                expanded<2>([&](auto half) {
                    const U r = top + U(std::uint32_t(half * 8));
                    W::write_where(r < U(rows) && across < U(1), to, U(ones * rows) + r,
                                   sums.of_ones[2 * half]);
                });
        });
    }
};

/// Adds the slices, in their order, to the gradient of a layer's weights and biases.
struct MlpMergeKernel {
    static constexpr const char* name = "merge of weights";
    static constexpr int threads = 128, blocks = 8;
    static constexpr int at_once = 8; ///< slices that are read together
    struct Shared {};
    MlpColumns columns;
    int out, frame_inputs;
    std::uint32_t points; ///< that there is room for
    DevicePoints of;
    const float* partial;
    const float* frame; ///< frame_inputs, or null
    float* weight;      ///< out x (hidden + input + frame inputs); added to
    float* bias;        ///< added to
    float* sum;         ///< of cotangents over points, out

    Index blocks_of() const { return (Index(out) * columns.all() + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        const int slices = MlpSlices::used(of.among(points));
        block.each_thread([&](int t) {
            const int at = block.index() * threads + t;
            const int o = at % out, c = at / out;
            if (c > columns.one_at()) return;
            const Index rows = padded_16(out), apart = rows * columns.all();
            const float* const from = partial + c * rows + o;
            const auto total = [&] {
                float x = 0;
                for (int s = 0; s < slices; s += at_once) {
                    float part[std::size_t(at_once)];
                    expanded<at_once>(
                        [&](auto k) { part[k] = s + k < slices ? from[(s + k) * apart] : 0.0F; });
                    expanded<at_once>([&](auto k) { x += part[k]; });
                }
                return x;
            };
            if (c < columns.hidden)
                weight[Index(c) * out + o] += total();
            else if (c >= columns.input_at() && c < columns.input_at() + columns.input)
                weight[Index(columns.hidden + c - columns.input_at()) * out + o] += total();
            else if (c == columns.one_at()) {
                const float x = total();
                sum[o] = x;
                bias[o] += x;
                float* const of_frame = weight + Index(columns.hidden + columns.input) * out + o;
                for (int f = 0; f < frame_inputs; ++f) of_frame[Index(f) * out] += x * frame[f];
            }
        });
    }
};

/// The gradient of the frame inputs: W^T sum, written, or with `again` added.
struct MlpFrameKernel {
    static constexpr const char* name = "gradient of frame inputs";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {};
    const float* weight; ///< out x frame inputs
    const float* sum;    ///< out
    int out, frame_inputs;
    bool again;
    float* to;

    Index blocks_of() const { return (frame_inputs + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const int f = block.index() * threads + t;
            if (f >= frame_inputs) return;
            float x = 0;
            for (int o = 0; o < out; ++o) x += weight[Index(f) * out + o] * sum[o];
            to[f] = again ? to[f] + x : x;
        });
    }
};

} // namespace rye
