// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_group_operands.hpp: a network in device memory as kernels of groups read it
/// (backend/cuda/group_products.hpp): weights in the layout of operands in shared memory, and what
/// passes from kernel to kernel in tiles of 64 points:
///     tile by tile, 8 numbers by 8 numbers, point by point: 8 numbers of a point are neighbours
/// so that a tile is an operand as it lies, of points by numbers or transposed, and a warp writes
/// its registers 128 bytes at a time.
#pragma once

#include <type_traits>

#include <rye/nn/activations.hpp>
#include <rye/nn/cuda/mlp_sums.hpp>

namespace rye::detail {

/// Sizes of the work of groups for a network's tiles.
template <class Tiles, class A>
struct MlpGroupTiles {
    static constexpr int width = Tiles::width, inputs = Tiles::inputs;
    /// Whether there are kernels: of one plane, and an activation whose slope the sign tells.
    static constexpr bool there = Tiles::N == 1 && (width == 128 || width == 256) &&
                                  (inputs == 32 || inputs == 64 || inputs == 128) &&
                                  std::is_same_v<A, LeakyRelu>;
    static constexpr int points = 64;          ///< of a group
    static constexpr int pieces = width / 128; ///< of 128 columns
    static constexpr int groups = width == 128 ? 3 : 2;
    static constexpr int last = 32; ///< outputs, at most
    static constexpr bool streams = width == 256; ///< operands that do not stay pass through
    static constexpr int most_layers = DeviceMlpNetwork::most_layers;
    /// Room for the operands in shared memory.
    static constexpr int bytes = (227 * 1024 - most_layers * width * 4 - 64) / 128 * 128;

    /// Returns the bytes of the operands of the forward pass, or of the reverse one.
    template <class Shape>
    static int operand_bytes(const Shape& s) {
        int sum = 0;
        for (int l = 0; l < s.layers(); ++l) {
            const int out = l + 1 == s.layers() ? last : width;
            sum += 2 * out * ((l > 0 ? width : 0) + (s.reads_input(l) ? inputs : 0));
        }
        return sum;
    }
    /// Whether operands stay in shared memory; others pass through it (mlp_group_stream.hpp).
    template <class Shape>
    static bool stays(const Shape& s) {
        return operand_bytes(s) <= bytes;
    }
    template <class Shape>
    static bool fits(const Shape& s) {
        bool all = there && s.layers() >= 2 && s.layers() <= most_layers && s.point_inputs() > 0 &&
                   s.point_inputs() <= inputs && s.outputs() <= last && (streams || stays(s));
        for (int l = 0; l + 1 < s.layers(); ++l) all = all && s.layer_out(l) == width;
        return all;
    }
};

/// A network as kernels take it: hidden layers all have the tiles' width.
struct MlpGroupNetwork {
    int layers, inputs, out;
    std::uint32_t takes_input; ///< bit l: layer l
    const void* forward;       ///< operands, in the order in which layers need them
    const void* reverse;       ///< ... from the last layer on, then those to the inputs
    int bytes;                 ///< of each
    const float* bias;         ///< layers x width, with the products of the frame inputs
    std::uint32_t points;      ///< that there is room for
    DevicePoints of;
    std::uint16_t* input;          ///< inputs of points
    std::uint16_t* activated;      ///< outputs of hidden layers, layer by layer
    std::uint32_t* signs;          ///< of those: [layer][tile][width / 64][128] bits
    std::uint16_t* cotangent;      ///< of those
    std::uint16_t* last_cotangent; ///< padded_16(out) wide

    RYE_HD std::uint32_t tiles() const { return (points + 63) / 64; }
    RYE_HD bool takes(int l) const { return (takes_input >> static_cast<unsigned>(l) & 1U) != 0; }
};

/// An operand of K x n numbers, whose element (k, n) is from[k * k_apart + n * n_apart]; zeros
/// beyond k_count and n_count.
struct MlpGroupPackJob {
    const float* from;
    Index k_apart, n_apart;
    int k_count, n_count;
    int k, n; ///< in whole tiles of 8
    int word; ///< where it begins
};

/// All operands of a network, 8 numbers along K by n in tiles of 8 x 8, numbers along K neighbours,
/// and biases with the products of the frame inputs.
struct MlpGroupPackKernel {
    static constexpr const char* name = "network's operands";
    static constexpr int threads = 128, blocks = 8;
    static constexpr int most = 6 * DeviceMlpNetwork::most_layers;
    static constexpr int parts = 8, at_once = 8; ///< of the frame inputs; weights read together
    struct Shared {
        float part[threads];
    };
    MlpGroupPackJob job[most];
    int jobs = 0, words = 0;
    std::uint32_t* to;
    MlpBiasJob bias[DeviceMlpNetwork::most_layers];
    int layers = 0, bias_blocks = 0;
    const float* frame;

    void add(MlpGroupPackJob own) {
        own.word = words;
        job[jobs++] = own;
        words += own.k * own.n / 2;
    }
    void add(MlpBiasJob own) {
        own.first = bias_blocks;
        bias[layers++] = own;
        bias_blocks += (own.out * parts + threads - 1) / threads;
    }
    Index all() const { return bias_blocks + (words + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        if (block.index() < bias_blocks)
            add_frame(block, shared);
        else
            pack(block);
    }

  private:
    template <class Block>
    RYE_DEVICE void pack(Block& block) const {
        block.each_thread([&](int t) {
            const int at = (block.index() - bias_blocks) * threads + t;
            if (at >= words) return;
            int j = 0;
            while (j + 1 < jobs && job[j + 1].word <= at) ++j;
            const MlpGroupPackJob& own = job[j];
            const int word = at - own.word, tile = word / 32, across = own.n / 8;
            const int k = tile / across * 8 + word % 4 * 2, n = tile % across * 8 + word % 32 / 4;
            to[at] = Block::pack(number(own, k, n), number(own, k + 1, n));
        });
    }
    template <class Block>
    RYE_DEVICE void add_frame(Block& block, Shared& shared) const {
        int l = 0;
        while (l + 1 < layers && bias[l + 1].first <= block.index()) ++l;
        const MlpBiasJob& own = bias[l];
        constexpr int outputs = threads / parts;
        const int first = (block.index() - own.first) * outputs;
        block.each_thread([&](int t) {
            const int o = first + t % outputs, part = t / outputs;
            float sum = 0;
            for (int f = part; f < own.frame_inputs && o < own.out; f += parts * at_once) {
                float weight[std::size_t(at_once)];
                repeated<at_once>([&](auto k) {
                    const int at = f + k * parts;
                    weight[k] = at < own.frame_inputs ? own.weight[Index(at) * own.out + o] : 0.0F;
                });
                repeated<at_once>([&](auto k) {
                    const int at = f + k * parts;
                    if (at < own.frame_inputs) sum += weight[k] * frame[at];
                });
            }
            shared.part[t] = sum;
        });
        block.each_thread([&](int t) {
            const int o = first + t;
            if (t >= outputs || o >= own.out) return;
            float sum = own.bias[o];
            for (int part = 0; part < parts; ++part) sum += shared.part[part * outputs + t];
            own.to[o] = sum;
        });
    }
    RYE_DEVICE static float number(const MlpGroupPackJob& own, int k, int n) {
        return k < own.k_count && n < own.n_count ? own.from[k * own.k_apart + n * own.n_apart]
                                                  : 0.0F;
    }
};

/// Rows of a warp as a left operand, 16 numbers of each a step.
template <class W, int steps>
using GroupRows = Array<Array<typename W::U, 4>, std::size_t(steps)>;

/// Where a warp's rows lie in a tile of 64 points.
template <class W>
struct GroupPlace {
    using U = typename W::U;
    std::uint32_t tile;
    U pair;     ///< of the lane's columns: 2 pair, 2 pair + 1, of 8
    U point[2]; ///< lane / 4, and 8 further
    typename W::M there[2];
    U word; ///< of the first row, in tiles

    RYE_DEVICE GroupPlace(std::uint32_t tile_, std::uint32_t count, int w) : tile(tile_) {
        const U row = U(static_cast<std::uint32_t>(16 * (w % 4))) + W::lane() / U(4U);
        pair = W::lane() % U(4U);
        word = row * U(4U) + pair;
        repeated<2>([&](auto h) {
            point[h] = U(64 * tile) + row + U(std::uint32_t(8 * h));
            there[h] = point[h] < U(count);
        });
    }
    /// A pair of columns 8 j of row 8 h of an array whose tile has `octets` times 8 numbers.
    template <int octets>
    RYE_DEVICE void write(std::uint16_t* array, int j, int h, const U& both) const {
        W::write_word(at<octets>(array) + (256 * j + 32 * h), word, both);
    }
    template <int octets>
    RYE_DEVICE U read(std::uint16_t* array, int j, int h) const {
        return W::read(static_cast<const std::uint32_t*>(at<octets>(array) + (256 * j + 32 * h)),
                       word);
    }
    template <int octets>
    RYE_DEVICE std::uint32_t* at(std::uint16_t* array) const {
        return reinterpret_cast<std::uint32_t*>(array) + Index(tile) * (256 * octets);
    }
    /// Columns of floats as rows; zeros beside what there is. `which`: columns of points, or null.
    template <std::size_t steps>
    RYE_DEVICE void load(Array<Array<U, 4>, steps>& to, const DeviceColumns<const float>& from,
                         const std::uint32_t* which) const {
        const U height(static_cast<std::uint32_t>(from.rows));
        U first[2];
        repeated<2>([&](auto h) {
            U column = point[h];
            if (which != nullptr) column = W::read(which, select(there[h], column, U(0U)));
            first[h] = column * height + pair * U(2U);
        });
        const auto each = [&](const auto& read) {
            expanded<int(steps)>([&](auto s) {
                expanded<4>([&](auto r) {
                    constexpr int begin = 16 * decltype(s)::value + decltype(r)::value / 2 * 8;
                    constexpr int h = decltype(r)::value % 2;
                    const U column = pair * U(2U) + U(std::uint32_t(begin));
                    to[s][r] = read(Constant<begin>{}, there[h] && column < height,
                                    there[h] && column + U(1U) < height, first[h]);
                });
            });
        };
        if (from.rows % 2 == 0 && reinterpret_cast<std::uintptr_t>(from.data) % 8 == 0)
            each([&](auto begin, const auto& one, const auto&, const U& at) {
                const auto v = W::read2_where(one, from.data + begin, at / U(2U));
                return W::pack(v[0], v[1]);
            });
        else
            each([&](auto begin, const auto& one, const auto& two, const U& at) {
                return W::pack(W::read_where(one, from.data + begin, at, 0.0F),
                               W::read_where(two, from.data + begin + 1, at, 0.0F));
            });
    }
};

/// sum (+)= rows times an operand of n columns in shared memory: of the rows' numbers from
/// 16 `first` on, 16 `some`.
template <class W, int n, bool onto, int steps, int first = 0, int some = steps>
RYE_DEVICE void multiply_group(Array<typename W::F, std::size_t(n / 2)>& sum,
                               const GroupRows<W, steps>& rows, const unsigned char* operand) {
    const auto b = W::operand(operand, 128, 16 * n);
    expanded<some>([&](auto k) {
        W::template product<n, onto || (decltype(k)::value > 0), false>(sum, rows[first + k],
                                                                        W::moved(b, 32 * n * k));
    });
}

/// A batch of products of these sums, and no other, from its beginning to its end.
template <class W, std::size_t count, class F>
RYE_DEVICE void batch(Array<typename W::F, count>& sum, const F& products) {
    W::settle(sum);
    W::begin_products();
    products();
    W::end_products();
    W::template wait_for_products<0>();
    W::settle(sum);
}

} // namespace rye::detail
