// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/convolution_weights.hpp: gradients of a convolution's weights: products over pixels
/// of the cotangent and of the image moved by each tap, over fixed slices of the pixels whose sums
/// are added in order. A block has 64 outputs by 32 inputs by nine taps, 16 x 8 pixels at a time.
#pragma once

#include <algorithm>

#include <rye/backend/cuda/planes.hpp>
#include <rye/math/scalar.hpp>
#include <rye/nn/cuda/image_planes.hpp>

namespace rye {

/// What the gradient of a convolution's weights is cut into.
struct ConvolutionSlices {
    static constexpr int wide = 16, tall = 8;         ///< pixels at a time
    static constexpr int high = 64, chunk = 32;       ///< outputs and inputs of a block
    static constexpr int most = 256;                  ///< blocks that are aimed at
    int width, height, inputs, outputs;               ///< of the convolution

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
    static constexpr int threads = 256, blocks = 2;
    using Cut = ConvolutionSlices;
    static constexpr int around = Cut::wide + 2, rows = around * (Cut::tall + 2);
    static constexpr int in_stride = Cut::chunk + 8, g_stride = Cut::high + 8;
    struct Shared {
        alignas(16) std::uint16_t image[std::size_t(N)][std::size_t(rows)][std::size_t(in_stride)];
        alignas(16) std::uint16_t g[std::size_t(N)][std::size_t(Cut::wide * Cut::tall)]
                                   [std::size_t(g_stride)];
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
        for (int tile = begin; tile < end; ++tile) {
            const Corner corner{tile % cut.across() * Cut::wide, tile / cut.across() * Cut::tall};
            block.each_thread([&](int t) {
                fetch_image(shared, corner, chunk, t);
                fetch_cotangent(shared, corner, first, t);
            });
            block.each_warp([&](int w) {
                if (works(chunk, first, w))
                    sums[w].add(shared, rye::min(Cut::tall, cut.height - corner.y), w);
            });
        }
        block.each_warp([&](int w) { write(sums[w], s, chunk, first, w); });
    }

  private:
    struct Corner {
        int x, y;
    };
    /// Whether a warp has outputs and inputs.
    RYE_DEVICE bool works(int chunk, int first, int w) const {
        return first + w / 4 * 32 < cut.outputs && chunk * Cut::chunk + w % 4 * 8 < cut.inputs;
    }
    RYE_DEVICE static Quad4 quad_of(const DeviceImagePlanes& from, int plane, int x, int y, int c) {
        if (x < 0 || x >= from.width || y < 0 || y >= from.height || c >= from.padded())
            return {0, 0, 0, 0};
        const Index pixel = plane * from.pixels() + Index(y) * from.width + x;
        return *reinterpret_cast<const Quad4*>(from.data + pixel * from.padded() + c);
    }
    RYE_DEVICE void fetch_image(Shared& shared, const Corner& corner, int chunk, int t) const {
        constexpr int quads = Cut::chunk / 8;
        for (int k = t; k < N * rows * quads; k += threads) {
            const int plane = k / (rows * quads), row = k / quads % rows, c = k % quads * 8;
            *reinterpret_cast<Quad4*>(&shared.image[plane][row][c]) =
                quad_of(in, plane, corner.x + row % around - 1, corner.y + row / around - 1,
                        chunk * Cut::chunk + c);
        }
    }
    RYE_DEVICE void fetch_cotangent(Shared& shared, const Corner& corner, int first, int t) const {
        constexpr int quads = Cut::high / 8, pixels = Cut::wide * Cut::tall;
        for (int k = t; k < N * pixels * quads; k += threads) {
            const int plane = k / (pixels * quads), row = k / quads % pixels, c = k % quads * 8;
            *reinterpret_cast<Quad4*>(&shared.g[plane][row][c]) =
                quad_of(g, plane, corner.x + row % Cut::wide, corner.y + row / Cut::wide,
                        first + c);
        }
    }

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
        RYE_DEVICE void add(const Shared& shared, int tall, int w) {
            for (int y = 0; y < tall; ++y) {
                Planes<W, N, 4> left[2];
                expanded<2>([&](auto m) { left[m] = cotangent(shared, y, w / 4 * 2 + m); });
                expanded<5>([&](auto pair) {
                    const auto right = taps<2 * pair>(shared, y, w % 4);
                    expanded<2>([&](auto m) {
                        multiply<W, N>(sum[m][2 * pair], left[m], right[0]);
                        if constexpr (2 * pair + 1 < 9)
                            multiply<W, N>(sum[m][2 * pair + 1], left[m], right[1]);
                    });
                });
            }
        }
        /// Sixteen outputs of a row of pixels, transposed.
        RYE_DEVICE static Planes<W, N, 4> cotangent(const Shared& shared, int y, int m) {
            const U matrix = W::lane() / U(8U);
            const U row = U(static_cast<std::uint32_t>(16 * y)) + matrix / U(2U) * U(8U) +
                          W::lane() % U(8U);
            const U place = row * U(2U * g_stride) + matrix % U(2U) * U(16U) +
                            U(static_cast<std::uint32_t>(32 * m));
            Planes<W, N, 4> r;
            expanded<N>(
                [&](auto p) { r[p] = W::template tiles<true>(&shared.g[p][0][0], place); });
            return r;
        }
        /// Eight inputs of a row of pixels, moved by `tap` and by the next.
        template <int tap>
        RYE_DEVICE static Array<Planes<W, N, 2>, 2> taps(const Shared& shared, int y, int group) {
            constexpr int next = tap + 1 < 9 ? tap + 1 : tap;
            constexpr auto apart = static_cast<std::uint32_t>(offset(next) - offset(tap));
            const U matrix = W::lane() / U(8U);
            const U row = U(static_cast<std::uint32_t>(y * around + offset(tap))) +
                          matrix % U(2U) * U(8U) + W::lane() % U(8U) + matrix / U(2U) * U(apart);
            const U place = row * U(2U * in_stride) + U(static_cast<std::uint32_t>(16 * group));
            Array<Planes<W, N, 2>, 2> r;
            expanded<N>([&](auto p) {
                const auto t = W::template tiles<true>(&shared.image[p][0][0], place);
                r[0][p] = {{t[0], t[1]}};
                r[1][p] = {{t[2], t[3]}};
            });
            return r;
        }
        static constexpr int offset(int tap) { return tap / 3 * around + tap % 3; }
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
                    const U o = U(static_cast<std::uint32_t>(first + w / 4 * 32 + 16 * m +
                                                             k / 2 * 8)) +
                                W::lane() / U(4U);
                    const U i = U(static_cast<std::uint32_t>(tap) * inputs +
                                  static_cast<std::uint32_t>(chunk * Cut::chunk + w % 4 * 8 +
                                                             k % 2)) +
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
