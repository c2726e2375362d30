// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/image_planes.hpp: images in device memory as the products of a convolution read
/// them: a pixel's channels as N planes of bf16, in whole groups of 32. What makes a pixel (a copy,
/// the normalisation and ReLU of the layer below, that doubled in size, a cotangent through them)
/// is part of the kernel that splits it, so none of it passes through memory as floats.
#pragma once

#include <cstdint>
#include <vector>

#include <rye/backend/cuda.hpp>
#include <rye/backend/cuda/unrolled.hpp>
#include <rye/core/error.hpp>
#include <rye/nn/activations.hpp>
#include <rye/nn/bilinear.hpp>
#include <rye/nn/features.hpp>
#include <rye/nn/instance_norm.hpp>

namespace rye {

namespace detail {

/// x in whole groups of 32.
RYE_HD constexpr int padded_32(int x) { return (x + 31) / 32 * 32; }

} // namespace detail

/// Planes of an image: number c of pixel j and plane p is data[(p pixels + j) padded_32(channels) +
/// c], zero from `channels` on.
struct DeviceImagePlanes {
    std::uint16_t* data = nullptr;
    int width = 0, height = 0, channels = 0;

    RYE_HD Index pixels() const { return Index(width) * height; }
    RYE_HD int padded() const { return detail::padded_32(channels); }
    std::size_t halves(int planes) const {
        return static_cast<std::size_t>(planes) * static_cast<std::size_t>(pixels()) *
               static_cast<std::size_t>(padded());
    }
};

namespace detail {

/// Eight numbers.
using Eight = Array<float, 8>;

/// Numbers c ... c + 7 of a pixel of `channels`; 0 from there on. In quads where they begin at
/// whole ones.
RYE_HD inline Eight eight_of(const float* p, int c, int channels) {
    Eight r;
    if (c + 8 <= channels && reinterpret_cast<std::uintptr_t>(p + c) % sizeof(Quad4) == 0) {
        const auto* const quad = reinterpret_cast<const Quad4*>(p + c);
        const Quad4 a = quad[0], b = quad[1];
        r = {{a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w}};
    } else {
        for (std::size_t k = 0; k < 8; ++k)
            r[k] = c + static_cast<int>(k) < channels ? p[c + static_cast<int>(k)] : 0.0F;
    }
    return r;
}

/// Floats of an image.
struct PlainPixels {
    const float* from;
    int width, channels;

    struct Pixel {
        const float* p;
        int channels;
        RYE_HD float at(int c) const { return p[c]; }
        RYE_HD Eight eight(int c) const { return eight_of(p, c, channels); }
    };
    RYE_HD Pixel pixel(int x, int y) const {
        return {from + (Index(y) * width + x) * channels, channels};
    }
};

/// Mean and gain of an image's channels; null: it is not normalised.
struct DeviceNorm {
    const float *mean = nullptr, *gain = nullptr;

    /// x, normalised.
    RYE_HD float of(float x, int c) const {
        return mean != nullptr ? normalized(x, mean[c], gain[c]) : x;
    }
    /// Numbers of channels c ... c + 7.
    RYE_HD void of_eight(Eight& x, int c, int channels) const {
        if (mean == nullptr) return;
        const Eight m = eight_of(mean, c, channels), g = eight_of(gain, c, channels);
        for (std::size_t k = 0; k < 8; ++k) x[k] = normalized(x[k], m[k], g[k]);
    }
};

/// relu of what a convolution gave, normalised.
struct ActivatedPixels {
    const float* from;
    int width, channels;
    DeviceNorm norm;

    struct Pixel {
        const float* p;
        DeviceNorm norm;
        int channels;
        RYE_HD float at(int c) const { return relu(norm.of(p[c], c)); }
        RYE_HD Eight eight(int c) const {
            Eight r = eight_of(p, c, channels);
            norm.of_eight(r, c, channels);
            for (float& x : r) x = relu(x);
            return r;
        }
    };
    RYE_HD Pixel pixel(int x, int y) const {
        return {from + (Index(y) * width + x) * channels, norm, channels};
    }
};

/// Interpolation along one axis as kernels read it, made of nn/bilinear.hpp's Doubling.
struct DoublingTaps {
    std::int32_t at[2];
    float weight[2];
};
/// The outputs that sample an input.
struct DoublingGather {
    std::int32_t at[4];
    float weight[4]; ///< 0 where there are fewer
};

/// Pixels of another source at twice its size.
template <class Source>
struct DoubledPixels {
    Source from;
    const DoublingTaps *across, *down;

    struct Pixel {
        typename Source::Pixel corner[2][2]; ///< [row][column]
        float left, right, top, bottom;
        RYE_HD float at(int c) const {
            const float l = top * corner[0][0].at(c) + bottom * corner[1][0].at(c);
            const float r = top * corner[0][1].at(c) + bottom * corner[1][1].at(c);
            return left * l + right * r;
        }
        RYE_HD Eight eight(int c) const {
            const Eight a = corner[0][0].eight(c), b = corner[1][0].eight(c),
                        d = corner[0][1].eight(c), e = corner[1][1].eight(c);
            Eight x;
            for (std::size_t k = 0; k < 8; ++k) {
                const float l = top * a[k] + bottom * b[k], r = top * d[k] + bottom * e[k];
                x[k] = left * l + right * r;
            }
            return x;
        }
    };
    RYE_HD Pixel pixel(int x, int y) const {
        const DoublingTaps &u = across[x], &v = down[y];
        return {{{from.pixel(u.at[0], v.at[0]), from.pixel(u.at[1], v.at[0])},
                 {from.pixel(u.at[0], v.at[1]), from.pixel(u.at[1], v.at[1])}},
                u.weight[0],
                u.weight[1],
                v.weight[0],
                v.weight[1]};
    }
};

/// The cotangent of a convolution's output, from that of relu of its normalisation.
struct CotangentPixels {
    const float *g, *from;
    int width, channels;
    DeviceNorm norm;
    const float *mean_g, *mean_gy; ///< [channels] not read without a normalisation

    struct Pixel {
        const float *g, *p;
        DeviceNorm norm;
        const float *mean_g, *mean_gy;
        int channels;
        RYE_HD Eight eight(int c) const {
            Eight x = eight_of(g, c, channels), y = eight_of(p, c, channels);
            norm.of_eight(y, c, channels);
            for (std::size_t k = 0; k < 8; ++k) x[k] = relu_vjp(y[k], x[k]);
            if (norm.mean == nullptr) return x;
            const Eight m = eight_of(mean_g, c, channels), n = eight_of(mean_gy, c, channels),
                        gain = eight_of(norm.gain, c, channels);
            for (std::size_t k = 0; k < 8; ++k)
                x[k] = normalized_vjp(x[k], y[k], m[k], n[k], gain[k]);
            return x;
        }
        RYE_HD float at(int c) const {
            const float y = norm.of(p[c], c), through = relu_vjp(y, g[c]);
            if (norm.mean == nullptr) return through;
            return normalized_vjp(through, y, mean_g[c], mean_gy[c], norm.gain[c]);
        }
    };
    RYE_HD Pixel pixel(int x, int y) const {
        const Index at = (Index(y) * width + x) * channels;
        return {g + at, from + at, norm, mean_g, mean_gy, channels};
    }
};

/// The largest of each 2 x 2 pixels; an odd last row or column is dropped.
struct PooledPixels {
    const float* from;
    int width, channels; ///< extents of the image to pool

    struct Pixel {
        const float* p;
        Index row;
        int channels;
        RYE_HD float at(int c) const {
            const float *const top = p + c, *const bottom = top + row;
            const int best =
                detail::largest_of_four(top[0], top[channels], bottom[0], bottom[channels]);
            return (best < 2 ? top : bottom)[best % 2 * channels];
        }
        RYE_HD Eight eight(int c) const {
            const Eight top[2] = {eight_of(p, c, channels), eight_of(p + channels, c, channels)},
                        bottom[2] = {eight_of(p + row, c, channels),
                                     eight_of(p + row + channels, c, channels)};
            Eight x;
            for (std::size_t k = 0; k < 8; ++k) {
                const int best =
                    detail::largest_of_four(top[0][k], top[1][k], bottom[0][k], bottom[1][k]);
                const float left = best < 2 ? top[0][k] : bottom[0][k],
                            right = best < 2 ? top[1][k] : bottom[1][k];
                x[k] = best % 2 == 0 ? left : right;
            }
            return x;
        }
    };
    RYE_HD Pixel pixel(int x, int y) const {
        const Index row = Index(width) * channels;
        return {from + 2 * y * row + Index(2) * x * channels, row, channels};
    }
};

/// An image of a source, as planes.
template <int N, class Source>
struct ImagePlanesKernel {
    static constexpr const char* name = "image's planes";
    static constexpr int threads = 256, blocks = 4;
    struct Shared {};
    /// Eight numbers that are written at once.
    struct alignas(16) Halves {
        std::uint32_t pair[4];
    };
    Source source;
    DeviceImagePlanes to;

    Index blocks_of() const { return (to.pixels() * (to.padded() / 8) + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            // Fewer than 2^32 (image_planes_into): divisions of 32 bits are much faster.
            const auto i = static_cast<std::uint32_t>(block.index()) * std::uint32_t(threads) +
                           static_cast<std::uint32_t>(t);
            const auto groups = static_cast<std::uint32_t>(to.padded() / 8),
                       width = static_cast<std::uint32_t>(to.width);
            const std::uint32_t j = i / groups, y = j / width;
            if (y >= static_cast<std::uint32_t>(to.height)) return;
            const int first = static_cast<int>(i - j * groups) * 8;
            const auto pixel = source.pixel(static_cast<int>(j - y * width), static_cast<int>(y));
            Eight x = eight(pixel, first);
            std::uint16_t* const at = to.data + Index(j) * to.padded() + first;
            repeated<N>([&](auto p) {
                Halves plane;
                repeated<4>([&](auto k) {
                    const std::uint32_t both = Block::pack(x[2 * k], x[2 * k + 1]);
                    plane.pair[k] = both;
                    x[2 * k] = x[2 * k] - Block::low(both);
                    x[2 * k + 1] = x[2 * k + 1] - Block::high(both);
                });
                *reinterpret_cast<Halves*>(at + p * to.pixels() * to.padded()) = plane;
            });
        });
    }

  private:
    template <class Pixel>
    RYE_DEVICE Eight eight(const Pixel& pixel, int first) const {
        if constexpr (requires { pixel.eight(first); }) {
            return pixel.eight(first);
        } else {
            Eight r;
            for (std::size_t k = 0; k < 8; ++k) {
                const int c = first + static_cast<int>(k);
                r[k] = c < to.channels ? pixel.at(c) : 0.0F;
            }
            return r;
        }
    }
};

/// The cotangent of an image from that of it at twice the size, added to what is there or written.
struct DoublingVjpKernel {
    static constexpr const char* name = "gradient of a doubled image";
    static constexpr int threads = 256, blocks = 4;
    struct Shared {};
    const float* g;              ///< channels x (4 width height)
    int width, height, channels; ///< extents of the result
    const DoublingGather *across, *down;
    float* to;
    int to_channels; ///< channels of a pixel of `to`, the first of which are written
    bool add;

    /// Channels of a thread: four where pixels begin at whole quads.
    RYE_HD int wide() const { return channels % 4 == 0 && to_channels % 4 == 0 ? 4 : 1; }
    RYE_HD Index count() const { return Index(width) * height * (channels / wide()); }
    Index blocks_of() const { return (count() + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const Index i = Index(block.index()) * threads + t;
            if (i >= count()) return;
            if (wide() == 4)
                pull<Quad4>(static_cast<std::uint32_t>(i));
            else
                pull<float>(static_cast<std::uint32_t>(i));
        });
    }

  private:
    RYE_HD static void add_times(float& sum, float weight, float x) { sum += weight * x; }
    RYE_HD static void add_times(Quad4& sum, float weight, const Quad4& x) {
        sum.x += weight * x.x;
        sum.y += weight * x.y;
        sum.z += weight * x.z;
        sum.w += weight * x.w;
    }
    template <class V>
    RYE_HD void pull(std::uint32_t i) const {
        const auto parts = static_cast<std::uint32_t>(channels / wide()),
                   w = static_cast<std::uint32_t>(width);
        const std::uint32_t j = i / parts, c = i - j * parts, y = j / w;
        const DoublingGather u = across[j - y * w], v = down[y];
        const auto* const from = reinterpret_cast<const V*>(g) + c;
        V sum{};
        for (int k = 0; k < 4; ++k) {
            if (u.weight[k] == 0.0F) continue;
            V line{};
            for (int l = 0; l < 4; ++l)
                if (v.weight[l] != 0.0F)
                    add_times(line, v.weight[l],
                              from[(Index(v.at[l]) * 2 * width + u.at[k]) * Index(parts)]);
            add_times(sum, u.weight[k], line);
        }
        V& own = reinterpret_cast<V*>(to)[Index(j) * (to_channels / wide()) + c];
        if (add)
            add_times(own, 1.0F, sum);
        else
            own = sum;
    }
};

/// Taps of one axis in device memory.
template <class Device>
class DeviceDoubling {
  public:
    /// Makes the taps of n pixels; waits if n is new.
    void set(const Device& device, const CudaQueue& queue, int n) {
        if (n == size_) return;
        const Doubling exact(n);
        std::vector<DoublingTaps> from;
        std::vector<DoublingGather> to;
        for (const auto& [low, high] : exact.from)
            from.push_back({{static_cast<std::int32_t>(low.at), static_cast<std::int32_t>(high.at)},
                            {static_cast<float>(low.weight), static_cast<float>(high.weight)}});
        for (const auto& taps : exact.to) {
            DoublingGather gather{};
            std::size_t count = 0;
            for (const auto& tap : taps) {
                if (tap.weight == 0) continue;
                require(count < 4, "DeviceDoubling", "more than 4 pixels sample one");
                gather.at[count] = static_cast<std::int32_t>(tap.at);
                gather.weight[count++] = static_cast<float>(tap.weight);
            }
            to.push_back(gather);
        }
        taps_.reserve(queue, from.size() + 1);
        gather_.reserve(queue, to.size() + 1);
        device.send(queue, taps_.data(), from.data(), from.size() * sizeof(DoublingTaps));
        device.send(queue, gather_.data(), to.data(), to.size() * sizeof(DoublingGather));
        size_ = n;
    }
    const DoublingTaps* taps() const { return taps_.data(); }
    const DoublingGather* gather() const { return gather_.data(); }
    std::size_t bytes() const { return taps_.bytes() + gather_.bytes(); }

  private:
    DeviceBuffer<DoublingTaps> taps_;
    DeviceBuffer<DoublingGather> gather_;
    int size_ = -1;
};

} // namespace detail

} // namespace rye
