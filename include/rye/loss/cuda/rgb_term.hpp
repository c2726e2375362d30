// SPDX-License-Identifier: Apache-2.0
/// rye/loss/cuda/rgb_term.hpp: masked L1 term of the red, green and blue of a picture in device
/// memory, by the formula of loss/photometric.hpp. The target is computed pixel by pixel: a
/// picture, a colour, or a caller's function. Value and cotangent in one pass.
#pragma once

#include <algorithm>

#include <rye/loss/cuda/terms.hpp>
#include <rye/loss/photometric.hpp>

namespace rye {

namespace detail {

/// Target colour of a pixel and its weight. The colour is not read if `mask` is 0.
struct RgbTarget {
    float mask;
    Array<float, 3> colour;
};

} // namespace detail

/// A target that kernels read: at(pixel), or mask(pixel) alone.
template <class G>
concept RgbTargetSource = requires(const G& target, Index pixel) {
    { target.at(pixel) } -> std::same_as<detail::RgbTarget>;
    { target.mask(pixel) } -> std::same_as<float>;
};

namespace detail {

/// Target of a picture (three channels) with a mask; null means 1 everywhere.
template <class P>
struct PictureTarget {
    const P* picture;
    const P* weights;

    RYE_HD float mask(Index i) const { return weights != nullptr ? unit_value(weights[i]) : 1.0F; }
    RYE_HD RgbTarget at(Index i) const {
        return {mask(i),
                {{unit_value(picture[3 * i]), unit_value(picture[3 * i + 1]),
                  unit_value(picture[3 * i + 2])}}};
    }
};

} // namespace detail

static_assert(RgbTargetSource<detail::PictureTarget<float>>);

namespace detail {

/// Number of pixels per partial sum.
inline constexpr Index rgb_chunk = 256;
/// Returns the number of partial sums of a picture.
inline Index rgb_chunks(Index pixels) { return (pixels + rgb_chunk - 1) / rgb_chunk; }

/// Kernel of the term over a chunk of pixels, and its cotangent.
template <RgbTargetSource G>
struct RgbTermKernel {
    static constexpr const char* name = "masked L1 of colours";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {
        double sum[threads];
    };
    DeviceColumns<const float> picture; ///< at least 3 x pixels
    G target;
    double weight;
    float share; ///< 1 / number of values
    float* g;    ///< of the picture's shape; its first three rows are accumulated
    double* partial;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index begin = block.index() * rgb_chunk,
                    end = rye::min(begin + rgb_chunk, picture.cols);
        const auto own = static_cast<float>(weight);
        block.each_thread([&](int t) {
            double sum = 0;
            for (Index j = begin + t; j < end; j += threads) {
                if (target.mask(j) == 0.0F) continue; // masked pixels may hold NaN
                const RgbTarget want = target.at(j);
                const float slope = own * (want.mask * share);
                double pixel = 0;
                for (int c = 0; c < 3; ++c) {
                    const Index i = j * picture.rows + c;
                    const AbsoluteDifference<float> d(want.mask, picture.data[i],
                                                      want.colour[static_cast<std::size_t>(c)]);
                    pixel += static_cast<double>(d.value());
                    g[i] += d.cotangent(slope);
                }
                sum += pixel;
            }
            shared.sum[t] = sum;
        });
        add_up(block, shared.sum);
        block.each_thread([&](int t) {
            if (t == 0) partial[block.index()] = shared.sum[0];
        });
    }
};

} // namespace detail

/// Term mean |mask (picture - target)| over all pixels and the first three channels. `into` adds
/// `weight` times its cotangent to g's first three rows; throws an Error for fewer channels or
/// another shape of g.
template <class Device>
class DeviceRgbTerm {
  public:
    explicit DeviceRgbTerm(const Device& device) : device_(device) {}

    template <RgbTargetSource G>
    DeviceLossTerm into(const CudaQueue& queue, const DeviceColumns<const float>& picture,
                        const G& target, double weight, const DeviceColumns<float>& g) {
        require(picture.rows >= 3 && g.rows == picture.rows && g.cols == picture.cols, "rgb term",
                "picture is ", picture.rows, " x ", picture.cols, ", its gradient ", g.rows, " x ",
                g.cols, ", expected one shape of at least 3 rows");
        const Index chunks = detail::rgb_chunks(picture.cols);
        double* const partial = sums_.reserve(queue, chunks);
        const double share = 1.0 / static_cast<double>(std::max<Index>(3 * picture.cols, 1));
        device_.launch(queue, chunks,
                       detail::RgbTermKernel<G>{picture, target, weight, static_cast<float>(share),
                                                g.data, partial});
        return {partial, chunks, share, 0.0, weight};
    }
    std::size_t bytes() const { return sums_.bytes(); }

  private:
    Device device_;
    detail::LossSums sums_;
};

} // namespace rye
