// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_weights.hpp: gradients of a network's weights: products over points of a
/// layer's cotangents and its inputs, in fixed slices of the points whose sums are added in order.
/// A column of ones beside the inputs makes the sums of cotangents, which biases and frame inputs
/// take.
#pragma once

#include <rye/nn/cuda/mlp_kernels.hpp>

namespace rye {

/// The inputs of a layer side by side, each in whole operands: hidden, points', one.
struct MlpColumns {
    int hidden, input; ///< numbers of the layer's two inputs; 0: it does not take that one
    RYE_HD int input_at() const { return padded_16(hidden); }
    RYE_HD int one_at() const { return padded_16(hidden) + padded_16(input); }
    RYE_HD int all() const { return one_at() + 16; }
};

/// Gradients of a layer's weights over a slice of the points.
template <int N>
struct MlpWeightKernel {
    static constexpr const char* name = "network's weights";
    static constexpr int threads = 256, blocks = 2;
    static constexpr int high = 64, wide = 128, depth = 64; ///< outputs, inputs, points at a time
    static constexpr int slices = 40;                       ///< of the points
    struct Shared {
        PlaneRows<N, depth, high> cotangent;
        PlaneRows<N, depth, wide> input;
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
    RYE_HD int tiles_wide() const { return (columns.all() + wide - 1) / wide; }
    Index blocks_of() const { return Index(tiles_high()) * tiles_wide() * slices; }
    /// Points of a slice.
    RYE_HD static std::uint32_t slice(std::uint32_t count) {
        const std::uint32_t parts = (count + depth - 1) / depth;
        return (parts + slices - 1) / slices * depth;
    }

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        const int tile = block.index() / slices, s = block.index() % slices;
        const int row = tile / tiles_wide() * high, column = tile % tiles_wide() * wide;
        const std::uint32_t count = of.among(points);
        const std::uint32_t begin = static_cast<std::uint32_t>(s) * slice(count);
        const std::uint32_t end = rye::min(begin + slice(count), count);
        auto sums = block.template of_warps<Sums<W>>();
        block.each_warp([&](int w) { sums[w].clear(); });
        for (std::uint32_t at = begin; at < end; at += depth) {
            block.each_thread([&](int t) { fetch(shared, at, end, {row, column}, t); });
            block.each_warp([&](int w) { sums[w].add(shared, w); });
        }
        block.each_warp([&](int w) { write(sums[w], s, row, column, w); });
    }

  private:
    struct Corner {
        int row, column;
    };
    /// A warp's 32 outputs by 32 inputs.
    template <class W>
    struct Sums {
        using F = typename W::F;
        Array<F, 4> sum[2][4];

        RYE_DEVICE void clear() {
            expanded<2>([&](auto m) {
                expanded<4>([&](auto n) { expanded<4>([&](auto k) { sum[m][n][k] = F(0.0F); }); });
            });
        }
        RYE_DEVICE void add(const Shared& shared, int w) {
            for (int k = 0; k < depth / 16; ++k) {
                Planes<W, N, 4> left[2];
                expanded<2>([&](auto m) {
                    left[m] = shared.cotangent.template left_transposed<W>(w / 4 * 2 + m, k);
                });
                expanded<2>([&](auto n) {
                    const auto right = shared.input.template right<W>(w % 4 * 2 + n, k);
                    expanded<2>([&](auto m) {
                        multiply<W, N>(sum[m][2 * n], left[m], right[0]);
                        multiply<W, N>(sum[m][2 * n + 1], left[m], right[1]);
                    });
                });
            }
        }
    };

    /// Points [at, at + depth) of the tile's rows and columns; zeros beside what there is.
    RYE_DEVICE void fetch(Shared& shared, std::uint32_t at, std::uint32_t end, Corner corner,
                          int t) const {
        constexpr int quads = (high + wide) / 8;
        for (int k = t; k < N * depth * quads; k += threads) {
            const int plane = k / (depth * quads), r = k / quads % depth, quad = k % quads;
            const std::uint32_t point = at + static_cast<std::uint32_t>(r);
            const bool left = quad < high / 8;
            const int c = left ? corner.row + 8 * quad : corner.column + 8 * quad - high;
            Quad4 x{0, 0, 0, 0};
            if (point < end)
                x = left ? row_of(cotangent, plane, point, c, padded_16(out))
                         : of_column(plane, point, c);
            std::uint16_t* const to = left ? &shared.cotangent.at[plane][r][8 * quad]
                                           : &shared.input.at[plane][r][8 * quad - high];
            *reinterpret_cast<Quad4*>(to) = x;
        }
    }
    RYE_DEVICE Quad4 of_column(int plane, std::uint32_t point, int c) const {
        if (c < columns.input_at())
            return row_of(hidden, plane, point, c, padded_16(columns.hidden));
        if (c < columns.one_at())
            return row_of(input, plane, point, c - columns.input_at(), padded_16(columns.input));
        // Eight numbers of bf16, the first of them 1 = 0x3F80.
        Quad4 one{0, 0, 0, 0};
        if (c == columns.one_at() && plane == 0)
            reinterpret_cast<std::uint16_t*>(&one)[0] = std::uint16_t(0x3F80);
        return one;
    }
    RYE_DEVICE Quad4 row_of(const std::uint16_t* from, int plane, std::uint32_t point, int c,
                            int width) const {
        if (c >= width) return {0, 0, 0, 0};
        return *reinterpret_cast<const Quad4*>(from + (Index(plane) * points + point) * width + c);
    }

    template <class W>
    RYE_DEVICE void write(const Sums<W>& sums, int s, int row, int column, int w) const {
        using U = typename W::U;
        const auto rows = static_cast<std::uint32_t>(padded_16(out));
        const auto all = static_cast<std::uint32_t>(columns.all());
        float* const to = partial + Index(s) * all * rows;
        expanded<2>([&](auto m) {
            expanded<4>([&](auto n) {
                expanded<4>([&](auto k) {
                    const U r =
                        U(static_cast<std::uint32_t>(row + w / 4 * 32 + 16 * m + k / 2 * 8)) +
                        W::lane() / U(4);
                    const U c = U(static_cast<std::uint32_t>(column + w % 4 * 32 + 8 * n + k % 2)) +
                                W::lane() % U(4) * U(2);
                    W::write_where(r < U(rows) && c < U(all), to, c * U(rows) + r,
                                   sums.sum[m][n][k]);
                });
            });
        });
    }
};

/// Adds the slices, in their order, to the gradient of a layer's weights and biases.
struct MlpMergeKernel {
    static constexpr const char* name = "merge of weights";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {};
    MlpColumns columns;
    int out, slices, frame_inputs;
    const float* partial;
    const float* frame; ///< frame_inputs, or null
    float* weight;      ///< out x (hidden + input + frame inputs); added to
    float* bias;        ///< added to
    float* sum;         ///< of cotangents over points, out

    Index blocks_of() const { return (Index(out) * columns.all() + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const int at = block.index() * threads + t;
            const int o = at % out, c = at / out;
            if (c > columns.one_at()) return;
            const Index rows = padded_16(out), apart = rows * columns.all();
            const float* const from = partial + c * rows + o;
            const auto total = [&] {
                float x = 0;
                for (int s = 0; s < slices; ++s) x += from[s * apart];
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
