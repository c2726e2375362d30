// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/upsampler_kernels.hpp: the last layer of nn/upsampler.hpp for images in device
/// memory: a 1 x 1 convolution and a sigmoid, or the odds of the upsampled first channels; and what
/// passes those channels by the network.
#pragma once

#include <rye/math/scalar.hpp>
#include <rye/nn/activations.hpp>
#include <rye/nn/cuda/image_planes.hpp>

namespace rye::detail {

/// The first three channels of a source's image.
template <class Source>
struct FirstChannelsKernel {
    static constexpr const char* name = "first channels";
    static constexpr int threads = 256, blocks = 4;
    struct Shared {};
    Source source;
    int width, height;
    float* to; ///< 3 x pixels

    Index blocks_of() const { return (Index(width) * height + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const Index j = Index(block.index()) * threads + t;
            if (j >= Index(width) * height) return;
            const auto pixel =
                source.pixel(static_cast<int>(j % width), static_cast<int>(j / width));
            for (int c = 0; c < 3; ++c) to[3 * j + c] = pixel.at(c);
        });
    }
};

/// Adds an image of three channels to the first three of another.
struct AddChannelsKernel {
    static constexpr const char* name = "added channels";
    static constexpr int threads = 256, blocks = 4;
    struct Shared {};
    const float* from; ///< 3 x pixels
    Index pixels;
    int channels;
    float* to; ///< channels x pixels

    Index blocks_of() const { return (3 * pixels + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const Index i = Index(block.index()) * threads + t;
            if (i < 3 * pixels) to[i / 3 * channels + i % 3] += from[i];
        });
    }
};

/// Inputs of the last layer.
struct LastLayer {
    ActivatedPixels below;
    Index pixels;
    const float *weight, *bias; ///< 3 x channels, 3
    const float* base;          ///< 3 x pixels, or null without skip
};

/// 256 pixels a block, 32 a warp; eight lanes have a pixel, four channels each of 32 at a time, so
/// that what they read lies side by side.
struct LastLayerLanes {
    static constexpr int threads = 256, warps = threads / 32, chunk = 32;
    static constexpr int at_once = 4, turns = 32 / at_once; ///< pixels of a warp

    /// A lane's four channels from `first` on: weights, and what the layer below is normalised by.
    template <class W>
    struct Channels {
        using F = typename W::F;
        using U = typename W::U;
        U first;
        F weight[4][3], mean[4], gain[4];

        RYE_DEVICE Channels(const LastLayer& layer, int chunk_first)
            : first(U(static_cast<std::uint32_t>(chunk_first)) + W::lane() % U(8U) * U(4U)) {
            const U all(static_cast<std::uint32_t>(layer.below.channels));
            const DeviceNorm& norm = layer.below.norm;
            repeated<4>([&](auto k) {
                const U c = first + U(std::uint32_t(k));
                const auto there = c < all;
                repeated<3>([&](auto r) {
                    weight[k][r] =
                        W::read_where(there, layer.weight, c * U(3U) + U(std::uint32_t(r)), 0.0F);
                });
                if (norm.mean != nullptr) {
                    mean[k] = W::read_where(there, norm.mean, c, 0.0F);
                    gain[k] = W::read_where(there, norm.gain, c, 0.0F);
                }
            });
        }
        /// Returns the layer below at a pixel, activated; 0 outside.
        RYE_DEVICE Array<F, 4> read(const LastLayer& layer, Index block, const U& pixel) const {
            const int all = layer.below.channels;
            const Index begin = block * threads;
            const float* const from = layer.below.from + begin * all;
            const auto there =
                pixel <
                U(static_cast<std::uint32_t>(rye::min(layer.pixels - begin, Index(threads))));
            const U at = pixel * U(static_cast<std::uint32_t>(all)) + first;
            Array<F, 4> x;
            if (all % 4 == 0)
                x = W::read4_where(there && first < U(static_cast<std::uint32_t>(all)),
                                   reinterpret_cast<const Quad4*>(from), at / U(4U));
            else
                repeated<4>([&](auto k) {
                    x[k] = W::read_where(
                        there && first + U(std::uint32_t(k)) < U(static_cast<std::uint32_t>(all)),
                        from, at + U(std::uint32_t(k)), 0.0F);
                });
            repeated<4>([&](auto k) {
                if (layer.below.norm.mean != nullptr) x[k] = normalized(x[k], mean[k], gain[k]);
                x[k] = relu(F(x[k]));
            });
            return x;
        }
    };
    /// A lane's pixel within the block.
    template <class W>
    RYE_DEVICE static typename W::U pixel(int w, int turn) {
        using U = typename W::U;
        return U(static_cast<std::uint32_t>(32 * w + at_once * turn)) + W::lane() / U(8U);
    }
};

/// The picture.
struct LastLayerKernel : LastLayerLanes {
    static constexpr const char* name = "last layer";
    static constexpr int blocks = 4;
    struct Shared {
        float z[3 * threads];
    };
    LastLayer layer;
    float* out; ///< 3 x pixels

    Index blocks_of() const { return (layer.pixels + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        using F = typename W::F;
        using U = typename W::U;
        block.each_warp([&](int w) {
            F z[turns][3];
            for (auto& of_turn : z)
                for (F& x : of_turn) x = F(0.0F);
            for (int first = 0; first < layer.below.channels; first += chunk) {
                const Channels<W> own(layer, first);
                repeated<turns>([&](auto turn) {
                    const auto x = own.read(layer, block.index(), pixel<W>(w, turn));
                    repeated<4>([&](auto k) {
                        repeated<3>(
                            [&](auto r) { z[turn][r] = z[turn][r] + own.weight[k][r] * x[k]; });
                    });
                });
            }
            repeated<turns>([&](auto turn) {
                repeated<3>([&](auto r) {
                    F sum = z[turn][r];
                    sum = sum + W::template across<1>(sum);
                    sum = sum + W::template across<2>(sum);
                    sum = sum + W::template across<4>(sum);
                    W::write_where(W::lane() % U(8U) < U(1U), shared.z,
                                   pixel<W>(w, turn) * U(3U) + U(std::uint32_t(r)), sum);
                });
            });
        });
        block.each_thread([&](int t) {
            const Index first = Index(block.index()) * threads;
            for (int i = t; i < 3 * threads; i += threads) {
                if (first + i / 3 >= layer.pixels) return;
                const float v = shared.z[i] + layer.bias[i % 3];
                const Index at = 3 * first + i;
                out[at] = layer.base != nullptr
                              ? detail::odds_sigmoid(detail::clamped_base(layer.base[at]), v)
                              : sigmoid(v);
            }
        });
    }
};

/// Cotangents of the layer below and of the base, and partial sums of those of the weights.
struct LastLayerVjpKernel : LastLayerLanes {
    static constexpr const char* name = "last layer, reverse";
    static constexpr int blocks = 4;
    struct Shared {
        float g[3 * threads];
        float sum[warps][12][32]; ///< sums of each lane: its channels' cotangents
        double of_bias[3][32];
    };
    LastLayer layer;
    const float *out, *g_out; ///< 3 x pixels
    float* g_below;           ///< channels x pixels, of relu's output
    float* g_base;            ///< 3 x pixels; not written without skip
    double* partial;          ///< [blocks] 3 x channels, then 3

    Index blocks_of() const { return (layer.pixels + threads - 1) / threads; }
    RYE_HD int numbers() const { return 3 * (layer.below.channels + 1); }

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        const Index begin = Index(block.index()) * threads;
        double* const to = partial + Index(block.index()) * numbers();
        block.each_thread([&](int t) {
            for (int i = t; i < 3 * threads; i += threads) {
                const Index at = 3 * begin + i;
                const bool there = begin + i / 3 < layer.pixels;
                const float g = there ? g_out[at] * sigmoid_slope(out[at]) : 0.0F;
                shared.g[i] = g;
                if (there && layer.base != nullptr)
                    g_base[at] = detail::clamped_base_vjp(layer.base[at], g);
            }
        });
        for (int first = 0; first < layer.below.channels; first += chunk) {
            block.each_warp([&](int w) { pull<W>(shared, block.index(), first, w); });
            block.each_thread([&](int t) {
                // Number t of the chunk: row r of channel c.
                const int c = t / 3, r = t % 3;
                if (c >= chunk || first + c >= layer.below.channels) return;
                double sum = 0;
                for (int w = 0; w < warps; ++w)
                    repeated<at_once>([&](auto k) {
                        sum += static_cast<double>(shared.sum[w][c % 4 * 3 + r][8 * k + c / 4]);
                    });
                to[3 * (first + c) + r] = sum;
            });
        }
        block.each_thread([&](int t) {
            if (t >= 96) return;
            double sum = 0;
            for (int k = 0; k < threads / 32; ++k)
                sum += static_cast<double>(shared.g[3 * (t / 3 + 32 * k) + t % 3]);
            shared.of_bias[t % 3][t / 3] = sum;
        });
        block.each_thread([&](int t) {
            if (t >= 3) return;
            double sum = 0;
            for (int k = 0; k < 32; ++k) sum += shared.of_bias[t][k];
            to[3 * layer.below.channels + t] = sum;
        });
    }

  private:
    /// A warp's pixels through 32 channels.
    template <class W>
    RYE_DEVICE void pull(Shared& shared, Index block, int first, int w) const {
        using F = typename W::F;
        using U = typename W::U;
        const Channels<W> own(layer, first);
        const int all = layer.below.channels;
        float* const to = g_below + block * threads * all;
        const U count(
            static_cast<std::uint32_t>(rye::min(layer.pixels - block * threads, Index(threads))));
        F sum[12];
        for (F& x : sum) x = F(0.0F);
        repeated<turns>([&](auto turn) {
            const U pixel_of = pixel<W>(w, turn);
            const auto x = own.read(layer, block, pixel_of);
            F g[3];
            repeated<3>(
                [&](auto r) { g[r] = W::read(shared.g, pixel_of * U(3U) + U(std::uint32_t(r))); });
            Array<F, 4> below;
            repeated<4>([&](auto k) {
                below[k] = F(0.0F);
                repeated<3>([&](auto r) {
                    below[k] = below[k] + own.weight[k][r] * g[r];
                    sum[3 * k + r] = W::fma(g[r], x[k], sum[3 * k + r]);
                });
            });
            const U channels(static_cast<std::uint32_t>(all)), at = pixel_of * channels + own.first;
            if (all % 4 == 0)
                W::write4_where(pixel_of < count && own.first < channels,
                                reinterpret_cast<Quad4*>(to), at / U(4U), below);
            else
                repeated<4>([&](auto k) {
                    const U c(static_cast<std::uint32_t>(k));
                    W::write_where(pixel_of < count && own.first + c < channels, to, at + c,
                                   below[k]);
                });
        });
        repeated<12>([&](auto i) { W::write(&shared.sum[w][i][0], W::lane(), sum[i]); });
    }
};

} // namespace rye::detail
