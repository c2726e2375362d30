// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/label_drawing.hpp: LabelDrawing (train/label_drawing.hpp) on a device: it drives,
/// draws and differentiates there, and sums the products of derivatives.
///     DeviceLabelDrawing<E, CudaDevice> drawing(device, queue, {avatar, config, roles});
///     LabelRefiner refiner(Serial{}, drawing, unknowns);
/// All verbs wait. The same build gives the same bits.
#pragma once

#include <algorithm>
#include <limits>
#include <memory>
#include <vector>

#include <rye/avatar/cuda/drawer.hpp>
#include <rye/backend/cuda/each.hpp>
#include <rye/train/label_drawing.hpp>

namespace rye {

namespace detail {

/// Numbers of Gaussians with their first three features.
struct KeepColours {
    static constexpr const char* name = "Gaussians' colours";
    DeviceGaussians<const float> from;
    DeviceGaussians<float> to;

    RYE_DEVICE void operator()(Index i) const {
        one(from.mean, to.mean, i);
        one(from.rotation, to.rotation, i);
        one(from.scale, to.scale, i);
        one(from.opacity, to.opacity, i);
        one(from.feature, to.feature, i);
    }

  private:
    RYE_DEVICE void one(const DeviceColumns<const float>& a, const DeviceColumns<float>& b,
                        Index i) const {
        for (Index k = 0; k < b.rows; ++k) b.data[b.rows * i + k] = a.data[a.rows * i + k];
    }
};

/// Differences of these numbers from others of three features, over a length.
struct ColourDifference {
    static constexpr const char* name = "Gaussians' differences";
    DeviceGaussians<const float> from, at;
    DeviceGaussians<float> to;
    float over; ///< 1 / length

    RYE_DEVICE void operator()(Index i) const {
        one(from.mean, at.mean, to.mean, i);
        one(from.rotation, at.rotation, to.rotation, i);
        one(from.scale, at.scale, to.scale, i);
        one(from.opacity, at.opacity, to.opacity, i);
        one(from.feature, at.feature, to.feature, i);
    }

  private:
    RYE_DEVICE void one(const DeviceColumns<const float>& a, const DeviceColumns<const float>& b,
                        const DeviceColumns<float>& c, Index i) const {
        for (Index k = 0; k < c.rows; ++k)
            c.data[c.rows * i + k] = (a.data[a.rows * i + k] - b.data[b.rows * i + k]) * over;
    }
};

/// Sums, over a chunk of pixels, of products of the columns of pictures' derivatives, scaled, and
/// of the residual after them, in double. A block does 16 x 16 pairs of columns.
struct ColumnProductsKernel {
    static constexpr const char* name = "products of derivatives";
    static constexpr int side = 16, threads = side * side, blocks = 4;
    static constexpr Index chunk = 512; ///< pixels
    struct Shared {};
    const float* derivatives; ///< 3 x all pixels of each column
    Index numbers;            ///< of a column's derivatives
    Index columns;            ///< n
    const std::uint32_t* pixel;
    const double *scale, *residual; ///< 3 x pixels
    Index pixels;
    double* partial; ///< n + 1 x n + 1 of each chunk

    static Index tiles_of(Index columns) { return (columns + side) / side; }
    static Index chunks_of(Index pixels) { return (pixels + chunk - 1) / chunk; }

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        const Index tiles = (columns + side) / side, index = block.index();
        const Index at = index / (tiles * tiles), tile = index % (tiles * tiles);
        block.each_thread([&](int t) {
            const Index i = tile / tiles * side + t / side, j = tile % tiles * side + t % side;
            if (i > columns || j > i) return;
            const Index begin = at * chunk, end = begin + chunk < pixels ? begin + chunk : pixels;
            double sum = 0;
            for (Index p = begin; p < end; ++p)
                for (int k = 0; k < 3; ++k) sum += value(i, p, k) * value(j, p, k);
            double* const to = partial + at * (columns + 1) * (columns + 1);
            to[i * (columns + 1) + j] = to[j * (columns + 1) + i] = sum;
        });
    }

  private:
    RYE_DEVICE double value(Index column, Index p, int k) const {
        if (column == columns) return residual[3 * p + k];
        const float d = derivatives[column * numbers + 3 * Index(pixel[p]) + k];
        return static_cast<double>(d) * scale[3 * p + k];
    }
};

/// Adds arrays in their order.
struct AddChunks {
    static constexpr const char* name = "sum of chunks";
    const double* from; ///< size x count
    Index count, size;
    double* to;
    RYE_DEVICE void operator()(Index i) const {
        double sum = 0;
        for (Index c = 0; c < count; ++c) sum += from[c * size + i];
        to[i] = sum;
    }
};

} // namespace detail

/// LabelDrawing on a device. Policy: as DeviceDrawingPolicy, with kernels of 3 channels.
template <DeviceEffects E, class Device, class Policy = DeviceDrawingPolicy<>>
    requires RefinedEffects<E>
class DeviceLabelDrawing {
  public:
    using Number = float;
    using Labels = Drivers<float, E>;

    /// Takes a copy of the host's avatar, with the errors of DeviceAvatarDrawer.
    DeviceLabelDrawing(const Device& device, const CudaQueue& queue, const AvatarOnHost<E>& of)
        : device_(device),
          queue_(queue),
          width_(of.config.expression),
          drawer_(device, queue, of),
          frame_(device) {
        background_.reserve(queue, 3);
    }

    Index expression_width() const { return width_; }
    /// Draws with this dilation from now on [px^2].
    void set_dilation(double dilation) { rasterizer_.accuracy.dilation = dilation; }

    void drive(const Labels& labels) {
        drawer_.drive(queue_, labels);
        const DeviceGaussians<float>& driven = drawer_.avatar().cloud();
        gaussians_.reserve(queue_, driven.count(), 3);
        launch_each(device_, queue_, driven.count(),
                    detail::KeepColours{driven, gaussians_.view()});
    }
    void differentiate(const Labels& labels, const std::vector<Labels>& moved, double apart) {
        drive(labels);
        while (tangents_.size() < moved.size())
            tangents_.push_back(std::make_unique<detail::DeviceCloudBuffer>());
        count_ = moved.size();
        for (std::size_t k = 0; k < count_; ++k) {
            drawer_.drive(queue_, moved[k]);
            const DeviceGaussians<float>& driven = drawer_.avatar().cloud();
            tangents_[k]->reserve(queue_, driven.count(), 3);
            launch_each(device_, queue_, driven.count(),
                        detail::ColourDifference{driven, gaussians_.view(), tangents_[k]->view(),
                                                 static_cast<float>(1 / apart)});
        }
    }
    const Columns<float>& picture(const LabelView<float>& view) {
        const Index pixels = pixels_of(view);
        device_.send(queue_, background_.data(), view.background.data(), 3 * sizeof(float));
        drawn_.reserve(queue_, static_cast<std::size_t>(4 * pixels) + 1);
        const DeviceImages images{{drawn_.data(), 3, pixels},
                                  {drawn_.data() + 3 * pixels, 1, pixels}};
        do
            rasterizer_.forward_into(queue_, gaussians_.view(), view.camera, background_.data(),
                                     images, frame_);
        while (!frame_.finish(queue_));
        picture_.resize(3, pixels);
        fetch(picture_.data(), drawn_.data(), 3 * pixels);
        if (frame_.cost.non_finite > 0) // which would draw nothing
            picture_.setConstant(std::numeric_limits<float>::quiet_NaN());
        return picture_;
    }
    Columns<float> jacobian(const LabelView<float>& view, const std::vector<Index>& pixels) {
        derive(view);
        Columns<float> j(3 * static_cast<Index>(pixels.size()), static_cast<Index>(count_));
        Columns<float> d(3, pixels_of(view));
        for (Index k = 0; k < j.cols(); ++k) {
            fetch(d.data(), derivatives_.data() + k * d.size(), d.size());
            for (std::size_t i = 0; i < pixels.size(); ++i)
                j.block<3, 1>(3 * static_cast<Index>(i), k) = d.col(pixels[i]);
        }
        return j;
    }
    Columns<double> sums(const LabelView<float>& view, const WeighedColours& colours) {
        derive(view);
        const std::vector<std::uint32_t> pixel(colours.pixels.begin(), colours.pixels.end());
        const Index pixels = static_cast<Index>(pixel.size()), n = static_cast<Index>(count_);
        const Index chunks = detail::ColumnProductsKernel::chunks_of(pixels),
                    size = (n + 1) * (n + 1);
        const Index tiles = detail::ColumnProductsKernel::tiles_of(n);
        pixel_.reserve(queue_, pixel.size() + 1);
        device_.send(queue_, pixel_.data(), pixel.data(), pixel.size() * sizeof pixel[0]);
        weights_.reserve(queue_, static_cast<std::size_t>(6 * pixels) + 1);
        double* const residual = weights_.data() + 3 * pixels;
        device_.send(queue_, weights_.data(), colours.scale.data(), bytes<double>(3 * pixels));
        device_.send(queue_, residual, colours.residual.data(), bytes<double>(3 * pixels));
        partial_.reserve(queue_, static_cast<std::size_t>((chunks + 1) * size));
        device_.launch(
            queue_, chunks * tiles * tiles,
            detail::ColumnProductsKernel{derivatives_.data(), 3 * pixels_of(view), n, pixel_.data(),
                                         weights_.data(), residual, pixels, partial_.data()});
        double* const sum = partial_.data() + chunks * size;
        launch_each(device_, queue_, size, detail::AddChunks{partial_.data(), chunks, size, sum});
        Columns<double> r(n + 1, n + 1);
        device_.fetch(queue_, r.data(), sum, bytes<double>(size));
        return r;
    }

    /// Returns the memory that is held [bytes].
    std::size_t bytes() const {
        std::size_t sum = drawer_.bytes() + gaussians_.bytes() + frame_.bytes() + splats_.bytes() +
                          background_.bytes() + drawn_.bytes() + derivatives_.bytes() +
                          pixel_.bytes() + weights_.bytes() + partial_.bytes();
        for (const auto& t : tangents_) sum += t->bytes();
        return sum;
    }

  private:
    template <class T>
    static std::size_t bytes(Index n) {
        return static_cast<std::size_t>(n) * sizeof(T);
    }
    static Index pixels_of(const LabelView<float>& view) {
        return Index(view.camera.width) * view.camera.height;
    }
    void fetch(float* to, const float* from, Index n) const {
        device_.fetch(queue_, to, from, bytes<float>(n));
    }

    /// Puts the last picture's derivatives by all unknowns on the stream.
    void derive(const LabelView<float>& view) {
        const Index pixels = pixels_of(view);
        const auto n = static_cast<Index>(count_);
        // After the columns' colours two images of alpha, which nobody reads.
        derivatives_.reserve(queue_, static_cast<std::size_t>((3 * n + 2) * pixels) + 1);
        std::vector<detail::DeviceDirection<>> directions(count_);
        for (Index k = 0; k < n; ++k)
            directions[static_cast<std::size_t>(k)] = {
                tangents_[static_cast<std::size_t>(k)]->view(),
                nullptr,
                {{derivatives_.data() + 3 * k * pixels, 3, pixels},
                 {derivatives_.data() + (3 * n + k % 2) * pixels, 1, pixels}}};
        rasterizer_.template jvp_into<NoDistortion>(queue_, gaussians_.view(), directions,
                                                    view.camera, background_.data(), splats_,
                                                    frame_);
    }

    Device device_;
    CudaQueue queue_;
    Index width_;
    DeviceAvatarDrawer<E, Device, Policy> drawer_;
    DeviceRasterizer<typename Policy::Accuracy, Device, typename Policy::Channels> rasterizer_;
    DeviceFrame<Device> frame_;
    detail::DeviceCloudBuffer gaussians_; ///< of the labels, of 3 channels
    std::vector<std::unique_ptr<detail::DeviceCloudBuffer>> tangents_; ///< by unknown
    std::size_t count_ = 0;                                    ///< unknowns
    DeviceBuffer<detail::SplatRecord> splats_;
    DeviceBuffer<float> background_, drawn_, derivatives_;
    DeviceBuffer<std::uint32_t> pixel_;
    DeviceBuffer<double> weights_, partial_;
    Columns<float> picture_;
};

} // namespace rye
