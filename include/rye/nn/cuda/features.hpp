// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/features.hpp: the feature extractor of nn/features.hpp for images in device memory,
/// forward and back to the image. Weights are the user's, taken once; they are not trained.
#pragma once

#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include <rye/nn/cuda/convolution.hpp>
#include <rye/nn/features.hpp>

namespace rye {

namespace detail {

/// The cotangent of an image from that of its 2 x 2 maxima.
struct PoolVjpKernel {
    static constexpr const char* name = "gradient of pooling";
    static constexpr int threads = 256, blocks = 4;
    struct Shared {};
    const float *image, *g; ///< channels x pixels; of half the size
    int width, height, channels;
    float* to; ///< destination, of the image's shape

    Index blocks_of() const { return (Index(width) * height * channels + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const Index i = Index(block.index()) * threads + t;
            const Index row = Index(width) * channels;
            if (i >= row * height) return;
            const Index y = i / row, x = i % row / channels, c = i % channels;
            if (x / 2 >= width / 2 || y / 2 >= height / 2) { // an odd last row or column
                to[i] = 0;
                return;
            }
            const float *const top = image + y / 2 * 2 * row + x / 2 * 2 * channels + c,
                               *const bottom = top + row;
            const int best =
                detail::largest_of_four(top[0], top[channels], bottom[0], bottom[channels]);
            const bool own = best == y % 2 * 2 + x % 2;
            to[i] = own ? g[(y / 2 * (width / 2) + x / 2) * channels + c] : 0.0F;
        });
    }
};

} // namespace detail

/// Outputs of all convolutions after ReLU, for the vjp.
struct DeviceVggTrace {
    int width = 0, height = 0; ///< image's extent [px]
    std::vector<std::unique_ptr<DeviceBuffer<float>>> layer;

    /// Memory that is held [bytes].
    std::size_t bytes() const {
        std::size_t sum = 0;
        for (const auto& l : layer) sum += l->bytes();
        return sum;
    }
};

namespace detail {

/// The features of a slice: channels x pixels.
struct DeviceFeature {
    DeviceColumns<const float> pixels;
    int width, height;
};

} // namespace detail

/// The feature extractor in device memory.
template <class Device, int N>
class DeviceVgg {
  public:
    DeviceVgg(const Device& device, const VggShape& shape) : device_(device), shape_(shape) {
        int in = shape.in_channels;
        for (std::size_t s = 0; s < vgg_slices; ++s)
            for (int k = 0; k < shape.convolutions[s]; ++k) {
                const int out = shape.channels[s];
                layers_.push_back({static_cast<int>(s), k == 0 && s > 0, in, out});
                convolution_.push_back(
                    std::make_unique<DeviceConvolution<Device, N>>(device, in, out));
                in = out;
            }
    }

    const VggShape& shape() const { return shape_; }

    /// Takes the weights; waits. Throws an Error for a network of another shape.
    void set(const CudaQueue& queue, const Vgg<float>& net) {
        require(net.weight.size() == layers_.size(), "DeviceVgg", "network has ", net.weight.size(),
                " convolutions, its shape ", layers_.size());
        Index most = 0, biases = 0;
        for (std::size_t l = 0; l < layers_.size(); ++l) {
            most = std::max(most, net.weight[l].size());
            biases += layers_[l].out;
        }
        weight_.reserve(queue, static_cast<std::size_t>(most));
        bias_.reserve(queue, static_cast<std::size_t>(biases));
        float* bias = bias_.data();
        for (std::size_t l = 0; l < layers_.size(); ++l) {
            const Columns<float>&w = net.weight[l], &b = net.bias[l];
            require(b.size() == layers_[l].out, "DeviceVgg", "bias of convolution ", l, " has ",
                    b.size(), " numbers, expected ", layers_[l].out);
            device_.send(queue, weight_.data(), w.data(),
                         static_cast<std::size_t>(w.size()) * sizeof(float));
            convolution_[l]->set(queue, {weight_.data(), w.rows(), w.cols()});
            device_.send(queue, bias, b.data(), static_cast<std::size_t>(b.size()) * sizeof(float));
            layers_[l].bias = bias;
            bias += layers_[l].out;
        }
    }

    /// The features of an image of a source (image_planes.hpp). Throws an Error for fewer than 16
    /// pixels a side.
    template <class Source>
    void forward_into(const CudaQueue& queue, const Source& source, int width, int height,
                      DeviceVggTrace& trace) {
        require(width >= 16 && height >= 16, "DeviceVgg", "got ", width, " x ", height,
                " pixels, expected at least 16 x 16");
        trace.width = width;
        trace.height = height;
        trace.layer.resize(layers_.size());
        for (std::size_t l = 0; l < layers_.size(); ++l) {
            const Layer& layer = layers_[l];
            if (trace.layer[l] == nullptr) trace.layer[l] = std::make_unique<DeviceBuffer<float>>();
            const int w = width >> layer.slice, h = height >> layer.slice;
            const DeviceImagePlanes in = shaped(queue, {nullptr, w, h, layer.in});
            if (l == 0)
                image_planes_into<N>(device_, queue, source, in);
            else if (layer.pooled)
                image_planes_into<N>(device_, queue,
                                     detail::PooledPixels{trace.layer[l - 1]->data(),
                                                          width >> (layer.slice - 1), layer.in},
                                     in);
            else
                image_planes_into<N>(device_, queue,
                                     detail::PlainPixels{trace.layer[l - 1]->data(), w, layer.in},
                                     in);
            trace.layer[l]->reserve(queue, static_cast<std::size_t>(in.pixels() * layer.out));
            convolution_[l]->forward_into(queue, in, trace.layer[l]->data(), layer.bias);
        }
    }
    detail::DeviceFeature feature(const DeviceVggTrace& t, int slice) const {
        std::size_t l = layers_.size() - 1;
        while (layers_[l].slice > slice) --l;
        const int w = t.width >> slice, h = t.height >> slice;
        return {{t.layer[l]->data(), layers_[l].out, Index(w) * h}, w, h};
    }

    /// The cotangent of the image (in_channels x pixels, floats). add(slice, g, again) writes the
    /// cotangent of a slice's features to g, or with `again` adds it.
    template <class F>
    void vjp_input_into(const CudaQueue& queue, const DeviceVggTrace& t, const F& add,
                        float* g_in) {
        reserve(queue, t);
        float *g = g_[0].data(), *other = g_[1].data();
        for (std::size_t l = layers_.size(); l-- > 0;) {
            const Layer& layer = layers_[l];
            const int w = t.width >> layer.slice, h = t.height >> layer.slice;
            const float* const own = t.layer[l]->data();
            const bool last = l + 1 == layers_.size();
            if (last || layers_[l + 1].pooled) {
                if (!last) {
                    const detail::PoolVjpKernel kernel{own, g, w, h, layer.out, other};
                    device_.launch(queue, kernel.blocks_of(), kernel);
                    std::swap(g, other);
                }
                add(layer.slice, g, !last);
            }
            const DeviceImagePlanes planes = shaped(queue, {nullptr, w, h, layer.out});
            image_planes_into<N>(
                device_, queue, detail::CotangentPixels{g, own, w, layer.out, {}, nullptr, nullptr},
                planes);
            convolution_[l]->vjp_input_into(queue, planes, l == 0 ? g_in : other);
            std::swap(g, other);
        }
    }

    /// Memory that is held beside traces [bytes].
    std::size_t bytes() const {
        std::size_t sum = weight_.bytes() + bias_.bytes() + planes_.bytes();
        for (const auto& c : convolution_) sum += c->bytes();
        for (const auto& b : g_) sum += b.bytes();
        return sum;
    }

  private:
    struct Layer {
        int slice;
        bool pooled; ///< its input is the slice before, at half the size
        int in, out;
        const float* bias = nullptr;
    };
    DeviceImagePlanes shaped(const CudaQueue& queue, DeviceImagePlanes planes) {
        planes_.reserve(queue, planes.halves(N));
        planes.data = planes_.data();
        return planes;
    }
    void reserve(const CudaQueue& queue, const DeviceVggTrace& t) {
        Index most = 0;
        for (const Layer& l : layers_)
            most = std::max(
                most, Index(t.width >> l.slice) * (t.height >> l.slice) * std::max(l.in, l.out));
        for (auto& b : g_) b.reserve(queue, static_cast<std::size_t>(most));
    }

    Device device_;
    VggShape shape_;
    std::vector<Layer> layers_;
    std::vector<std::unique_ptr<DeviceConvolution<Device, N>>> convolution_;
    DeviceBuffer<float> weight_, bias_, g_[2];
    DeviceBuffer<std::uint16_t> planes_;
};

} // namespace rye
