// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/convolution_weights.hpp: gradients of a convolution's weights: products over pixels
/// of the cotangent and of the image moved by each tap, over fixed slices of the pixels whose sums
/// are added in order. A block has 32 or 64 outputs by 32 or 64 inputs by nine taps; a warp 32
/// outputs by 16 inputs, of all pixels or of some rows of each tile. What a warp reads of a row of
/// the image, moved by a tap's column, is multiplied by the three rows of the cotangent that its
/// taps belong to, which stay in registers. While a tile is multiplied, the next is copied.
#pragma once

#include <algorithm>

#include <rye/backend/cuda/planes.hpp>
#include <rye/math/scalar.hpp>
#include <rye/nn/cuda/tile_copies.hpp>

namespace rye {

/// Slices of the gradient of a convolution's weights.
struct ConvolutionSlices {
    static constexpr int across_tile = 16; ///< pixels of a tile, of a row
    static constexpr int aim = 132;        ///< blocks: one for each unit of the largest devices
    int width, height, inputs, outputs;    ///< extents of the convolution
    int planes;                            ///< number of planes of a float
    int most = aim;                        ///< blocks that are aimed at

    /// Outputs and inputs of a block, rows of a tile.
    RYE_HD int high() const { return planes == 1 && outputs > 32 ? 64 : 32; }
    RYE_HD int wide() const { return planes == 1 && inputs > 32 ? 64 : 32; }
    RYE_HD int tall() const { return planes == 1 && outputs <= 32 && inputs <= 32 ? 16 : 8; }
    RYE_HD int across() const { return (width + across_tile - 1) / across_tile; }
    RYE_HD int tiles() const { return across() * ((height + tall() - 1) / tall()); }
    RYE_HD int out_tiles() const { return (outputs + high() - 1) / high(); }
    RYE_HD int in_tiles() const { return (inputs + wide() - 1) / wide(); }
    RYE_HD int pairs() const { return out_tiles() * in_tiles(); }
    /// Numbers of a slice.
    RYE_HD Index of_slice() const { return Index(9) * pairs() * high() * wide(); }
    /// Slices of the pixels, every count()-th tile: follows from shapes alone, so that sums keep
    /// their order.
    RYE_HD int count() const {
        const int whole = rye::max(1, rye::min(most / pairs(), tiles()));
        const int share = (tiles() + whole - 1) / whole;
        return (tiles() + share - 1) / share;
    }
    /// Numbers of the partial sums.
    std::size_t numbers() const {
        return static_cast<std::size_t>(count()) * static_cast<std::size_t>(of_slice());
    }

    /// A weight: its output, its tap and its input.
    struct Weight {
        int output, tap, input;
    };
    /// Returns the weight of a slice's number: slices hold the sums of a warp's lanes, in the order
    /// of ConvolutionWeightKernel.
    RYE_HD Weight weight(std::uint32_t number) const {
        const auto lane = static_cast<int>(number % 32), half = static_cast<int>(number / 32 % 4),
                   n = static_cast<int>(number / 128 % 2), tap = static_cast<int>(number / 256 % 9);
        const int operands = planes == 1 ? 2 : 1, beside = wide() / 16,
                  groups = high() / (16 * operands) * beside;
        const auto rest = static_cast<int>(number / (256 * 9));
        const int m = rest % operands, group = rest / operands % groups,
                  pair = rest / operands / groups;
        return {pair / in_tiles() * high() + group / beside * 16 * operands + 16 * m +
                    half / 2 * 8 + lane / 4,
                tap,
                pair % in_tiles() * wide() + group % beside * 16 + 8 * n + half % 2 + lane % 4 * 2};
    }
};

namespace detail {

/// Partial sums of a slice, `high` outputs by `wide` inputs a block.
template <int N, int high, int wide>
struct ConvolutionWeightKernel {
    static constexpr const char* name = "convolution's weights";
    static constexpr int threads = 256, blocks = 1;
    using Cut = ConvolutionSlices;
    static constexpr int operands = N == 1 ? 2 : 1; ///< operands of 16 outputs a warp
    static constexpr int beside_outputs = high / (16 * operands), beside_inputs = wide / 16;
    static constexpr int groups = beside_outputs * beside_inputs;
    static constexpr int parts = threads / 32 / groups; ///< warps that share outputs and inputs
    static constexpr int tall = N == 1 && high == 32 && wide == 32 ? 16 : 8;
    static constexpr int rows = tall / parts; ///< rows of a warp
    static_assert(parts * groups * 32 == threads && rows * parts == tall);
    using Image = TileShape<N, Cut::across_tile + 2, tall + 2, wide / 8>;
    using Cotangent = TileShape<N, Cut::across_tile, tall, high / 8>;
    struct Stage {
        typename Image::Numbers image;
        typename Cotangent::Numbers g;
    };
    static constexpr int sums_of_lane = operands * 2 * 9 * 4;
    union Shared {
        Stage stage[2];
        float sum[std::size_t(groups)][std::size_t(sums_of_lane)][32]; ///< a part, at the end
    };
    Cut cut;
    DeviceImagePlanes in, g; ///< inputs, cotangent of the outputs
    float* partial;          ///< [blocks] groups x sums of a lane x 32

    Index blocks_of() const { return Index(cut.pairs()) * cut.count(); }

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        const int pairs = cut.pairs(), slices = cut.count();
        const int s = block.index() / pairs, pair = block.index() % pairs;
        const Corner c{pair / cut.in_tiles() * high, pair % cut.in_tiles() * wide};
        const int tiles = cut.tiles();
        auto sums = block.template of_warps<Sums<W>>();
        block.each_warp([&](int w) {
            sums[w].clear();
            fetch<W>(shared.stage[0], s, c, w);
            W::end_copies();
            W::template wait_for_copies<0>();
        });
        int now = 0;
        for (int tile = s; tile < tiles; tile += slices) {
            block.each_warp([&](int w) {
                if (tile + slices < tiles) fetch<W>(shared.stage[1 - now], tile + slices, c, w);
                W::end_copies();
                if (works(c, w)) sums[w].add(shared.stage[now], w);
                W::template wait_for_copies<0>();
            });
            now = 1 - now;
        }
        for (int part = parts - 1; part > 0; --part) {
            block.each_warp([&](int w) {
                if (w / groups == part) sums[w].store(&shared.sum[w % groups][0][0]);
            });
            block.each_warp([&](int w) {
                if (w / groups == part - 1) sums[w].take(&shared.sum[w % groups][0][0]);
            });
        }
        block.each_warp([&](int w) {
            if (w < groups)
                sums[w].store(partial + (Index(block.index()) * groups + w) * sums_of_lane * 32);
        });
    }

  private:
    /// First output and first input of a block.
    struct Corner {
        int output, input;
    };
    /// Return the first output and input of a warp, within a block.
    RYE_DEVICE static int first_output(int w) {
        return w % groups / beside_inputs * (16 * operands);
    }
    RYE_DEVICE static int first_input(int w) { return w % beside_inputs * 16; }
    /// Returns true if a warp has outputs and inputs.
    RYE_DEVICE bool works(const Corner& c, int w) const {
        return c.output + first_output(w) < cut.outputs && c.input + first_input(w) < cut.inputs;
    }
    template <class W>
    RYE_DEVICE void fetch(Stage& to, int tile, const Corner& c, int w) const {
        const int x = tile % cut.across() * Cut::across_tile, y = tile / cut.across() * tall;
        copy_tile<W, Image, threads>(in, {x, y, 1, c.input / 8}, to.image, {{0, Image::rows}}, w);
        copy_tile<W, Cotangent, threads>(g, {x, y, 0, c.output / 8}, to.g, {{0, Cotangent::rows}},
                                         w);
    }

    /// A warp's sums.
    template <class W>
    struct Sums {
        using F = typename W::F;
        using U = typename W::U;
        Array<F, 4> sum[std::size_t(operands)][9][2];

        template <class F2>
        RYE_DEVICE void each(const F2& f) {
            repeated<operands>([&](auto m) {
                repeated<9>([&](auto tap) {
                    repeated<2>([&](auto n) {
                        repeated<4>(
                            [&](auto k) { f(((m * 9 + tap) * 2 + n) * 4 + k, sum[m][tap][n][k]); });
                    });
                });
            });
        }
        RYE_DEVICE void clear() {
            each([](int, F& x) { x = F(0.0F); });
        }
        RYE_DEVICE void store(float* to) {
            each([&](int i, F& x) { W::write(to + 32 * i, W::lane(), x); });
        }
        RYE_DEVICE void take(const float* from) {
            each([&](int i, F& x) { x = x + W::read(from + 32 * i, W::lane()); });
        }
        /// += the products over the warp's rows of a tile.
        RYE_DEVICE void add(const Stage& stage, int w) {
            const int part = w / groups;
            Planes<W, N, 4> left[3][std::size_t(operands)];
            expanded<rows + 2>([&](auto r) {
                if constexpr (r < rows)
                    repeated<operands>([&](auto m) {
                        left[r % 3][m] =
                            cotangent(stage.g, part * rows + r, first_output(w) / 8 + 2 * m);
                    });
                expanded<3>([&](auto column) {
                    const auto right = taps(stage.image, part * rows + r, column, first_input(w));
                    expanded<3>([&](auto down) {
                        constexpr int row = decltype(r)::value - decltype(down)::value;
                        constexpr int tap = 3 * decltype(down)::value + decltype(column)::value;
                        if constexpr (row >= 0 && row < rows)
                            repeated<operands>([&](auto m) {
                                repeated<2>([&](auto n) {
                                    multiply<W, N>(sum[m][tap][n], left[row % 3][m], right[n]);
                                });
                            });
                    });
                });
            });
        }
        /// Sixteen outputs, from 8 group on, of a row of pixels, transposed.
        RYE_DEVICE static Planes<W, N, 4> cotangent(const typename Cotangent::Numbers& g, int y,
                                                    int group) {
            const U matrix = W::lane() / U(8U);
            const U x = matrix / U(2U) * U(8U) + W::lane() % U(8U);
            const U own = U(static_cast<std::uint32_t>(group)) + matrix % U(2U);
            const U at = x * U(Cotangent::pixel_bytes) + Cotangent::swapped(own, x) * U(16U) +
                         U(static_cast<std::uint32_t>(y * Cotangent::row_bytes));
            Planes<W, N, 4> r;
            repeated<N>([&](auto p) { r[p] = W::template tiles<true>(&g.at[p][0], at); });
            return r;
        }
        /// Twice eight inputs of a row of pixels, moved by a column of taps.
        RYE_DEVICE static Array<Planes<W, N, 2>, 2> taps(const typename Image::Numbers& image,
                                                         int y, int column, int input) {
            const U matrix = W::lane() / U(8U);
            const U x =
                matrix % U(2U) * U(8U) + W::lane() % U(8U) + U(static_cast<std::uint32_t>(column));
            const U own = U(static_cast<std::uint32_t>(input / 8)) + matrix / U(2U);
            const U at = x * U(Image::pixel_bytes) + Image::swapped(own, x) * U(16U) +
                         U(static_cast<std::uint32_t>(y * Image::row_bytes));
            Array<Planes<W, N, 2>, 2> r;
            repeated<N>([&](auto p) {
                const auto t = W::template tiles<true>(&image.at[p][0], at);
                r[0][p] = {{t[0], t[1]}};
                r[1][p] = {{t[2], t[3]}};
            });
            return r;
        }
    };
};

/// Adds the slices, in a fixed order, to the gradient of the weights.
struct ConvolutionMergeKernel {
    static constexpr const char* name = "merge of a convolution's weights";
    static constexpr int threads = 256, blocks = 4;
    static constexpr int of_block = 32, ways = threads / of_block; ///< weights; ways to add
    static constexpr int at_once = 4; ///< slices that are read together
    struct Shared {
        double sum[std::size_t(ways)][std::size_t(of_block)];
    };
    ConvolutionSlices cut;
    const float* partial;
    float* weight; ///< outputs x 9 inputs; added to

    Index blocks_of() const { return (cut.of_slice() + of_block - 1) / of_block; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index of_slice = cut.of_slice();
        block.each_thread([&](int t) {
            const Index at = Index(block.index()) * of_block + t % of_block;
            const int way = t / of_block, slices = cut.count();
            double sum = 0;
            for (int s = way; s < slices; s += ways * at_once) {
                float part[std::size_t(at_once)];
                repeated<at_once>([&](auto k) {
                    part[k] =
                        s + k * ways < slices ? partial[(s + k * ways) * of_slice + at] : 0.0F;
                });
                repeated<at_once>([&](auto k) { sum += static_cast<double>(part[k]); });
            }
            shared.sum[way][t % of_block] = sum;
        });
        block.each_thread([&](int t) {
            if (t >= of_block) return;
            const auto at = cut.weight(static_cast<std::uint32_t>(block.index() * of_block + t));
            if (at.output >= cut.outputs || at.input >= cut.inputs) return;
            double sum = 0;
            for (int way = 0; way < ways; ++way) sum += shared.sum[way][t];
            weight[(Index(at.tap) * cut.inputs + at.input) * cut.outputs + at.output] +=
                static_cast<float>(sum);
        });
    }
};

} // namespace detail

} // namespace rye
