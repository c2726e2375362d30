// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/convolution_weights.hpp: gradients of a convolution's weights: products over pixels
/// of the cotangent and of the image moved by each tap, over fixed slices of the pixels whose sums
/// are added in order. A block has 64 outputs by 32 inputs by nine taps, and takes 16 x 8 pixels,
/// or 16 x 4, at a time; while it multiplies, the next are on their way.
#pragma once

#include <algorithm>

#include <rye/backend/cuda/planes.hpp>
#include <rye/math/scalar.hpp>
#include <rye/nn/cuda/tile_quads.hpp>

namespace rye {

/// What the gradient of a convolution's weights is cut into.
struct ConvolutionSlices {
    static constexpr int wide = 16;             ///< pixels at a time, of a row
    static constexpr int high = 64, chunk = 32; ///< outputs and inputs of a block
    int width, height, inputs, outputs;         ///< of the convolution
    int tall;                                   ///< rows at a time
    int most;                                   ///< blocks that are aimed at

    RYE_HD int across() const { return (width + wide - 1) / wide; }
    RYE_HD int tiles() const { return across() * ((height + tall - 1) / tall); }
    RYE_HD int out_tiles() const { return (outputs + high - 1) / high; }
    RYE_HD int chunks() const { return (inputs + chunk - 1) / chunk; }
    /// Slices of the pixels: follows from shapes alone, so that sums keep their order.
    RYE_HD int count() const {
        const int aim = most / (out_tiles() * chunks());
        const int whole = rye::max(1, rye::min(aim, tiles()));
        return (tiles() + per_slice(whole) - 1) / per_slice(whole);
    }
    RYE_HD int per_slice() const { return per_slice(count()); }
    /// Numbers of the partial sums.
    std::size_t numbers() const {
        return static_cast<std::size_t>(count()) * 9 * static_cast<std::size_t>(chunks() * chunk) *
               static_cast<std::size_t>(out_tiles() * high);
    }

  private:
    RYE_HD int per_slice(int slices) const { return (tiles() + slices - 1) / slices; }
};

/// Partial sums of a slice.
template <int N>
struct ConvolutionWeightKernel {
    static constexpr const char* name = "convolution's weights";
    static constexpr int threads = 256, blocks = 1;
    using Cut = ConvolutionSlices;
    static constexpr int tall = N == 1 ? 8 : 4; ///< rows of pixels at a time
    static constexpr int around = Cut::wide + 2;
    using Image = TileShape<N, around, tall + 2, Cut::chunk / 8, Cut::chunk + 8>;
    using Cotangent = TileShape<N, Cut::wide, tall, Cut::high / 8, Cut::high + 8>;
    template <class Shape>
    struct Planed {
        alignas(16)
            std::uint16_t at[std::size_t(N)][std::size_t(Shape::rows)][std::size_t(Shape::stride)];
    };
    struct Shared {
        Planed<Image> image[2];
        Planed<Cotangent> g[2];
    };
    Cut cut;
    DeviceImagePlanes in, g; ///< of the inputs, of the cotangent of the outputs
    float* partial;          ///< slices x 9 x chunks() 32 x out_tiles() 64

    Index blocks_of() const { return Index(cut.out_tiles()) * cut.chunks() * cut.count(); }

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        const int slices = cut.count(), per_slice = cut.per_slice();
        const int s = block.index() % slices, part = block.index() / slices;
        const int chunk = part % cut.chunks(), first = part / cut.chunks() * Cut::high;
        const int begin = s * per_slice, end = rye::min(begin + per_slice, cut.tiles());
        auto sums = block.template of_warps<Sums<W>>();
        block.each_warp([&](int w) { sums[w].clear(); });
        block.each_warp([&](int w) {
            if (begin >= end) return;
            Next<W> next;
            next.read(*this, begin, chunk, first, w);
            next.write(shared, 0);
        });
        for (int tile = begin; tile < end; ++tile) {
            const int rest = cut.height - tile / cut.across() * tall, now = (tile - begin) % 2;
            block.each_warp([&](int w) {
                Next<W> next;
                if (tile + 1 < end) next.read(*this, tile + 1, chunk, first, w);
                if (works(chunk, first, w))
                    sums[w].add(shared.image[now], shared.g[now], rest < tall ? rest : tall, w);
                if (tile + 1 < end) next.write(shared, 1 - now);
            });
        }
        block.each_warp([&](int w) { write(sums[w], s, chunk, first, w); });
    }

  private:
    /// Whether a warp has outputs and inputs.
    RYE_DEVICE bool works(int chunk, int first, int w) const {
        return first + w / 4 * 32 < cut.outputs && chunk * Cut::chunk + w % 4 * 8 < cut.inputs;
    }
    /// A warp's share of the next pixels on their way.
    template <class W>
    struct Next {
        TileQuads<W, Image, Image::quads, threads> image;
        TileQuads<W, Cotangent, Cotangent::quads, threads> g;

        RYE_DEVICE void read(const ConvolutionWeightKernel& k, int tile, int chunk, int first,
                             int w) {
            const int x = tile % k.cut.across() * Cut::wide, y = tile / k.cut.across() * tall;
            image.read(k.in, {x, y, 1, chunk * (Cut::chunk / 8)}, 0, w);
            g.read(k.g, {x, y, 0, first / 8}, 0, w);
        }
        RYE_DEVICE void write(Shared& shared, int buffer) const {
            image.write(&shared.image[buffer].at[0][0][0]);
            g.write(&shared.g[buffer].at[0][0][0]);
        }
    };

    /// A warp's 32 outputs by 8 inputs by nine taps.
    template <class W>
    struct Sums {
        using F = typename W::F;
        using U = typename W::U;
        Array<F, 4> sum[2][9];

        RYE_DEVICE void clear() {
            expanded<2>([&](auto m) {
                expanded<9>([&](auto n) { expanded<4>([&](auto k) { sum[m][n][k] = F(0.0F); }); });
            });
        }
        RYE_DEVICE void add(const Planed<Image>& image, const Planed<Cotangent>& gs, int count,
                            int w) {
            for (int y = 0; y < count; ++y) {
                Planes<W, N, 4> left[2];
                expanded<2>([&](auto m) { left[m] = cotangent(gs, y, w / 4 * 2 + m); });
                expanded<5>([&](auto pair) {
                    const auto right = taps<2 * pair>(image, y, w % 4);
                    expanded<2>([&](auto m) {
                        multiply<W, N>(sum[m][2 * pair], left[m], right[0]);
                        if constexpr (2 * pair + 1 < 9)
                            multiply<W, N>(sum[m][2 * pair + 1], left[m], right[1]);
                    });
                });
            }
        }
        /// Sixteen outputs of a row of pixels, transposed.
        RYE_DEVICE static Planes<W, N, 4> cotangent(const Planed<Cotangent>& g, int y, int m) {
            const U matrix = W::lane() / U(8U);
            const U row =
                U(static_cast<std::uint32_t>(16 * y)) + matrix / U(2U) * U(8U) + W::lane() % U(8U);
            const U place = row * U(2U * Cotangent::stride) + matrix % U(2U) * U(16U) +
                            U(static_cast<std::uint32_t>(32 * m));
            Planes<W, N, 4> r;
            expanded<N>([&](auto p) { r[p] = W::template tiles<true>(&g.at[p][0][0], place); });
            return r;
        }
        /// Eight inputs of a row of pixels, moved by `tap` and by the next.
        template <int tap>
        RYE_DEVICE static Array<Planes<W, N, 2>, 2> taps(const Planed<Image>& image, int y,
                                                         int group) {
            constexpr int next = tap + 1 < 9 ? tap + 1 : tap;
            constexpr auto apart = static_cast<std::uint32_t>(offset(next) - offset(tap));
            const U matrix = W::lane() / U(8U);
            const U row = U(static_cast<std::uint32_t>(y * around + offset(tap))) +
                          matrix % U(2U) * U(8U) + W::lane() % U(8U) + matrix / U(2U) * U(apart);
            const U place = row * U(2U * Image::stride) + U(static_cast<std::uint32_t>(16 * group));
            Array<Planes<W, N, 2>, 2> r;
            expanded<N>([&](auto p) {
                const auto t = W::template tiles<true>(&image.at[p][0][0], place);
                r[0][p] = {{t[0], t[1]}};
                r[1][p] = {{t[2], t[3]}};
            });
            return r;
        }
        RYE_HD static constexpr int offset(int tap) { return tap / 3 * around + tap % 3; }
    };

    template <class W>
    RYE_DEVICE void write(const Sums<W>& sums, int s, int chunk, int first, int w) const {
        using U = typename W::U;
        const auto inputs = static_cast<std::uint32_t>(cut.chunks() * Cut::chunk);
        const auto outs = static_cast<std::uint32_t>(cut.out_tiles() * Cut::high);
        float* const to = partial + Index(s) * 9 * inputs * outs;
        expanded<2>([&](auto m) {
            expanded<9>([&](auto tap) {
                expanded<4>([&](auto k) {
                    const U o =
                        U(static_cast<std::uint32_t>(first + w / 4 * 32 + 16 * m + k / 2 * 8)) +
                        W::lane() / U(4U);
                    const U i =
                        U(static_cast<std::uint32_t>(tap) * inputs +
                          static_cast<std::uint32_t>(chunk * Cut::chunk + w % 4 * 8 + k % 2)) +
                        W::lane() % U(4U) * U(2U);
                    W::write(to, i * U(outs) + o, sums.sum[m][tap][k]);
                });
            });
        });
    }
};

/// Adds the slices, in their order, to the gradient of the weights.
struct ConvolutionMergeKernel {
    static constexpr const char* name = "merge of a convolution's weights";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {};
    ConvolutionSlices cut;
    const float* partial;
    float* weight; ///< outputs x 9 inputs; added to

    Index blocks_of() const {
        return (Index(9) * cut.inputs * cut.outputs + threads - 1) / threads;
    }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const Index at = Index(block.index()) * threads + t;
            const Index o = at % cut.outputs, i = at / cut.outputs % cut.inputs,
                        tap = at / cut.outputs / cut.inputs;
            if (tap >= 9) return;
            const Index inputs = cut.chunks() * ConvolutionSlices::chunk,
                        outs = cut.out_tiles() * ConvolutionSlices::high;
            const float* const from = partial + (tap * inputs + i) * outs + o;
            const int slices = cut.count();
            double sum = 0;
            for (int s = 0; s < slices; ++s)
                sum += static_cast<double>(from[s * 9 * inputs * outs]);
            weight[at] += static_cast<float>(sum);
        });
    }
};

} // namespace rye
