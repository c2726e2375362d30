// SPDX-License-Identifier: Apache-2.0
/// rye/loss/cuda/lpips.hpp: the learned perceptual distance of loss/lpips.hpp for pictures in
/// device memory, value and cotangent, over the whole picture or a crop whose position is read on
/// the device. The caller keeps the truth's features, which are computed once.
///     DeviceLpips<CudaDevice, 1> lpips(device, queue, weights);
///     lpips.truth_into(queue, truth, crop, kept);          // once per picture and crop
///     terms.push_back(lpips.into(queue, picture, kept, weight, g));
#pragma once

#include <algorithm>
#include <array>
#include <numeric>
#include <string>
#include <vector>

#include <rye/loss/cuda/terms.hpp>
#include <rye/loss/lpips.hpp>
#include <rye/nn/cuda/features.hpp>

namespace rye {

/// Part of a picture: its size, and its first column and row (x, y) in device memory.
struct DeviceCrop {
    int width, height;                ///< [px]
    const std::int32_t* at = nullptr; ///< null for (0, 0); inside the picture
};

namespace detail {

/// Colours of a crop in the range of the network's training. P: float or bytes.
template <class P>
struct LpipsPixels {
    const P* from;
    int pitch; ///< width of the picture [px]
    const std::int32_t* at;
    Array<float, 3> gain, offset;

    struct Pixel {
        const P* p;
        Array<float, 3> gain, offset;
        RYE_HD float at(int c) const {
            const auto i = static_cast<std::size_t>(c);
            return unit_value(p[c]) * gain[i] + offset[i];
        }
    };
    RYE_HD Pixel pixel(int x, int y) const {
        const int u = at != nullptr ? at[0] : 0, v = at != nullptr ? at[1] : 0;
        return {from + 3 * (Index(y + v) * pitch + x + u), gain, offset};
    }
};

/// Sums over the features of pixels, eight threads per pixel.
struct LpipsPixelSums {
    static constexpr int threads = 256, parts = 8, pixels_of = threads / parts;
    RYE_HD static int pixel(int t) { return t / parts; }
    RYE_HD static int part(int t) { return t % parts; }
    /// Returns the sum over the parts of a thread's pixel.
    RYE_HD static float all(const float* sum, int t) {
        const float* const own = sum + t / parts * parts;
        return ((own[0] + own[1]) + (own[2] + own[3])) + ((own[4] + own[5]) + (own[6] + own[7]));
    }
};

/// Kernel of the truth's features, scaled to unit length.
struct LpipsTruthKernel : LpipsPixelSums {
    static constexpr const char* name = "features of the truth";
    static constexpr int blocks = 4;
    struct Shared {
        float squares[threads];
    };
    DeviceColumns<const float> feature;
    float* to;

    Index blocks_of() const { return (feature.cols + pixels_of - 1) / pixels_of; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index first = Index(block.index()) * pixels_of;
        block.each_thread([&](int t) {
            const Index j = first + pixel(t);
            float sum = 0;
            if (j < feature.cols)
                for (Index c = part(t); c < feature.rows; c += parts)
                    sum += square(feature.data[j * feature.rows + c]);
            shared.squares[t] = sum;
        });
        block.each_thread([&](int t) {
            const Index j = first + pixel(t);
            if (j >= feature.cols) return;
            const float s = std::sqrt(all(shared.squares, t)) + static_cast<float>(lpips_eps);
            for (Index c = part(t); c < feature.rows; c += parts) {
                const Index i = j * feature.rows + c;
                to[i] = detail::of_unit_length(feature.data[i], s);
            }
        });
    }
};

/// Kernel of the distance of a slice, and its cotangent of the features.
struct LpipsSliceKernel : LpipsPixelSums {
    static constexpr const char* name = "distance of features";
    static constexpr int blocks = 4;
    struct Shared {
        float squares[threads], dot[threads];
        double sum[threads];
    };
    DeviceColumns<const float> feature;
    const float *truth, *weight; ///< the truth's unit-length features; the slice's weights
    float share;                 ///< 1 / pixels
    double* partial;             ///< null for the cotangent alone
    float* g;                    ///< null for the value alone
    bool add;

    Index blocks_of() const { return (feature.cols + pixels_of - 1) / pixels_of; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index first = Index(block.index()) * pixels_of;
        const auto each = [&](int t, const auto& f) {
            const Index j = first + pixel(t);
            if (j < feature.cols)
                for (Index c = part(t); c < feature.rows; c += parts) f(j * feature.rows + c, c);
        };
        block.each_thread([&](int t) {
            float sum = 0;
            each(t, [&](Index i, Index) { sum += square(feature.data[i]); });
            shared.squares[t] = sum;
        });
        const auto radius = [&](int t) { return std::sqrt(all(shared.squares, t)); };
        block.each_thread([&](int t) {
            const float s = radius(t) + static_cast<float>(lpips_eps);
            float dot = 0, distance = 0;
            each(t, [&](Index i, Index c) {
                const float f = feature.data[i], d = detail::of_unit_length(f, s) - truth[i],
                            wd = weight[c] * d;
                distance += d * wd;
                dot += f * (2 * share * wd);
            });
            shared.dot[t] = dot;
            shared.sum[t] = static_cast<double>(distance);
        });
        if (g != nullptr)
            block.each_thread([&](int t) {
                const float r = radius(t), s = r + static_cast<float>(lpips_eps);
                const float dot = all(shared.dot, t);
                each(t, [&](Index i, Index c) {
                    const float f = feature.data[i], d = detail::of_unit_length(f, s) - truth[i];
                    const float own =
                        r > 0 ? detail::unit_length_vjp(f, 2 * share * (weight[c] * d), dot, r, s)
                              : 0.0F;
                    g[i] = add ? g[i] + own : own;
                });
            });
        if (partial == nullptr) return;
        add_up(block, shared.sum);
        block.each_thread([&](int t) {
            if (t == 0) partial[block.index()] = shared.sum[0] * static_cast<double>(share);
        });
    }
};

/// Kernel that adds the cotangent of the network's input to that of the picture.
struct LpipsAddKernel {
    static constexpr const char* name = "gradient of a crop";
    static constexpr int threads = 256, blocks = 4;
    struct Shared {};
    const float* g; ///< 3 x pixels of the crop
    DeviceCrop crop;
    int pitch;             ///< width of the picture [px]
    Array<float, 3> slope; ///< weight times gain
    float* to;             ///< 3 x pixels of the picture

    Index blocks_of() const {
        return (3 * Index(crop.width) * crop.height + threads - 1) / threads;
    }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const Index i = Index(block.index()) * threads + t;
            const Index j = i / 3, c = i % 3;
            if (j >= Index(crop.width) * crop.height) return;
            const int u = crop.at != nullptr ? crop.at[0] : 0,
                      v = crop.at != nullptr ? crop.at[1] : 0;
            const Index x = j % crop.width + u, y = j / crop.width + v;
            to[3 * (y * pitch + x) + c] += slope[static_cast<std::size_t>(c)] * g[i];
        });
    }
};

} // namespace detail

/// Features of a truth's crop, scaled to unit length.
struct DeviceLpipsTruth {
    DeviceCrop crop{};
    std::array<DeviceBuffer<float>, vgg_slices> slice;

    /// Returns the memory held [bytes].
    std::size_t bytes() const {
        std::size_t sum = 0;
        for (const auto& s : slice) sum += s.bytes();
        return sum;
    }
};

/// LPIPS with the user's weights in device memory. N: number of bf16 planes per float.
template <class Device, int N>
class DeviceLpips {
  public:
    /// Copies the weights to the device; waits. Throws an Error if their sizes contradict their
    /// shape.
    DeviceLpips(const Device& device, const CudaQueue& queue, const LpipsWeights<float>& weights)
        : device_(device),
          net_(device, weights.net.shape) {
        net_.set(queue, weights.net);
        for (std::size_t s = 0; s < vgg_slices; ++s) {
            const Columns<float>& w = weights.linear[s];
            require(w.size() == weights.net.shape.channels[s], "DeviceLpips", "weights of slice ",
                    s, " are ", w.size(), " numbers, expected ", weights.net.shape.channels[s]);
            linear_[s].reserve(queue, static_cast<std::size_t>(w.size()));
            device.send(queue, linear_[s].data(), w.data(),
                        static_cast<std::size_t>(w.size()) * sizeof(float));
        }
    }

    /// Computes the features of a crop of a picture (three channels, floats or bytes). Throws an
    /// Error if the crop is larger than the picture or has a side below 16 pixels.
    template <class P>
    void truth_into(const CudaQueue& queue, const DevicePicture<const P>& picture,
                    const DeviceCrop& where, DeviceLpipsTruth& to) {
        look(queue, picture, where);
        to.crop = where;
        for (std::size_t s = 0; s < vgg_slices; ++s) {
            const auto feature = net_.feature(trace_, static_cast<int>(s)).pixels;
            to.slice[s].reserve(queue, static_cast<std::size_t>(feature.size()));
            const detail::LpipsTruthKernel kernel{{}, feature, to.slice[s].data()};
            device_.launch(queue, kernel.blocks_of(), kernel);
        }
    }

    /// Returns the distance of the picture's crop to the truth as a term of weight `weight`; adds
    /// `weight` times its cotangent of the picture to g, of the picture's shape.
    DeviceLossTerm into(const CudaQueue& queue, const DevicePicture<const float>& picture,
                        const DeviceLpipsTruth& truth, double weight,
                        const DevicePicture<float>& g) {
        require(truth.crop.width > 0, "DeviceLpips", "the truth was not set");
        detail::require_picture("DeviceLpips", "gradient", g, 3, picture.width, picture.height);
        look(queue, picture, truth.crop);
        Index chunks = 0;
        std::array<Index, vgg_slices> first{};
        for (std::size_t s = 0; s < vgg_slices; ++s) {
            first[s] = chunks;
            chunks += slice(truth, s).blocks_of();
        }
        double* const partial = sums_.reserve(queue, chunks);
        g_in_.reserve(queue, 3 * static_cast<std::size_t>(truth.crop.width) *
                                 static_cast<std::size_t>(truth.crop.height));
        const auto add = [&](int s, float* to, bool again) {
            const auto i = static_cast<std::size_t>(s);
            detail::LpipsSliceKernel kernel = slice(truth, i);
            kernel.partial = partial + first[i];
            kernel.g = to;
            kernel.add = again;
            device_.launch(queue, kernel.blocks_of(), kernel);
        };
        net_.vjp_input_into(queue, trace_, add, g_in_.data());
        detail::LpipsAddKernel back{g_in_.data(), truth.crop, picture.width, {}, g.pixels.data};
        for (std::size_t c = 0; c < 3; ++c)
            back.slope[c] = static_cast<float>(weight * 2.0 / detail::lpips_scale[c]);
        device_.launch(queue, back.blocks_of(), back);
        return {partial, chunks, 1.0, 0.0, weight};
    }
    /// Returns the distance of two pictures of one size, without its cotangent; waits. Keeps the
    /// truth's features in a buffer of its own.
    template <class P>
    double value(const CudaQueue& queue, const DevicePicture<const float>& picture,
                 const DevicePicture<const P>& truth) {
        detail::require_picture("DeviceLpips", "truth", truth, 3, picture.width, picture.height);
        truth_into(queue, truth, {truth.width, truth.height}, own_);
        look(queue, picture, own_.crop);
        Index chunks = 0;
        for (std::size_t s = 0; s < vgg_slices; ++s) chunks += slice(own_, s).blocks_of();
        double* const partial = sums_.reserve(queue, chunks);
        Index first = 0;
        for (std::size_t s = 0; s < vgg_slices; ++s) {
            detail::LpipsSliceKernel kernel = slice(own_, s);
            kernel.partial = partial + first;
            first += kernel.blocks_of();
            device_.launch(queue, kernel.blocks_of(), kernel);
        }
        std::vector<double> sums(static_cast<std::size_t>(chunks));
        device_.fetch(queue, sums.data(), partial, sums.size() * sizeof(double));
        return std::accumulate(sums.begin(), sums.end(), 0.0);
    }
    /// Returns the same as a perceptual loss of an objective, for a truth of floats or bytes: its
    /// features over `crop` are computed here, or taken from `kept` unless that is null.
    template <class P>
    DeviceLossTerm into(const CudaQueue& queue, const DevicePicture<const float>& picture,
                        const DevicePicture<const P>& truth, double weight,
                        const DevicePicture<float>& g) {
        if (kept != nullptr) return into(queue, picture, *kept, weight, g);
        const bool whole = crop.width == 0;
        truth_into(queue, truth, whole ? DeviceCrop{truth.width, truth.height} : crop, own_);
        return into(queue, picture, own_, weight, g);
    }
    DeviceCrop crop{};                      ///< width 0: the whole picture
    const DeviceLpipsTruth* kept = nullptr; ///< the caller's features of the next truth, or null

    /// Returns the memory held, without the truths' [bytes].
    std::size_t bytes() const {
        std::size_t sum =
            net_.bytes() + trace_.bytes() + g_in_.bytes() + sums_.bytes() + own_.bytes();
        for (const auto& l : linear_) sum += l.bytes();
        return sum;
    }

  private:
    detail::LpipsSliceKernel slice(const DeviceLpipsTruth& truth, std::size_t s) const {
        const auto feature = net_.feature(trace_, static_cast<int>(s)).pixels;
        const double share = 1.0 / static_cast<double>(feature.cols);
        return {{},      feature, truth.slice[s].data(), linear_[s].data(), float(share), nullptr,
                nullptr, false};
    }
    template <class P>
    void look(const CudaQueue& queue, const DevicePicture<const P>& picture,
              const DeviceCrop& where) {
        detail::require_picture("DeviceLpips", "picture", picture, 3, picture.width,
                                picture.height);
        require(where.width <= picture.width && where.height <= picture.height, "DeviceLpips",
                "crop of ", where.width, " x ", where.height, " from a picture of ", picture.width,
                " x ", picture.height);
        detail::LpipsPixels<P> source{picture.pixels.data, picture.width, where.at, {}, {}};
        for (std::size_t c = 0; c < 3; ++c) {
            source.gain[c] = static_cast<float>(2.0 / detail::lpips_scale[c]);
            source.offset[c] =
                static_cast<float>((-1.0 - detail::lpips_shift[c]) / detail::lpips_scale[c]);
        }
        net_.forward_into(queue, source, where.width, where.height, trace_);
    }

    Device device_;
    DeviceVgg<Device, N> net_;
    DeviceVggTrace trace_;
    DeviceLpipsTruth own_;
    std::array<DeviceBuffer<float>, vgg_slices> linear_;
    DeviceBuffer<float> g_in_;
    detail::LossSums sums_;
};

} // namespace rye
