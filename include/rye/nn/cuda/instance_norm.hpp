// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/instance_norm.hpp: means and gains of an image's channels in device memory, from the
/// moments that a convolution leaves of strips of its pixels, and the means that the vjp of their
/// normalisation reads, by nn/instance_norm.hpp's formulas: doubles, in a fixed order. The
/// normalisation itself is where an image is read (image_planes.hpp).
#pragma once

#include <algorithm>

#include <rye/backend/cuda/sums.hpp>
#include <rye/math/scalar.hpp>
#include <rye/nn/cuda/convolution_kernels.hpp>

namespace rye {

namespace detail {

/// Pixels and channels of a block.
struct ChannelChunks {
    static constexpr int threads = 256, wide = 32, parts = threads / wide;
    static constexpr Index pixels_of = 512;
    Index pixels;
    int channels;

    Index chunks() const { return (pixels + pixels_of - 1) / pixels_of; }
    RYE_HD int groups() const { return (channels + wide - 1) / wide; }
    Index blocks_of() const { return chunks() * groups(); }
    RYE_HD int channel(int block, int t) const { return block % groups() * wide + t % wide; }
    RYE_HD Index begin(int block) const { return block / groups() * pixels_of; }
    RYE_HD Index end(int block) const { return rye::min(begin(block) + pixels_of, pixels); }
    /// Returns the place of a channel's result of a chunk.
    RYE_HD Index place(int block, int channel) const {
        return Index(block / groups()) * channels + channel;
    }
};

/// Numbers of a channel about `zero`: their count, sum and sum of squares.
struct ShiftedSums {
    double count = 0, sum = 0, squares = 0;

    RYE_HD void add(const ShiftedSums& o) {
        count += o.count;
        sum += o.sum;
        squares += o.squares;
    }
    RYE_HD void add(const StripMoments& m, double zero) {
        const auto n = static_cast<double>(m.count), rest = static_cast<double>(m.rest),
                   apart = static_cast<double>(m.mean) - zero;
        count += n;
        sum += n * apart + rest;
        squares += static_cast<double>(m.squares) + (2 * rest + n * apart) * apart;
    }
};

/// Moments of channels over strips of an image's pixels: channels x strips.
struct ChannelStrips {
    const StripMoments* strip;
    Index strips;
    int channels;

    /// Mean and gain of channel c from its sums over all strips, about the mean of the first.
    RYE_HD void finish(const ShiftedSums& all, int c, float* mean, float* gain) const {
        const double above = all.sum / all.count;
        mean[c] = static_cast<float>(static_cast<double>(strip[c].mean) + above);
        gain[c] = static_cast<float>(
            norm_gain<double>(rye::max(all.squares / all.count - above * above, 0.0)));
    }
};

/// Sums over strips, about the mean of the first, which is near that of all: a part of the strips
/// and 8 channels a block. Where there is one part, mean and gain of the channels.
struct StripSumsKernel {
    static constexpr const char* name = "moments of channels";
    static constexpr int wide = 8, ways = 32, threads = wide * ways, blocks = 4;
    static constexpr Index of_part = 2048; ///< strips
    static constexpr int at_once = 4;
    struct Shared {
        ShiftedSums sum[ways][wide];
    };
    ChannelStrips of;
    float *mean, *gain;
    ShiftedSums* part; ///< channels x parts(); not written where there is one

    RYE_HD Index parts() const { return (of.strips + of_part - 1) / of_part; }
    RYE_HD int groups() const { return (of.channels + wide - 1) / wide; }
    Index blocks_of() const { return parts() * groups(); }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index begin = block.index() / groups() * of_part,
                    end = rye::min(begin + Index(of_part), of.strips);
        const int first = block.index() % groups() * wide;
        block.each_thread([&](int t) {
            const int c = first + t % wide;
            ShiftedSums sum;
            if (c < of.channels) {
                const auto zero = static_cast<double>(of.strip[c].mean);
                for (Index k = begin + t / wide; k < end; k += at_once * ways) {
                    StripMoments own[std::size_t(at_once)];
                    repeated<at_once>([&](auto i) {
                        own[i] = k + i * ways < end ? of.strip[(k + i * ways) * of.channels + c]
                                                    : StripMoments{0, 0, 0, 0};
                    });
                    repeated<at_once>([&](auto i) { sum.add(own[i], zero); });
                }
            }
            shared.sum[t / wide][t % wide] = sum;
        });
        for (int apart = ways / 2; apart > 0; apart /= 2)
            block.each_thread([&](int t) {
                if (t / wide < apart)
                    shared.sum[t / wide][t % wide].add(shared.sum[t / wide + apart][t % wide]);
            });
        block.each_thread([&](int t) {
            const int c = first + t;
            if (t >= wide || c >= of.channels) return;
            if (parts() == 1)
                of.finish(shared.sum[0][t], c, mean, gain);
            else
                part[block.index() / groups() * of.channels + c] = shared.sum[0][t];
        });
    }
};

/// Mean and gain of a channel from the sums of parts, a block each.
struct NormMergeKernel {
    static constexpr const char* name = "merge of moments";
    static constexpr int threads = 32, blocks = 8;
    struct Shared {
        ShiftedSums own[threads];
    };
    ChannelStrips of;
    const ShiftedSums* part;
    Index parts;
    float *mean, *gain;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const int c = block.index();
        block.each_thread([&](int t) {
            ShiftedSums sum;
            for (Index k = t; k < parts; k += threads) sum.add(part[k * of.channels + c]);
            shared.own[t] = sum;
        });
        for (int apart = threads / 2; apart > 0; apart /= 2)
            block.each_thread([&](int t) {
                if (t < apart) shared.own[t].add(shared.own[t + apart]);
            });
        block.each_thread([&](int t) {
            if (t == 0) of.finish(shared.own[0], c, mean, gain);
        });
    }
};

/// Sums of the cotangent of a normalised image, and of its product with the image, over a chunk.
struct ChannelCotangentKernel {
    static constexpr const char* name = "means of a cotangent";
    static constexpr int threads = ChannelChunks::threads, blocks = 2;
    static constexpr int quads = ChannelChunks::wide / 4, parts = threads / quads;
    struct Shared {
        double g[parts][ChannelChunks::wide], gy[parts][ChannelChunks::wide];
    };
    ChannelChunks chunks;
    const float *g, *image; ///< [channels, pixels] cotangent of relu's output; the normalised image
    DeviceNorm norm;
    double* partial; ///< [chunks] channels sums of g, channels sums of g y

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        block.each_thread([&](int t) { add(shared, block.index(), t); });
        for (int apart = parts / 2; apart > 0; apart /= 2)
            block.each_thread([&](int t) {
                for (int i = t; i < apart * ChannelChunks::wide; i += threads) {
                    const int part = i / ChannelChunks::wide, c = i % ChannelChunks::wide;
                    shared.g[part][c] += shared.g[part + apart][c];
                    shared.gy[part][c] += shared.gy[part + apart][c];
                }
            });
        block.each_thread([&](int t) {
            const int c = chunks.channel(block.index(), t);
            if (t >= ChannelChunks::wide || c >= chunks.channels) return;
            double* const to = partial + 2 * chunks.place(block.index(), 0);
            to[c] = shared.g[0][t];
            to[chunks.channels + c] = shared.gy[0][t];
        });
    }

  private:
    /// Four channels of every few pixels of a chunk.
    RYE_DEVICE void add(Shared& shared, int block, int t) const {
        const int own = t % quads * 4, c = chunks.channel(block, own), part = t / quads;
        const Index begin = chunks.begin(block), end = chunks.end(block);
        double sum[4] = {0, 0, 0, 0}, product[4] = {0, 0, 0, 0};
        float mean[4] = {0, 0, 0, 0}, gain[4] = {1, 1, 1, 1};
        const auto each = [&](const auto& f) {
            for (int k = 0; k < 4; ++k)
                if (c + k < chunks.channels) f(k);
        };
        if (norm.mean != nullptr)
            each([&](int k) { mean[k] = norm.mean[c + k], gain[k] = norm.gain[c + k]; });
        const auto take = [&](int k, float x, float own_g) {
            const float y = norm.mean != nullptr ? normalized(x, mean[k], gain[k]) : x;
            const float through = relu_vjp(y, own_g);
            sum[k] += static_cast<double>(through);
            product[k] += static_cast<double>(through) * static_cast<double>(y);
        };
        if (chunks.channels % 4 == 0 && c < chunks.channels) {
            const auto *const x = reinterpret_cast<const Quad4*>(image + c),
                              *const gs = reinterpret_cast<const Quad4*>(g + c);
            const Index apart = chunks.channels / 4;
            constexpr int at_once = 4;
            for (Index j = begin + part; j < end; j += at_once * parts) {
                Quad4 a[std::size_t(at_once)], b[std::size_t(at_once)];
                repeated<at_once>([&](auto i) {
                    a[i] = b[i] = Quad4{0, 0, 0, 0};
                    if (j + i * parts < end) {
                        a[i] = x[(j + i * parts) * apart];
                        b[i] = gs[(j + i * parts) * apart];
                    }
                });
                repeated<at_once>([&](auto i) {
                    take(0, a[i].x, b[i].x);
                    take(1, a[i].y, b[i].y);
                    take(2, a[i].z, b[i].z);
                    take(3, a[i].w, b[i].w);
                });
            }
        } else {
            for (Index j = begin + part; j < end; j += parts)
                each([&](int k) {
                    const Index at = j * chunks.channels + c + k;
                    take(k, image[at], g[at]);
                });
        }
        for (int k = 0; k < 4; ++k) {
            shared.g[part][own + k] = sum[k];
            shared.gy[part][own + k] = product[k];
        }
    }
};

/// Sums over chunks of each of `count` numbers, a block each: factor times it, added or written.
struct OrderedSumKernel {
    static constexpr const char* name = "sums in order";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {
        double sum[threads];
    };
    const double* partial; ///< chunks x count
    Index chunks;
    int count;
    double factor;
    bool add;
    float* to;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const int i = block.index();
        block.each_thread([&](int t) {
            const Index share = (chunks + threads - 1) / threads;
            const Index end = rye::min(chunks, (t + 1) * share);
            double sum = 0;
            for (Index k = t * share; k < end; ++k) sum += partial[k * count + i];
            shared.sum[t] = sum;
        });
        add_up(block, shared.sum);
        block.each_thread([&](int t) {
            if (t != 0) return;
            const auto sum = static_cast<float>(factor * shared.sum[0]);
            to[i] = add ? to[i] + sum : sum;
        });
    }
};

} // namespace detail

/// Normalisations of images in device memory, with the memory of their sums.
template <class Device>
class DeviceInstanceNorm {
  public:
    explicit DeviceInstanceNorm(const Device& device) : device_(device) {}

    /// Means and gains of channels from the moments of strips of their pixels.
    void forward_into(const CudaQueue& queue, const detail::ChannelStrips& of, float* mean,
                      float* gain) {
        detail::StripSumsKernel kernel{of, mean, gain, nullptr};
        const Index parts = kernel.parts();
        parts_.reserve(queue, static_cast<std::size_t>(parts * of.channels) + 1);
        kernel.part = parts_.data();
        device_.launch(queue, kernel.blocks_of(), kernel);
        if (parts > 1)
            device_.launch(queue, of.channels,
                           detail::NormMergeKernel{of, parts_.data(), parts, mean, gain});
    }
    /// Inputs of CotangentPixels: 2 x channels means, of the cotangent through relu and of its
    /// product with the normalised image.
    void vjp_into(const CudaQueue& queue, const DeviceColumns<const float>& image, const float* g,
                  const detail::DeviceNorm& norm, float* means) {
        const detail::ChannelChunks chunks{image.cols, static_cast<int>(image.rows)};
        const int count = 2 * chunks.channels;
        sums_.reserve(queue, static_cast<std::size_t>(chunks.chunks() * count) + 1);
        device_.launch(queue, chunks.blocks_of(),
                       detail::ChannelCotangentKernel{chunks, g, image.data, norm, sums_.data()});
        const double share = 1.0 / static_cast<double>(std::max<Index>(image.cols, 1));
        device_.launch(
            queue, count,
            detail::OrderedSumKernel{sums_.data(), chunks.chunks(), count, share, false, means});
    }
    std::size_t bytes() const { return parts_.bytes() + sums_.bytes(); }

  private:
    Device device_;
    DeviceBuffer<detail::ShiftedSums> parts_;
    DeviceBuffer<double> sums_;
};

} // namespace rye
