// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_operands.hpp: a network in device memory as its kernels read it: weights as
/// operands of products of matrices, biases with the frame inputs folded in, and rows of points as
/// planes of bf16.
#pragma once

#include <cstdint>

#include <rye/backend/cuda.hpp>
#include <rye/backend/cuda/planes.hpp>
#include <rye/math/scalar.hpp>

namespace rye::detail {

/// x in whole operands, 16 numbers along K.
RYE_HD constexpr int padded_16(int x) { return (x + 15) / 16 * 16; }

/// Weights as the right operand of a product: tile by tile of 16 (K) x 8 (N) numbers, K outer; of a
/// tile plane by plane, of a plane two registers a lane.
struct MlpOperand {
    const std::uint32_t* at = nullptr;
    int steps = 0, tiles = 0; ///< tiles along K, 0 where there is no product, and along N
};

/// One layer.
struct DeviceMlpLayer {
    int hidden, out; ///< widths; hidden is 0 for the first layer
    bool takes_input;
    MlpOperand to_out;        ///< K hidden, then the input, where it is taken; N out
    MlpOperand out_to_hidden; ///< K out, N hidden
    MlpOperand out_to_input;
    const float* bias;        ///< padded_16(out), with the products of the frame inputs
    std::uint16_t* activated; ///< outputs, planes x points x padded_16(out); kept for a vjp
    std::uint16_t* cotangent; ///< cotangents of the outputs, likewise
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
    int tiles; ///< along N, at least those that hold n_count
    std::uint32_t* to;
    int first; ///< block

    static Index words(int k_count, int tiles, int planes) {
        return Index(padded_16(k_count)) / 16 * tiles * 64 * planes;
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
        all += (MlpPackJob::words(of.k_count, of.tiles, 1) + threads - 1) / threads;
        word += MlpPackJob::words(of.k_count, of.tiles, planes);
        return own.to;
    }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        int j = 0;
        while (j + 1 < jobs && job[j + 1].first <= block.index()) ++j;
        const MlpPackJob& own = job[j];
        const int columns = own.tiles;
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
    const float* weight; ///< [out, frame_inputs] weights of the frame inputs
    int out, frame_inputs;
    float* to; ///< padded_16(out), zeros beyond
    int first; ///< block
};

/// ... of all layers of a network.
struct MlpBiasKernel {
    static constexpr const char* name = "network's biases";
    static constexpr int threads = 128, blocks = 4;
    static constexpr int at_once = 16; ///< weights that are read together
    struct Shared {};
    MlpBiasJob job[DeviceMlpNetwork::most_layers];
    int jobs;
    Index all; ///< blocks
    const float* frame;

    void add(const MlpBiasJob& of) {
        MlpBiasJob& own = job[jobs++] = of;
        own.first = static_cast<int>(all);
        all += (padded_16(of.out) + threads - 1) / threads;
    }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        int j = 0;
        while (j + 1 < jobs && job[j + 1].first <= block.index()) ++j;
        const MlpBiasJob& own = job[j];
        block.each_thread([&](int t) {
            const int o = (block.index() - own.first) * threads + t;
            if (o >= padded_16(own.out)) return;
            float sum = o < own.out ? own.bias[o] : 0.0F;
            for (int f = 0; f < own.frame_inputs && o < own.out; f += at_once) {
                float weight[std::size_t(at_once)];
                repeated<at_once>([&](auto k) {
                    weight[k] =
                        f + k < own.frame_inputs ? own.weight[Index(f + k) * own.out + o] : 0.0F;
                });
                repeated<at_once>([&](auto k) {
                    if (f + k < own.frame_inputs) sum += weight[k] * frame[f + k];
                });
            }
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

/// Place of a lane that goes through rows of `each` numbers one after the other, `step` numbers at
/// a time.
template <class U>
struct RowsWalk {
    U row, number;
    std::uint32_t each, rows_of_step, rest_of_step;

    RYE_DEVICE RowsWalk(const U& first, std::uint32_t each_, std::uint32_t step)
        : row(first / U(each_)),
          number(first % U(each_)),
          each(each_),
          rows_of_step(step / each_),
          rest_of_step(step % each_) {}
    RYE_DEVICE void advance() {
        const U next = number + U(rest_of_step);
        const auto beyond = next >= U(each);
        number = select(beyond, next - U(each), next);
        row = row + U(rows_of_step) + select(beyond, U(1U), U(0U));
    }
};

/// Rows of planes in shared memory: `width` numbers of each point, in other banks row by row.
template <int N, int rows_, int width>
struct PlaneRows {
    static constexpr int rows = rows_, stride = width + 8;
    static_assert(stride % 16 == 8, "rows of 8 x 8 tiles begin in other banks");
    alignas(16) std::uint16_t at[std::size_t(N)][std::size_t(rows_)][std::size_t(stride)];

    /// Columns [to, to + padded) of points [first, first + rows) from columns of floats; zeros
    /// beside what there is. By warp w of `warps`.
    template <class W, int warps>
    RYE_DEVICE void load(const PointRows& points, std::uint32_t first, int to, int padded, int w) {
        const bool of_quads = points.from.rows % 4 == 0 &&
                              reinterpret_cast<std::uintptr_t>(points.from.data) % 16 == 0;
        if (of_quads)
            load_some<W, warps, 4>(points, first, to, padded, w);
        else
            load_some<W, warps, 2>(points, first, to, padded, w);
    }

    /// To device memory, planes x points x padded: columns [from, from + padded) of the points, of
    /// which there is room for `points`; by warp w of `warps`.
    template <class W, int warps>
    RYE_DEVICE void store(std::uint16_t* to, std::uint32_t first, std::uint32_t points, int from,
                          int padded, int w) const {
        using U = typename W::U;
        constexpr int step = 32 * warps, at_once = 4;
        const auto quads = static_cast<std::uint32_t>(padded / 8);
        const std::uint32_t count = rye::min(points - first, std::uint32_t(rows)) * quads;
        repeated<N>([&](auto plane) {
            auto* const target =
                reinterpret_cast<Quad4*>(to) + (Index(plane) * points + first) * Index(quads);
            const auto* const source = reinterpret_cast<const Quad4*>(&at[plane][0][0]) + from / 8;
            U k = U(static_cast<std::uint32_t>(32 * w)) + W::lane();
            RowsWalk<U> walk(k, quads, step);
            for (std::uint32_t i = 0; i < count; i += at_once * step) {
                Array<typename W::F, 4> read[std::size_t(at_once)];
                repeated<at_once>([&](auto j) {
                    read[j] = W::read4_where(k + U(std::uint32_t(j * step)) < U(count), source,
                                             walk.row * U(std::uint32_t(stride / 8)) + walk.number);
                    walk.advance();
                });
                repeated<at_once>([&](auto j) {
                    const U own = k + U(std::uint32_t(j * step));
                    W::write4_where(own < U(count), target, own, read[j]);
                });
                k = k + U(std::uint32_t(at_once * step));
            }
        });
    }
    /// Starts to copy what `store` wrote; zeros for points that there is no room for.
    template <class W, int warps>
    RYE_DEVICE void fetch(const std::uint16_t* from, std::uint32_t first, std::uint32_t points,
                          int padded, int w) {
        using U = typename W::U;
        constexpr int step = 32 * warps;
        const auto quads = static_cast<std::uint32_t>(padded / 8);
        const std::uint32_t count = rye::min(points - first, std::uint32_t(rows)) * quads;
        repeated<N>([&](auto plane) {
            const auto* const source = reinterpret_cast<const Quad4*>(from) +
                                       (Index(plane) * points + first) * Index(quads);
            auto* const target = reinterpret_cast<Quad4*>(&at[plane][0][0]);
            U k = U(static_cast<std::uint32_t>(32 * w)) + W::lane();
            RowsWalk<U> walk(k, quads, step);
            for (std::uint32_t i = static_cast<std::uint32_t>(32 * w); i < rows * quads;
                 i += step) {
                W::copy4_or_zero(k < U(count), target,
                                 walk.row * U(std::uint32_t(stride / 8)) + walk.number, source, k);
                walk.advance();
                k = k + U(std::uint32_t(step));
            }
        });
    }

    /// Returns the place at which a lane reads rows [row, row + 16) and columns [0, 16) as a left
    /// operand [bytes].
    template <class U>
    RYE_DEVICE static U left_place(const U& lane, int row) {
        return (U(static_cast<std::uint32_t>(row)) + lane % U(16)) * U(2 * stride) +
               lane / U(16) * U(16);
    }
    /// The left operand at such a place, moved by `down` rows and to the right by `columns`.
    template <class W>
    RYE_DEVICE Planes<W, N, 4> left(const typename W::U& place, int down, int columns) const {
        using U = typename W::U;
        Planes<W, N, 4> r;
        repeated<N>([&](auto p) {
            r[p] = W::template tiles<false>(&at[p][0][0],
                                            place + U(static_cast<std::uint32_t>(2 * columns)) +
                                                U(static_cast<std::uint32_t>(2 * stride * down)));
        });
        return r;
    }
    /// Returns the place at which a lane reads columns [column, column + 16) of 16 rows,
    /// transposed, as a left operand [bytes]; and such a place, of rows [16 k, ...), moved by 16 m
    /// columns.
    template <class U>
    RYE_DEVICE static U left_transposed_place(const U& lane, int column) {
        return (lane / U(16) * U(8) + lane % U(8)) * U(2 * stride) + lane / U(8) % U(2) * U(16) +
               U(static_cast<std::uint32_t>(2 * column));
    }
    template <class W>
    RYE_DEVICE Planes<W, N, 4> left_transposed(const typename W::U& place, int m, int k) const {
        Planes<W, N, 4> r;
        repeated<N>([&](auto p) { r[p] = transposed<W>(place, p, m, k); });
        return r;
    }
    /// ... as two right operands of 8 columns.
    template <class U>
    RYE_DEVICE static U right_place(const U& lane, int column) {
        return lane % U(16) * U(2 * stride) + lane / U(16) * U(16) +
               U(static_cast<std::uint32_t>(2 * column));
    }
    template <class W>
    RYE_DEVICE Array<Planes<W, N, 2>, 2> right(const typename W::U& place, int n, int k) const {
        Array<Planes<W, N, 2>, 2> r;
        repeated<N>([&](auto p) {
            const auto t = transposed<W>(place, p, n, k);
            r[0][p] = {{t[0], t[1]}};
            r[1][p] = {{t[2], t[3]}};
        });
        return r;
    }

  private:
    template <class W>
    RYE_DEVICE Array<typename W::U, 4> transposed(const typename W::U& place, int plane, int m,
                                                  int k) const {
        const int moved = 2 * ((plane * rows + 16 * k) * stride + 16 * m);
        return W::template tiles<true>(&at[0][0][0],
                                       place + typename W::U(static_cast<std::uint32_t>(moved)));
    }
    /// `load` by `some` numbers of a point at once.
    template <class W, int warps, int some>
    RYE_DEVICE void load_some(const PointRows& points, std::uint32_t first, int to, int padded,
                              int w) {
        using F = typename W::F;
        using U = typename W::U;
        constexpr int step = 32 * warps;
        constexpr int at_once = some == 4 ? 8 : 4; // on their way together
        const auto pieces = static_cast<std::uint32_t>(padded / some);
        const U height(static_cast<std::uint32_t>(points.from.rows));
        RowsWalk<U> walk(U(static_cast<std::uint32_t>(32 * w)) + W::lane(), pieces, step);
        for (std::uint32_t k = static_cast<std::uint32_t>(32 * w); k < rows * pieces;
             k += at_once * step) {
            Array<F, std::size_t(some)> read[std::size_t(at_once)];
            U word[std::size_t(at_once)];
            typename W::M own[std::size_t(at_once)];
            expanded<at_once>([&](auto i) {
                const U point = U(first) + walk.row, column = walk.number * U(std::uint32_t(some));
                own[i] = walk.row < U(std::uint32_t(rows));
                word[i] = walk.row * U(std::uint32_t(stride / 2)) + column / U(2U) +
                          U(static_cast<std::uint32_t>(to / 2));
                const auto there = own[i] && point < U(points.count) && column < height;
                U from = point;
                if (points.which != nullptr)
                    from = W::read(points.which, select(there, point, U(0U)));
                if constexpr (some == 4) {
                    read[i] =
                        W::read4_where(there, reinterpret_cast<const Quad4*>(points.from.data),
                                       from * (height / U(4U)) + walk.number);
                } else {
                    const U place = from * height + column;
                    read[i] = {{W::read_where(there, points.from.data, place, 0.0F),
                                W::read_where(there && column + U(1U) < height, points.from.data,
                                              place + U(1U), 0.0F)}};
                }
                walk.advance();
            });
            repeated<at_once>([&](auto i) {
                repeated<some / 2>([&](auto half) {
                    F a = read[i][2 * half], b = read[i][2 * half + 1];
                    repeated<N>([&](auto p) {
                        const U both = W::pack(a, b);
                        W::write_word_where(own[i], &at[p][0][0], word[i] + U(std::uint32_t(half)),
                                            both);
                        a = a - W::low(both);
                        b = b - W::high(both);
                    });
                });
            });
        }
    }
};

/// A tile of an operand that MlpPackKernel wrote.
template <class W, int N>
RYE_DEVICE Planes<W, N, 2> packed_tile(const std::uint32_t* from) {
    Planes<W, N, 2> r;
    repeated<N>([&](auto p) { r[p] = W::read_words2(from + p * 64, W::lane()); });
    return r;
}

} // namespace rye::detail
