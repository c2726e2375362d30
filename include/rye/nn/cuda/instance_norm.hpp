// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/instance_norm.hpp: means and gains of an image's channels in device memory, and the
/// means that the vjp of their normalisation reads, by nn/instance_norm.hpp's formulas. Doubles,
/// over chunks of pixels whose results are merged in a fixed order. The normalisation itself is
/// where an image is read (image_planes.hpp).
/// Source: Chan et al., "Algorithms for Computing the Sample Variance", 1983, eq. 2.1.
#pragma once

#include <algorithm>

#include <rye/backend/cuda/sums.hpp>
#include <rye/math/scalar.hpp>
#include <rye/nn/cuda/image_planes.hpp>

namespace rye {

/// Mean and sum of squares about it, of `count` numbers.
struct Moments {
    double count = 0, mean = 0, squares = 0;

    RYE_HD void add(const Moments& o) {
        if (o.count == 0) return;
        const double all = count + o.count, apart = o.mean - mean;
        mean += apart * (o.count / all);
        squares += o.squares + apart * apart * (count * o.count / all);
        count = all;
    }
};

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
    /// Where a channel's result of a chunk is.
    RYE_HD Index place(int block, int channel) const {
        return Index(block / groups()) * channels + channel;
    }
};

/// Moments of the channels over a chunk of pixels.
struct ChannelMomentsKernel {
    static constexpr const char* name = "moments of channels";
    static constexpr int threads = ChannelChunks::threads, blocks = 4;
    struct Shared {
        double sum[threads], mean[ChannelChunks::wide];
    };
    ChannelChunks chunks;
    const float* image; ///< channels x pixels
    Moments* partial;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index begin = chunks.begin(block.index()), end = chunks.end(block.index());
        const auto sum_of = [&](const auto& f) {
            block.each_thread([&](int t) {
                const int c = chunks.channel(block.index(), t);
                double sum = 0;
                if (c < chunks.channels)
                    for (Index j = begin + t / ChannelChunks::wide; j < end;
                         j += ChannelChunks::parts)
                        sum += f(static_cast<double>(image[j * chunks.channels + c]), t);
                shared.sum[t] = sum;
            });
        };
        const auto total = [&](int t) {
            double sum = 0;
            for (int p = 0; p < ChannelChunks::parts; ++p)
                sum += shared.sum[p * ChannelChunks::wide + t];
            return sum;
        };
        sum_of([](double x, int) { return x; });
        block.each_thread([&](int t) {
            if (t < ChannelChunks::wide)
                shared.mean[t] = total(t) / static_cast<double>(end - begin);
        });
        sum_of([&](double x, int t) {
            const double apart = x - shared.mean[t % ChannelChunks::wide];
            return apart * apart;
        });
        block.each_thread([&](int t) {
            const int c = chunks.channel(block.index(), t);
            if (t < ChannelChunks::wide && c < chunks.channels)
                partial[chunks.place(block.index(), c)] = {static_cast<double>(end - begin),
                                                           shared.mean[t], total(t)};
        });
    }
};

/// Mean and gain of a channel, a block each.
struct NormMergeKernel {
    static constexpr const char* name = "merge of moments";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {
        Moments own[threads];
    };
    const Moments* partial;
    Index chunks;
    int channels;
    float *mean, *gain;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const int c = block.index();
        block.each_thread([&](int t) {
            const Index share = (chunks + threads - 1) / threads;
            const Index end = rye::min(chunks, (t + 1) * share);
            Moments sum;
            for (Index k = t * share; k < end; ++k) sum.add(partial[k * channels + c]);
            shared.own[t] = sum;
        });
        for (int apart = threads / 2; apart > 0; apart /= 2)
            block.each_thread([&](int t) {
                if (t < apart) shared.own[t].add(shared.own[t + apart]);
            });
        block.each_thread([&](int t) {
            if (t != 0) return;
            const Moments& m = shared.own[0];
            mean[c] = static_cast<float>(m.mean);
            gain[c] = static_cast<float>(norm_gain<double>(m.count > 0 ? m.squares / m.count : 0));
        });
    }
};

/// Sums of the cotangent of a normalised image, and of its product with the image, over a chunk.
struct ChannelCotangentKernel {
    static constexpr const char* name = "means of a cotangent";
    static constexpr int threads = ChannelChunks::threads, blocks = 4;
    struct Shared {
        double g[threads], gy[threads];
    };
    ChannelChunks chunks;
    const float *g, *image; ///< of relu's output, and what was normalised; channels x pixels
    DeviceNorm norm;
    double* partial; ///< of a chunk: channels sums of g, channels sums of g y

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index begin = chunks.begin(block.index()), end = chunks.end(block.index());
        block.each_thread([&](int t) {
            const int c = chunks.channel(block.index(), t);
            double sum = 0, product = 0;
            if (c < chunks.channels)
                for (Index j = begin + t / ChannelChunks::wide; j < end;
                     j += ChannelChunks::parts) {
                    const Index at = j * chunks.channels + c;
                    const float y = norm.of(image[at], c), through = relu_vjp(y, g[at]);
                    sum += static_cast<double>(through);
                    product += static_cast<double>(through) * static_cast<double>(y);
                }
            shared.g[t] = sum;
            shared.gy[t] = product;
        });
        block.each_thread([&](int t) {
            const int c = chunks.channel(block.index(), t);
            if (t >= ChannelChunks::wide || c >= chunks.channels) return;
            double sum = 0, product = 0;
            for (int p = 0; p < ChannelChunks::parts; ++p) {
                sum += shared.g[p * ChannelChunks::wide + t];
                product += shared.gy[p * ChannelChunks::wide + t];
            }
            double* const to = partial + 2 * chunks.place(block.index(), 0);
            to[c] = sum;
            to[chunks.channels + c] = product;
        });
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

/// Normalisations of images in device memory, with the memory of their sums.
template <class Device>
class DeviceInstanceNorm {
  public:
    explicit DeviceInstanceNorm(const Device& device) : device_(device) {}

    /// Mean and gain of each channel of an image (channels x pixels).
    void forward_into(const CudaQueue& queue, const DeviceColumns<const float>& image, float* mean,
                      float* gain) {
        const ChannelChunks chunks{image.cols, static_cast<int>(image.rows)};
        moments_.reserve(queue, static_cast<std::size_t>(chunks.chunks() * image.rows) + 1);
        device_.launch(queue, chunks.blocks_of(),
                       ChannelMomentsKernel{chunks, image.data, moments_.data()});
        device_.launch(
            queue, image.rows,
            NormMergeKernel{moments_.data(), chunks.chunks(), chunks.channels, mean, gain});
    }
    /// What CotangentPixels reads: 2 x channels means, of the cotangent through relu and of its
    /// product with the normalised image.
    void vjp_into(const CudaQueue& queue, const DeviceColumns<const float>& image, const float* g,
                  const DeviceNorm& norm, float* means) {
        const ChannelChunks chunks{image.cols, static_cast<int>(image.rows)};
        const int count = 2 * chunks.channels;
        sums_.reserve(queue, static_cast<std::size_t>(chunks.chunks() * count) + 1);
        device_.launch(queue, chunks.blocks_of(),
                       ChannelCotangentKernel{chunks, g, image.data, norm, sums_.data()});
        const double share = 1.0 / static_cast<double>(std::max<Index>(image.cols, 1));
        device_.launch(queue, count,
                       OrderedSumKernel{sums_.data(), chunks.chunks(), count, share, false, means});
    }
    std::size_t bytes() const { return moments_.bytes() + sums_.bytes(); }

  private:
    Device device_;
    DeviceBuffer<Moments> moments_;
    DeviceBuffer<double> sums_;
};

} // namespace rye
