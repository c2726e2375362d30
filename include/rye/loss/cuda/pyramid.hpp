// SPDX-License-Identifier: Apache-2.0
/// rye/loss/cuda/pyramid.hpp: PyramidGradientLoss of pictures in device memory, value and
/// cotangent, by the formulas of loss/perceptual.hpp. The pictures' difference is computed on
/// reading; its two halvings are stored. Slopes propagate from the coarsest level to the finest.
#pragma once

#include <algorithm>

#include <rye/loss/cuda/terms.hpp>
#include <rye/loss/perceptual.hpp>

namespace rye {

/// First level, computed on reading: a - b.
template <class P>
struct PictureDifference {
    const float* a;
    const P* b;
    RYE_HD float at(Index i) const { return a[i] - detail::unit_value(b[i]); }
};

namespace detail {

/// Stored level.
struct KeptLevel {
    const float* d;
    RYE_HD float at(Index i) const { return d[i]; }
};

/// Size of a level.
struct PyramidLevel {
    int width, height, channels;
    RYE_HD Index row() const { return Index(width) * channels; }
    RYE_HD Index size() const { return row() * height; }
    PyramidLevel next() const { return {width / 2, height / 2, channels}; }
};

/// Kernel of the next level of a pyramid.
template <class Source>
struct HalveKernel {
    static constexpr const char* name = "half a picture";
    static constexpr int threads = 256, blocks = 4;
    struct Shared {};
    PyramidLevel fine, coarse;
    Source from;
    float* to;

    Index blocks_of() const { return (coarse.size() + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const Index i = Index(block.index()) * threads + t;
            if (i >= coarse.size()) return;
            const Index y = i / coarse.row(), x = i % coarse.row() / coarse.channels,
                        c = i % coarse.channels;
            const Index p = 2 * y * fine.row() + 2 * x * fine.channels + c;
            to[i] = detail::average_of_four<float>(from.at(p), from.at(p + fine.channels),
                                                   from.at(p + fine.row()),
                                                   from.at(p + fine.row() + fine.channels));
        });
    }
};

/// Kernel of the differences along both axes of a level, and their slopes plus those of the next
/// level.
template <class Source>
struct PyramidKernel {
    static constexpr const char* name = "differences of a level";
    static constexpr int threads = 256, blocks = 4;
    static constexpr Index chunk = 4 * threads; ///< values per block
    struct Shared {
        double sum[threads];
    };
    PyramidLevel level;
    Source d;
    float across, down;  ///< weights of one difference in the loss
    const float* coarse; ///< slopes of the next level; may be null
    bool add;            ///< true: adds `weight` times the slope to g; false: writes the slope
    float weight;
    float* g;
    double* partial;

    Index blocks_of() const { return (level.size() + chunk - 1) / chunk; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index begin = block.index() * chunk, end = rye::min(begin + chunk, level.size());
        block.each_thread([&](int t) {
            double sum = 0;
            for (Index i = begin + t; i < end; i += threads) sum += one(i);
            shared.sum[t] = sum;
        });
        add_up(block, shared.sum);
        block.each_thread([&](int t) {
            if (t == 0) partial[block.index()] = shared.sum[0];
        });
    }

  private:
    /// Writes the slope of value i; returns its share of the loss.
    RYE_DEVICE double one(Index i) const {
        const Index row = level.row(), c = level.channels;
        const Index y = i / row, x = i % row / c;
        const float here = d.at(i);
        detail::DifferenceSum<float> sum;
        if (x + 1 < level.width) sum.next(here, d.at(i + c), across);
        if (x > 0) sum.last(here, d.at(i - c), across);
        if (y + 1 < level.height) sum.next(here, d.at(i + row), down);
        if (y > 0) sum.last(here, d.at(i - row), down);
        if (coarse != nullptr) {
            const PyramidLevel below{level.width / 2, level.height / 2, level.channels};
            if (x / 2 < below.width && y / 2 < below.height)
                sum.slope += 0.25F * coarse[y / 2 * below.row() + x / 2 * c + i % c];
        }
        if (add)
            g[i] += weight * sum.slope;
        else
            g[i] = sum.slope;
        return static_cast<double>(sum.value);
    }
};

} // namespace detail

/// Pyramid loss of pictures in device memory, with its levels.
template <class Device>
class DevicePyramidLoss {
  public:
    explicit DevicePyramidLoss(const Device& device, const PyramidGradientLoss& loss = {})
        : device_(device),
          loss_(loss) {}

    /// Returns the loss of a and b (floats or bytes) as a term of weight `weight`; adds `weight`
    /// times its cotangent of a to g. Throws an Error unless a, b and g have one shape.
    template <class P>
    DeviceLossTerm into(const CudaQueue& queue, const DevicePicture<const float>& a,
                        const DevicePicture<const P>& b, double weight,
                        const DevicePicture<float>& g) {
        detail::require_picture("PyramidGradientLoss", "second picture", b, a.pixels.rows, a.width,
                                a.height);
        detail::require_picture("PyramidGradientLoss", "gradient", g, a.pixels.rows, a.width,
                                a.height);
        const detail::PyramidLevel first{a.width, a.height, static_cast<int>(a.pixels.rows)};
        const detail::PyramidLevel second = first.next(), third = second.next();
        levels_.reserve(queue, 2 * static_cast<std::size_t>(second.size() + third.size()) + 1);
        float *const d1 = levels_.data(), *const g1 = d1 + second.size(),
                     *const d2 = g1 + second.size(), *const g2 = d2 + third.size();
        using Top = PictureDifference<P>;
        const Top top{a.pixels.data, b.pixels.data};
        const detail::HalveKernel<Top> half{first, second, top, d1};
        device_.launch(queue, half.blocks_of(), half);
        const detail::HalveKernel<detail::KeptLevel> quarter{second, third, {d1}, d2};
        device_.launch(queue, quarter.blocks_of(), quarter);
        auto coarsest = level(third, detail::KeptLevel{d2}, 2, g2);
        auto middle = level(second, detail::KeptLevel{d1}, 1, g1);
        auto finest = level(first, top, 0, g.pixels.data);
        middle.coarse = g2;
        finest.coarse = g1;
        finest.add = true;
        finest.weight = static_cast<float>(weight);
        const Index chunks = finest.blocks_of() + middle.blocks_of() + coarsest.blocks_of();
        finest.partial = sums_.reserve(queue, chunks);
        middle.partial = finest.partial + finest.blocks_of();
        coarsest.partial = middle.partial + middle.blocks_of();
        device_.launch(queue, coarsest.blocks_of(), coarsest);
        device_.launch(queue, middle.blocks_of(), middle);
        device_.launch(queue, finest.blocks_of(), finest);
        return {finest.partial, chunks, 1.0, 0.0, weight};
    }
    /// Returns the memory held [bytes].
    std::size_t bytes() const { return levels_.bytes() + sums_.bytes(); }

  private:
    template <class Source>
    detail::PyramidKernel<Source> level(const detail::PyramidLevel& l, const Source& d,
                                        std::size_t index, float* g) const {
        const auto share = [&](Index n) {
            return static_cast<float>(n > 0 ? loss_.weight[index] / static_cast<double>(n) : 0.0);
        };
        const Index w = l.width, h = l.height, c = l.channels;
        return {l, d,      share((w - 1) * h * c), share(w * (h - 1) * c), nullptr, false, 0.0F,
                g, nullptr};
    }

    Device device_;
    PyramidGradientLoss loss_;
    DeviceBuffer<float> levels_;
    detail::LossSums sums_;
};

} // namespace rye
