// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_operands.hpp: a network in device memory as its kernels read it: weights as
/// operands of products of matrices, biases with the frame inputs folded in, and rows of points as
/// planes of bf16.
#pragma once

#include <cstdint>

#include <rye/backend/cuda.hpp>
#include <rye/backend/cuda/planes.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

/// x in whole operands, 16 numbers along K.
RYE_HD constexpr int padded_16(int x) { return (x + 15) / 16 * 16; }

/// One layer. Operands lie tile by tile of 16 (K) x 8 (N) numbers, K outer; of a tile plane by
/// plane, of a plane two registers a lane.
struct DeviceMlpLayer {
    int hidden, out; ///< widths; hidden is 0 for the first layer
    bool takes_input;
    const std::uint32_t* hidden_to_out; ///< K hidden, N out
    const std::uint32_t* input_to_out;
    const std::uint32_t* out_to_hidden; ///< K out, N hidden
    const std::uint32_t* out_to_input;
    const float* bias;        ///< with the products of the frame inputs
    std::uint16_t* activated; ///< outputs, planes x points x padded_16(out); kept for a vjp
    std::uint16_t* cotangent; ///< of the outputs, likewise
};

/// Points of which the device alone knows how many there are: columns of arrays that have more.
struct DevicePoints {
    const std::uint32_t* which = nullptr; ///< column of each, or null: the first ones
    const std::uint32_t* count = nullptr; ///< or null: all that there is room for

    RYE_DEVICE std::uint32_t among(std::uint32_t room) const {
        return count != nullptr ? rye::min(*count, room) : room;
    }
    RYE_DEVICE std::uint32_t column(std::uint32_t k) const {
        return which != nullptr ? which[k] : k;
    }
};

/// A network as kernels take it: its layers, and rows of points.
struct DeviceMlpNetwork {
    static constexpr int most_layers = 8;
    DeviceMlpLayer layer[most_layers];
    int layers, inputs;   ///< inputs of points, without those of the frame
    std::uint32_t points; ///< that there is room for
    DevicePoints of;
    std::uint16_t* input; ///< planes x points x padded_16(inputs)
};

/// An operand, whose element (k, n) is from[k * k_apart + n * n_apart].
struct MlpPackJob {
    const float* from;
    Index k_apart, n_apart;
    int k_count, n_count;
    std::uint32_t* to;
    int first; ///< block

    static Index words(int k_count, int n_count, int planes) {
        return Index(padded_16(k_count)) * padded_16(n_count) / 2 * planes;
    }
};

/// All operands of a network.
struct MlpPackKernel {
    static constexpr const char* name = "network's operands";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {};
    MlpPackJob job[4 * DeviceMlpNetwork::most_layers];
    int jobs, planes;
    Index all; ///< blocks

    /// Returns where the operand lies, and moves `word` behind it.
    const std::uint32_t* add(const MlpPackJob& of, std::uint32_t*& word) {
        MlpPackJob& own = job[jobs++] = of;
        own.to = word;
        own.first = static_cast<int>(all);
        all += (MlpPackJob::words(of.k_count, of.n_count, 1) + threads - 1) / threads;
        word += MlpPackJob::words(of.k_count, of.n_count, planes);
        return own.to;
    }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        int j = 0;
        while (j + 1 < jobs && job[j + 1].first <= block.index()) ++j;
        const MlpPackJob& own = job[j];
        const int columns = padded_16(own.n_count) / 8;
        const int words = padded_16(own.k_count) / 16 * columns * 64;
        block.each_thread([&](int t) {
            const int word = (block.index() - own.first) * threads + t;
            if (word >= words) return;
            const int tile = word / 64, lane = word % 64 / 2, half = word % 2;
            const int k = tile / columns * 16 + lane % 4 * 2 + half * 8;
            const int n = tile % columns * 8 + lane / 4;
            float a = at(own, k, n), b = at(own, k + 1, n);
            for (int p = 0; p < planes; ++p) {
                const std::uint32_t both = Block::pack(a, b);
                own.to[(Index(tile) * planes + p) * 64 + word % 64] = both;
                a = a - Block::low(both);
                b = b - Block::high(both);
            }
        });
    }

  private:
    RYE_DEVICE static float at(const MlpPackJob& own, int k, int n) {
        return k < own.k_count && n < own.n_count ? own.from[k * own.k_apart + n * own.n_apart]
                                                  : 0.0F;
    }
};

/// Biases of a layer with the products of the frame inputs.
struct MlpBiasJob {
    const float* bias;   ///< out
    const float* weight; ///< of the frame inputs, out x frame_inputs
    int out, frame_inputs;
    float* to;
    int first; ///< block
};

/// ... of all layers of a network.
struct MlpBiasKernel {
    static constexpr const char* name = "network's biases";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {};
    MlpBiasJob job[DeviceMlpNetwork::most_layers];
    int jobs;
    Index all; ///< blocks
    const float* frame;

    void add(const MlpBiasJob& of) {
        MlpBiasJob& own = job[jobs++] = of;
        own.first = static_cast<int>(all);
        all += (of.out + threads - 1) / threads;
    }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        int j = 0;
        while (j + 1 < jobs && job[j + 1].first <= block.index()) ++j;
        const MlpBiasJob& own = job[j];
        block.each_thread([&](int t) {
            const int o = (block.index() - own.first) * threads + t;
            if (o >= own.out) return;
            float sum = own.bias[o];
            for (int f = 0; f < own.frame_inputs; ++f)
                sum += own.weight[Index(f) * own.out + o] * frame[f];
            own.to[o] = sum;
        });
    }
};

/// Columns of floats that a block loads as rows of planes.
struct PointRows {
    DeviceColumns<const float> from;
    std::uint32_t count;                  ///< points there are
    const std::uint32_t* which = nullptr; ///< their columns, or null: the first ones
};

/// Rows of planes in shared memory: `width` numbers of each point, in other banks row by row.
template <int N, int rows_, int width>
struct PlaneRows {
    static constexpr int rows = rows_, stride = width + 8;
    alignas(16) std::uint16_t at[std::size_t(N)][std::size_t(rows_)][std::size_t(stride)];

    /// Columns [0, padded) of points [first, first + rows) from columns of floats; zeros beside
    /// what there is. By warp w of `warps`.
    template <class W>
    RYE_DEVICE void load(const PointRows& points, std::uint32_t first, int padded, int w,
                         int warps) {
        using F = typename W::F;
        using U = typename W::U;
        const auto height = static_cast<std::uint32_t>(points.from.rows);
        constexpr int at_once = 4; // rows whose numbers are on their way together
        for (int first_row = w; first_row < rows; first_row += at_once * warps) {
            const float* column[std::size_t(at_once)];
            bool there[std::size_t(at_once)];
            expanded<at_once>([&](auto i) {
                const int r = first_row + i * warps;
                const std::uint32_t point = first + static_cast<std::uint32_t>(r);
                there[i] = r < rows && point < points.count;
                const std::uint32_t at_column = !there[i]                 ? 0U
                                                : points.which != nullptr ? points.which[point]
                                                                          : point;
                column[i] = points.from.data + Index(at_column) * points.from.rows;
            });
            for (int k = 0; k < padded / 2; k += 32) {
                const U word = U(static_cast<std::uint32_t>(k)) + W::lane(), row = word * U(2);
                Array<F, 2> read[std::size_t(at_once)];
                expanded<at_once>([&](auto i) {
                    const auto inside =
                        word < U(static_cast<std::uint32_t>(there[i] ? padded / 2 : 0));
                    read[i] = {{W::read_where(inside && row < U(height), column[i], row, 0.0F),
                                W::read_where(inside && row + U(1) < U(height), column[i],
                                              row + U(1), 0.0F)}};
                });
                const auto own = word < U(static_cast<std::uint32_t>(padded / 2));
                expanded<at_once>([&](auto i) {
                    const int r = first_row + i * warps;
                    if (r >= rows) return;
                    F a = read[i][0], b = read[i][1];
                    expanded<N>([&](auto p) {
                        const U both = W::pack(a, b);
                        W::write_word_where(own, &at[p][r][0], word, both);
                        a = a - W::low(both);
                        b = b - W::high(both);
                    });
                });
            }
        }
    }

    /// To device memory, planes x points x padded; by thread t of `threads`.
    RYE_DEVICE void store(std::uint16_t* to, std::uint32_t first, std::uint32_t points, int padded,
                          int t, int threads) const {
        const int quads = padded / 8;
        for (int k = t; k < N * rows * quads; k += threads) {
            const int plane = k / (rows * quads), row = k / quads % rows, quad = k % quads;
            const std::uint32_t point = first + static_cast<std::uint32_t>(row);
            if (point >= points) continue;
            const Index place = (Index(plane) * points + point) * padded + quad * 8;
            *reinterpret_cast<Quad4*>(to + place) =
                *reinterpret_cast<const Quad4*>(&at[plane][row][quad * 8]);
        }
    }

    /// Rows [16 m, 16 m + 16) and columns [16 k, 16 k + 16) as a left operand.
    template <class W>
    RYE_DEVICE Planes<W, N, 4> left(int m, int k) const {
        using U = typename W::U;
        const U place =
            (U(static_cast<std::uint32_t>(16 * m)) + W::lane() % U(16)) * U(2 * stride) +
            W::lane() / U(16) * U(16) + U(static_cast<std::uint32_t>(32 * k));
        Planes<W, N, 4> r;
        expanded<N>([&](auto p) { r[p] = W::template tiles<false>(&at[p][0][0], place); });
        return r;
    }
    /// Rows [16 k, ...) and columns [16 m, ...), transposed, as a left operand.
    template <class W>
    RYE_DEVICE Planes<W, N, 4> left_transposed(int m, int k) const {
        using U = typename W::U;
        const U matrix = W::lane() / U(8);
        const U row = matrix / U(2) * U(8) + W::lane() % U(8);
        const U place = (U(static_cast<std::uint32_t>(16 * k)) + row) * U(2 * stride) +
                        matrix % U(2) * U(16) + U(static_cast<std::uint32_t>(32 * m));
        Planes<W, N, 4> r;
        expanded<N>([&](auto p) { r[p] = W::template tiles<true>(&at[p][0][0], place); });
        return r;
    }
    /// Rows [16 k, ...) and columns [16 n, ...) as two right operands of 8 columns.
    template <class W>
    RYE_DEVICE Array<Planes<W, N, 2>, 2> right(int n, int k) const {
        using U = typename W::U;
        const U matrix = W::lane() / U(8);
        const U row = matrix % U(2) * U(8) + W::lane() % U(8);
        const U place = (U(static_cast<std::uint32_t>(16 * k)) + row) * U(2 * stride) +
                        matrix / U(2) * U(16) + U(static_cast<std::uint32_t>(32 * n));
        Array<Planes<W, N, 2>, 2> r;
        expanded<N>([&](auto p) {
            const auto t = W::template tiles<true>(&at[p][0][0], place);
            r[0][p] = {{t[0], t[1]}};
            r[1][p] = {{t[2], t[3]}};
        });
        return r;
    }
};

/// A tile of an operand that MlpPackKernel wrote.
template <class W, int N>
RYE_DEVICE Planes<W, N, 2> packed_tile(const std::uint32_t* from, int tile) {
    Planes<W, N, 2> r;
    const std::uint32_t* const own = from + Index(tile) * N * 64;
    expanded<N>([&](auto p) { r[p] = W::read_words2(own + p * 64, W::lane()); });
    return r;
}

} // namespace rye
