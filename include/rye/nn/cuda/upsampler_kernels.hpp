// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/upsampler_kernels.hpp: the last layer of nn/upsampler.hpp for images in device
/// memory: a 1 x 1 convolution and a sigmoid, or the odds of the upsampled first channels; and what
/// passes those channels by the network.
#pragma once

#include <rye/math/scalar.hpp>
#include <rye/nn/activations.hpp>
#include <rye/nn/cuda/image_planes.hpp>

namespace rye {

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

/// What the last layer reads.
struct LastLayer {
    ActivatedPixels below;
    Index pixels;
    const float *weight, *bias; ///< 3 x channels, 3
    const float* base;          ///< 3 x pixels, or null without skip
};

/// The picture, a pixel a thread.
struct LastLayerKernel {
    static constexpr const char* name = "last layer";
    static constexpr int threads = 256, blocks = 4;
    struct Shared {};
    LastLayer layer;
    float* out; ///< 3 x pixels

    Index blocks_of() const { return (layer.pixels + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const Index j = Index(block.index()) * threads + t;
            if (j >= layer.pixels) return;
            const ActivatedPixels& below = layer.below;
            const ActivatedPixels::Pixel pixel{below.from + j * below.channels, below.norm};
            float z[3] = {0, 0, 0};
            for (int c = 0; c < below.channels; ++c) {
                const float h = pixel.at(c);
                for (int r = 0; r < 3; ++r) z[r] += layer.weight[3 * c + r] * h;
            }
            for (int r = 0; r < 3; ++r) {
                const float v = z[r] + layer.bias[r];
                out[3 * j + r] =
                    layer.base != nullptr
                        ? detail::odds_sigmoid(detail::clamped_base(layer.base[3 * j + r]), v)
                        : sigmoid(v);
            }
        });
    }
};

/// Cotangents of the layer below and of the base, and partial sums of those of the weights.
struct LastLayerVjpKernel {
    static constexpr const char* name = "last layer, reverse";
    static constexpr int threads = 256, blocks = 4;
    static constexpr Index chunk = threads; ///< pixels
    struct Shared {
        float g[threads][3];
    };
    LastLayer layer;
    const float *out, *g_out; ///< 3 x pixels
    float* g_below;           ///< channels x pixels, of relu's output
    float* g_base;            ///< 3 x pixels; not written without skip
    double* partial;          ///< of a chunk: 3 x channels, then 3

    Index blocks_of() const { return (layer.pixels + chunk - 1) / chunk; }
    RYE_HD int numbers() const { return 3 * (layer.below.channels + 1); }

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index first = block.index() * chunk;
        const ActivatedPixels& below = layer.below;
        block.each_thread([&](int t) {
            const Index j = first + t;
            if (j >= layer.pixels) return;
            float g[3];
            for (int r = 0; r < 3; ++r) {
                g[r] = g_out[3 * j + r] * sigmoid_slope(out[3 * j + r]);
                shared.g[t][r] = g[r];
                if (layer.base != nullptr)
                    g_base[3 * j + r] = detail::clamped_base_vjp(layer.base[3 * j + r], g[r]);
            }
            for (int c = 0; c < below.channels; ++c) {
                float sum = 0;
                for (int r = 0; r < 3; ++r) sum += layer.weight[3 * c + r] * g[r];
                g_below[j * below.channels + c] = sum;
            }
        });
        const Index rest = layer.pixels - first;
        const int count = static_cast<int>(rest < chunk ? rest : chunk);
        block.each_thread([&](int t) {
            for (int i = t; i < numbers(); i += threads) {
                const int c = i / 3, r = i % 3;
                double sum = 0;
                for (int j = 0; j < count; ++j) {
                    float h = 1;
                    if (c < below.channels) {
                        const ActivatedPixels::Pixel pixel{
                            below.from + (first + j) * below.channels, below.norm};
                        h = pixel.at(c);
                    }
                    sum += static_cast<double>(shared.g[j][r] * h);
                }
                partial[Index(block.index()) * numbers() + i] = sum;
            }
        });
    }
};

} // namespace rye
