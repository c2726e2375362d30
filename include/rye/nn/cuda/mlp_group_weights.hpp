// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_group_weights.hpp: gradients of a network's weights by groups: products over
/// points of the layers' inputs and their cotangents, in fixed slices of the points, whose sums are
/// added in order. Tiles of 64 points come as they lie; products with ones make the sums of
/// cotangents, which biases and frame inputs take.
#pragma once

#include <rye/backend/cuda/ring_memory.hpp>
#include <rye/nn/cuda/mlp_group_operands.hpp>

namespace rye::detail {

/// A layer's part of the work: blocks of `high` inputs by all outputs by a slice of the points.
struct MlpGroupWeightLayer {
    const std::uint16_t* hidden; ///< outputs of the layer below
    const std::uint16_t* cotangent;
    int hidden_rows, input_rows; ///< numbers of its inputs, in whole tiles
    int columns, kept;           ///< outputs of a block, and those that cotangents have
    int high, slices, first;     ///< inputs of a block; slices of the points; first block
    int number;                  ///< of the first sum of the first block

    RYE_HD int rows() const { return hidden_rows + input_rows; }
    RYE_HD int tiles() const { return (rows() + high - 1) / high; }
    /// Sums of a block: its inputs by its outputs, then those of cotangents.
    RYE_HD int numbers() const { return (rye::min(high, rows()) + 1) * columns; }
};

/// What the gradients of a network's weights are cut into. Slices follow from shapes alone, so that
/// sums keep their order.
struct MlpGroupWeightCut {
    static constexpr int aim = 132; ///< blocks: for each multiprocessor of the devices there are
    MlpGroupWeightLayer layer[DeviceMlpNetwork::most_layers];
    int layers, all, numbers; ///< blocks, and sums of all of them
    const std::uint16_t* input;
    std::uint32_t points; ///< that there is room for
    DevicePoints of;

    /// Sets slices and blocks: a block's time goes with the bytes of a point.
    void divide() {
        const auto cost = [](const MlpGroupWeightLayer& l) {
            return rye::min(l.high, l.rows()) + l.kept + 32;
        };
        int total = 0;
        for (int l = 0; l < layers; ++l) total += layer[l].tiles() * cost(layer[l]);
        all = 0;
        for (int l = 0; l < layers; ++l) {
            layer[l].slices = rye::max(1, cost(layer[l]) * aim / rye::max(total, 1));
            all += layer[l].tiles() * layer[l].slices;
        }
        // The rest goes to the longest slices.
        for (;;) {
            int longest = -1;
            for (int l = 0; l < layers; ++l)
                if (all + layer[l].tiles() <= aim &&
                    (longest < 0 || cost(layer[l]) * layer[longest].slices >
                                        cost(layer[longest]) * layer[l].slices))
                    longest = l;
            if (longest < 0) break;
            ++layer[longest].slices;
            all += layer[longest].tiles();
        }
        int first = 0;
        numbers = 0;
        for (int l = 0; l < layers; ++l) {
            const int blocks = layer[l].tiles() * layer[l].slices;
            layer[l].first = first;
            layer[l].number = numbers;
            first += blocks;
            numbers += blocks * layer[l].numbers();
        }
    }
    /// Tiles of 64 points of slice s: s, s + slices, ... What the reverse pass wrote last, which
    /// the cache still has, all slices read first.
    RYE_HD static int tiles_of(std::uint32_t count, int slices, int s) {
        return (static_cast<int>((count + 63) / 64) - s + slices - 1) / slices;
    }
};

/// Partial sums of a slice. Two groups have 64 of a block's inputs each, in turn.
template <class Tiles>
struct MlpGroupWeightKernel {
    static constexpr const char* name = "network's weights";
    static constexpr bool of_groups = true;
    static constexpr int groups = 2, threads = 128 * groups, blocks = 1;
    static constexpr int width = Tiles::width, inputs = Tiles::inputs, last = Tiles::last;
    static constexpr int all_rows = (width + inputs + 63) / 64 * 64; ///< that products read
    /// Inputs of a block: of layers with `width` outputs, of the last layer.
    static constexpr int high = width == 128 ? 256 : 128, high_last = 384;
    static_assert(all_rows <= high_last && (width != 128 || all_rows <= high));
    static constexpr int most_rows = width == 128 ? all_rows : 128;
    static constexpr int stage_bytes =
        128 * rye::max(most_rows + width, rye::min(high_last, all_rows) + last);
    using Shared = RingMemory<(227 * 1024 - 256) / stage_bytes, stage_bytes>;
    MlpGroupWeightCut cut;
    float* partial; ///< blocks' sums, inputs outermost, then sums of cotangents

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        int l = 0;
        while (l + 1 < cut.layers && cut.layer[l + 1].first <= block.index()) ++l;
        const MlpGroupWeightLayer& layer = cut.layer[l];
        const int tiles = layer.tiles(), at_block = block.index() - layer.first;
        const int part = at_block % tiles, slice = at_block / tiles;
        const std::uint32_t count = cut.of.among(cut.points);
        const int steps = MlpGroupWeightCut::tiles_of(count, layer.slices, slice);
        if (steps <= 0) return;
        block.each_thread([&](int t) {
            if (t == 0) W::set_ring(shared, 4 * groups);
        });
        // A piece: the cotangents of 64 points, then the block's inputs.
        const int first = part * layer.high, rows = rye::min(layer.high, layer.rows() - first);
        const int of_hidden = rye::max(0, rye::min(rows, layer.hidden_rows - first));
        const auto piece = [&](int k, const auto& copy) {
            const Index tile = slice + Index(k) * layer.slices;
            copy(0, layer.cotangent + tile * 64 * layer.kept, 128 * layer.kept);
            const int at = 128 * layer.columns;
            if (of_hidden > 0)
                copy(at, layer.hidden + (tile * layer.hidden_rows + first) * 64, 128 * of_hidden);
            if (of_hidden < rows)
                copy(at + 128 * of_hidden,
                     cut.input +
                         (tile * layer.input_rows + (first + of_hidden - layer.hidden_rows)) * 64,
                     128 * (rows - of_hidden));
        };
        float* const to = partial + layer.number + Index(at_block) * layer.numbers();
        block.each_warp([&](int w) {
            const Work work{steps, rows, w};
            const int units = rye::max(1, ((rows + 63) / 64 - w / 4 + groups - 1) / groups);
            if (l + 1 < cut.layers) {
                if constexpr (width == 128) {
                    if (units == 1)
                        sums<W, width, 1, true>(shared, piece, work, to);
                    else
                        sums<W, width, 2, true>(shared, piece, work, to);
                } else if (part == 0) {
                    sums<W, width, 1, true>(shared, piece, work, to);
                } else {
                    sums<W, width, 1, false>(shared, piece, work, to);
                }
            } else if (units == 1) {
                sums<W, last, 1, true>(shared, piece, work, to);
            } else if (units == 2) {
                sums<W, last, 2, true>(shared, piece, work, to);
            } else {
                sums<W, last, 3, true>(shared, piece, work, to);
            }
        });
    }

  private:
    struct Work {
        int steps, rows, w; ///< pieces; inputs of the block; warp
    };
    /// Sums of `units` times 64 inputs of a group by n outputs; `ones`: with those of cotangents.
    template <class W, int n, int units, bool with_ones, class Piece>
    RYE_DEVICE static void sums(Shared& shared, const Piece& piece, const Work& work, float* to) {
        using F = typename W::F;
        using U = typename W::U;
        constexpr int wide = n < 128 ? n : 128, across = n / wide, ones_wide = n / groups;
        const int w = work.w, group = w / 4, rows = work.rows;
        Array<F, std::size_t(wide / 2)> sum[std::size_t(units)][std::size_t(across)];
        Array<F, std::size_t(ones_wide / 2)> of_ones;
        expanded<units * across>([&](auto i) {
            repeated<wide / 2>([&](auto k) { sum[i / across][i % across][k] = F(0.0F); });
        });
        repeated<ones_wide / 2>([&](auto k) { of_ones[k] = F(0.0F); });
        const U one(0x3F803F80U);
        const Array<U, 4> ones{{one, one, one, one}};
        RingPlace<Shared> place, next; // `next` is filled by one of the warps
        const auto fill = [&] {
            if (w == 0 && next.piece < work.steps) W::fill(shared, next, piece);
            next.next();
        };
        repeated<Shared::slots - 1>([&](auto) { fill(); });
        for (int step = 0; step < work.steps; ++step, place.next()) {
            fill(); // the piece before this one was read
            const unsigned char* const at = W::take(shared, place, piece);
            const auto right = W::operand(at, 1024, 128),
                       left = W::operand(at + 128 * n + 8192 * group, 1024, 128);
            expanded<units * across>([&](auto i) { W::settle(sum[i / across][i % across]); });
            W::settle(of_ones);
            W::begin_products();
            expanded<4 * units * across>([&](auto i) {
                constexpr int k = decltype(i)::value % 4, c = decltype(i)::value / 4 % across,
                              u = decltype(i)::value / (4 * across);
                W::template product_transposed<wide>(sum[u][c],
                                                     W::moved(left, 8192 * groups * u + 256 * k),
                                                     W::moved(right, 16384 * c + 256 * k), w % 4);
            });
            if constexpr (with_ones)
                expanded<4>([&](auto k) {
                    W::template product<ones_wide, true, true>(
                        of_ones, ones, W::moved(right, 128 * ones_wide * group + 256 * k));
                });
            W::end_products();
            W::template wait_for_products<0>();
            expanded<units * across>([&](auto i) { W::settle(sum[i / across][i % across]); });
            W::settle(of_ones);
            W::give(shared, place);
        }
        const U row = U(static_cast<std::uint32_t>(16 * (w % 4))) + W::lane() / U(4U),
                pair = W::lane() % U(4U);
        expanded<units * across*(wide / 4)>([&](auto i) {
            constexpr int h = decltype(i)::value % 2, j = decltype(i)::value / 2 % (wide / 8),
                          c = decltype(i)::value / (wide / 4) % across,
                          u = decltype(i)::value / (wide / 4 * across);
            const U at = row + U(static_cast<std::uint32_t>(64 * (group + groups * u) + 8 * h));
            W::write2_where(at < U(static_cast<std::uint32_t>(rows)), to + (wide * c + 8 * j),
                            at * U(std::uint32_t(n / 2)) + pair, sum[u][c][4 * j + 2 * h],
                            sum[u][c][4 * j + 2 * h + 1]);
        });
        if (with_ones && w % 4 == 0)
            expanded<ones_wide / 8>([&](auto j) {
                W::write2_where(W::lane() < U(4U), to + (rows * n + ones_wide * group + 8 * j),
                                pair, of_ones[4 * j], of_ones[4 * j + 1]);
            });
    }
};

/// Destination of a layer's gradient.
struct MlpGroupTarget {
    float* weight;  ///< out x (hidden + input + frame inputs); added to
    float* bias;    ///< added to
    float* sum;     ///< [out] sums of cotangents over points
    int out, first; ///< first block
};

/// Adds the slices, in their order, to the gradients of all layers' weights and biases.
struct MlpGroupMergeKernel {
    static constexpr const char* name = "merge of weights";
    static constexpr int threads = 128, blocks = 8;
    static constexpr int at_once = 8; ///< slices that are read together
    struct Shared {};
    MlpGroupWeightCut cut;
    const float* partial;
    int inputs; ///< of points
    MlpGroupTarget target[DeviceMlpNetwork::most_layers];
    int all; ///< blocks

    /// After the cut has all layers; weight, bias and sum of layer l, from the first on.
    void set(int l, const MlpGroupTarget& to) {
        if (l == 0) all = 0;
        target[l] = to;
        target[l].first = all;
        all += ((cut.layer[l].rows() + 1) * cut.layer[l].columns + threads - 1) / threads;
    }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        int l = 0;
        while (l + 1 < cut.layers && target[l + 1].first <= block.index()) ++l;
        const MlpGroupWeightLayer& layer = cut.layer[l];
        const MlpGroupTarget& to = target[l];
        const std::uint32_t count = cut.of.among(cut.points);
        const int used = rye::min(layer.slices, static_cast<int>((count + 63) / 64));
        const Index apart = Index(layer.tiles()) * layer.numbers();
        block.each_thread([&](int t) {
            const int number = (block.index() - to.first) * threads + t;
            const int row = number / layer.columns, o = number % layer.columns;
            if (o >= to.out || row > layer.rows()) return;
            const bool sums = row == layer.rows();
            const int input = row - layer.hidden_rows;
            if (!sums && input >= inputs) return;
            const int tile = sums ? 0 : row / layer.high;
            const int inside = sums ? rye::min(layer.high, layer.rows()) : row - tile * layer.high;
            const float* const from =
                partial + layer.number + Index(tile) * layer.numbers() + inside * layer.columns + o;
            float x = 0;
            for (int s = 0; s < used; s += at_once) {
                float part[std::size_t(at_once)];
                repeated<at_once>(
                    [&](auto k) { part[k] = s + k < used ? from[(s + k) * apart] : 0.0F; });
                repeated<at_once>([&](auto k) { x += part[k]; });
            }
            if (sums) {
                to.bias[o] += x;
                to.sum[o] = x;
            } else {
                to.weight[Index(row) * to.out + o] += x;
            }
        });
    }
};

} // namespace rye::detail
