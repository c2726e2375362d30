// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/upsampler.hpp: the super-resolution network of nn/upsampler.hpp for images in device
/// memory, all its variants, forward and back.
///     DeviceUpsampler<CudaDevice, 2> network(device, shape);
///     network.set(queue, device_upsampler(resident, host.upsampler));   // once a step
///     network.forward_into(queue, features, picture, trace);
///     network.vjp_into(queue, trace, g_picture, {gradient, g_features});
/// The outputs of convolutions are kept in floats, with moments of their channels, and normalised
/// where they are read. Planes of a layer's input are made again by the vjp, or kept. N planes of
/// bf16 as in nn/cuda/convolution.hpp.
#pragma once

#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include <rye/backend/cuda/picture.hpp>
#include <rye/backend/cuda/resident.hpp>
#include <rye/nn/cuda/convolution.hpp>
#include <rye/nn/cuda/instance_norm.hpp>
#include <rye/nn/cuda/upsampler_kernels.hpp>
#include <rye/nn/upsampler.hpp>

namespace rye {

/// The arrays of an Upsampler in device memory.
struct DeviceUpsamplerParameters {
    std::vector<DeviceColumns<float>> conv;
    DeviceColumns<float> out_weight, out_bias;
};

/// Returns the parameters of an upsampler that is, or is part of, the struct that `resident` was
/// laid out for.
template <class P, class Device>
DeviceUpsamplerParameters device_upsampler(const Resident<P, Device>& resident,
                                           const Upsampler<float>& host) {
    DeviceUpsamplerParameters r;
    for (const Columns<float>& w : host.conv) r.conv.push_back(resident.of(w));
    r.out_weight = resident.of(host.out_weight);
    r.out_bias = resident.of(host.out_bias);
    return r;
}

/// Trace of a forward pass for its vjp: one for each pass whose vjp is still to come.
struct DeviceUpsamplerTrace {
    std::vector<std::unique_ptr<DeviceBuffer<float>>> layer; ///< results, then means, then gains
    std::vector<std::unique_ptr<DeviceBuffer<std::uint16_t>>> planes; ///< planes of inputs, if kept
    DeviceBuffer<float> base;                                         ///< all sizes, if skip
    DevicePicture<const float> in; ///< the caller's, until the vjp
    DevicePicture<const float> out;

    /// Memory that is held [bytes].
    std::size_t bytes() const {
        std::size_t sum = base.bytes();
        for (const auto& l : layer) sum += l->bytes();
        for (const auto& p : planes) sum += p->bytes();
        return sum;
    }
};

/// Destinations of gradients.
struct DeviceUpsamplerGradient {
    DeviceUpsamplerParameters params; ///< added to
    DeviceColumns<float> in = {};     ///< overwritten, in_channels x pixels; null skips it
};

/// An upsampler in device memory with its forward pass and vjp, on the stream of each call.
template <class Device, int N>
class DeviceUpsampler {
  public:
    DeviceUpsampler(const Device& device, const UpsamplerShape& shape)
        : device_(device),
          shape_(shape),
          norm_(device) {
        for (int l = 0; l < shape.layers(); ++l)
            convolution_.push_back(std::make_unique<DeviceConvolution<Device, N>>(
                device, shape.layer_in(l), shape.block_out(l / 2)));
        doubling_.resize(2 * static_cast<std::size_t>(shape.doublings));
        for (auto& d : doubling_) d = std::make_unique<detail::DeviceDoubling<Device>>();
    }

    /// True if a trace keeps the planes of the layers' inputs: more memory, a faster vjp, the same
    /// numbers.
    bool keep_planes = false;

    const UpsamplerShape& shape() const { return shape_; }

    /// Takes the weights. Throws an Error for other shapes.
    void set(const CudaQueue& queue, const DeviceUpsamplerParameters& p) {
        check(p);
        parameters_ = p;
        detail::ConvolutionPackKernel kernel;
        for (std::size_t l = 0; l < convolution_.size(); ++l) {
            convolution_[l]->take(queue, p.conv[l], kernel);
            if (kernel.count + 2 <= detail::ConvolutionPackKernel::most &&
                l + 1 < convolution_.size())
                continue;
            device_.launch(queue, kernel.blocks_of(), kernel);
            kernel.count = 0;
        }
    }

    /// out (3 channels, 2^doublings times the size) of in (in_channels). Waits where the size is
    /// new. Throws an Error for shapes that do not fit.
    void forward_into(const CudaQueue& queue, const DevicePicture<const float>& in,
                      const DevicePicture<float>& out, DeviceUpsamplerTrace& trace) {
        const char* const who = "DeviceUpsampler";
        const int times = 1 << shape_.doublings;
        detail::require_picture(who, "input", in, shape_.in_channels, in.width, in.height);
        detail::require_picture(who, "output", out, 3, times * in.width, times * in.height);
        require(parameters_.out_weight.data != nullptr, who, "weights were not set");
        trace.in = in;
        trace.out = out;
        if (in.pixels.cols == 0) return;
        set_sizes(queue, in);
        trace.layer.resize(convolution_.size());
        trace.planes.resize(keep_planes ? convolution_.size() : 0);
        for (auto& p : trace.planes)
            if (p == nullptr) p = std::make_unique<DeviceBuffer<std::uint16_t>>();
        for (int l = 0; l < shape_.layers(); ++l) {
            auto& layer = trace.layer[static_cast<std::size_t>(l)];
            if (layer == nullptr) layer = std::make_unique<DeviceBuffer<float>>();
            const Layer s = size_of(trace, l);
            const int outputs = shape_.block_out(l / 2);
            layer->reserve(queue, static_cast<std::size_t>((s.pixels() + 2) * outputs));
            float* const result = layer->data();
            const DeviceImagePlanes planes =
                input_planes(queue, trace, l,
                             keep_planes ? *trace.planes[static_cast<std::size_t>(l)] : planes_[0]);
            if (shape_.norm == Normalization::none) {
                of(l).forward_into(queue, planes, result);
                continue;
            }
            const Index parts = of(l).forward_into(queue, planes, result, moments_);
            norm_.forward_into(queue, {moments_.data(), parts, outputs},
                               result + s.pixels() * outputs, result + (s.pixels() + 1) * outputs);
        }
        if (shape_.skip) make_base(queue, trace);
        const detail::LastLayerKernel kernel{{}, last_layer(trace), out.pixels.data};
        device_.launch(queue, kernel.blocks_of(), kernel);
    }

    /// Gradients for the cotangent g_out (3 x pixels) of the pass that left the trace, whose input
    /// and output are still there. Throws an Error for shapes that do not fit.
    void vjp_into(const CudaQueue& queue, const DeviceUpsamplerTrace& trace,
                  const DeviceColumns<const float>& g_out, const DeviceUpsamplerGradient& to) {
        const char* const who = "DeviceUpsampler";
        check(to.params);
        require(g_out.rows == 3 && g_out.cols == trace.out.pixels.cols, who, "cotangent is ",
                g_out.rows, " x ", g_out.cols, ", expected 3 x ", trace.out.pixels.cols);
        require(to.in.data == nullptr ||
                    (to.in.rows == shape_.in_channels && to.in.cols == trace.in.pixels.cols),
                who, "gradient of the input is ", to.in.rows, " x ", to.in.cols);
        if (trace.in.pixels.cols == 0) return;
        reserve(queue, trace);
        float *g = g_[0].data(), *other = g_[1].data();
        last_layer_vjp(queue, trace, g_out, to, g);
        for (int l = shape_.layers() - 1; l >= 0; --l) {
            const Layer s = size_of(trace, l);
            const DeviceImagePlanes planes = cotangent_planes(queue, trace, l, g);
            of(l).vjp_weight_into(queue, input_planes_again(queue, trace, l), planes,
                                  to.params.conv[static_cast<std::size_t>(l)].data, partial_);
            if (l == 0 && to.in.data == nullptr) return;
            of(l).vjp_input_into(queue, planes, l == 0 ? to.in.data : other);
            if (l > 0 && l % 2 == 0) {
                const std::size_t d = static_cast<std::size_t>(l / 2 - 1);
                const int channels = shape_.layer_in(l);
                double_vjp(queue, {other, s.width / 2, s.height / 2, channels, d},
                           {g, channels, false});
            } else {
                std::swap(g, other);
            }
        }
        if (shape_.skip) base_vjp(queue, trace, to.in.data);
    }

    /// Memory that is held beside traces [bytes].
    std::size_t bytes() const {
        std::size_t sum =
            norm_.bytes() + moments_.bytes() + partial_.bytes() + sums_.bytes() + means_.bytes();
        for (const auto& c : convolution_) sum += c->bytes();
        for (const auto& d : doubling_) sum += d->bytes();
        for (const auto& b : planes_) sum += b.bytes();
        for (const auto& b : g_) sum += b.bytes();
        for (const auto& b : g_base_) sum += b.bytes();
        return sum;
    }

  private:
    struct Layer {
        int width, height;
        Index pixels() const { return Index(width) * height; }
    };
    Layer size_of(const DeviceUpsamplerTrace& t, int l) const {
        return {t.in.width << (l / 2), t.in.height << (l / 2)};
    }
    DeviceConvolution<Device, N>& of(int l) { return *convolution_[static_cast<std::size_t>(l)]; }

    void set_sizes(const CudaQueue& queue, const DevicePicture<const float>& in) {
        for (int d = 0; d < shape_.doublings; ++d) {
            doubling_[2 * static_cast<std::size_t>(d)]->set(device_, queue, in.width << d);
            doubling_[2 * static_cast<std::size_t>(d) + 1]->set(device_, queue, in.height << d);
        }
    }
    /// The result of layer l, as what follows reads it.
    detail::ActivatedPixels activated(const DeviceUpsamplerTrace& t, int l) const {
        const Layer s = size_of(t, l);
        const int channels = shape_.block_out(l / 2);
        const float* const result = t.layer[static_cast<std::size_t>(l)]->data();
        detail::DeviceNorm norm;
        if (shape_.norm == Normalization::instance)
            norm = {result + s.pixels() * channels, result + (s.pixels() + 1) * channels};
        return {result, s.width, channels, norm};
    }
    /// A source at twice its size, doubling d.
    template <class Source>
    detail::DoubledPixels<Source> doubled(const Source& source, std::size_t d) const {
        return {source, doubling_[2 * d]->taps(), doubling_[2 * d + 1]->taps()};
    }
    DeviceImagePlanes shaped(const CudaQueue& queue, DeviceBuffer<std::uint16_t>& to,
                             const Layer& s, int channels) const {
        DeviceImagePlanes planes{nullptr, s.width, s.height, channels};
        to.reserve(queue, planes.halves(N));
        planes.data = to.data();
        return planes;
    }
    /// Makes the planes that layer l multiplies.
    DeviceImagePlanes input_planes(const CudaQueue& queue, const DeviceUpsamplerTrace& t, int l,
                                   DeviceBuffer<std::uint16_t>& memory) {
        const DeviceImagePlanes to = shaped(queue, memory, size_of(t, l), shape_.layer_in(l));
        if (l == 0)
            image_planes_into<N>(
                device_, queue,
                detail::PlainPixels{t.in.pixels.data, t.in.width, shape_.in_channels}, to);
        else if (l % 2 == 1)
            image_planes_into<N>(device_, queue, activated(t, l - 1), to);
        else
            image_planes_into<N>(device_, queue,
                                 doubled(activated(t, l - 1), static_cast<std::size_t>(l / 2 - 1)),
                                 to);
        return to;
    }
    /// Returns the planes of a forward pass, kept or made again.
    DeviceImagePlanes input_planes_again(const CudaQueue& queue, const DeviceUpsamplerTrace& t,
                                         int l) {
        if (t.planes.empty()) return input_planes(queue, t, l, planes_[0]);
        const Layer s = size_of(t, l);
        return {t.planes[static_cast<std::size_t>(l)]->data(), s.width, s.height,
                shape_.layer_in(l)};
    }
    /// The cotangent of layer l's convolution, from g, that of relu's output.
    DeviceImagePlanes cotangent_planes(const CudaQueue& queue, const DeviceUpsamplerTrace& t, int l,
                                       const float* g) {
        const detail::ActivatedPixels own = activated(t, l);
        const Layer s = size_of(t, l);
        const DeviceImagePlanes to = shaped(queue, planes_[1], s, own.channels);
        detail::CotangentPixels source{g,        own.from, own.width, own.channels,
                                       own.norm, nullptr,  nullptr};
        if (own.norm.mean != nullptr) {
            norm_.vjp_into(queue, {own.from, own.channels, s.pixels()}, g, own.norm, means_.data());
            source.mean_g = means_.data();
            source.mean_gy = means_.data() + own.channels;
        }
        image_planes_into<N>(device_, queue, source, to);
        return to;
    }

    detail::LastLayer last_layer(const DeviceUpsamplerTrace& t) const {
        const float* const base =
            shape_.skip ? t.base.data() + base_at(t, shape_.doublings) : nullptr;
        return {activated(t, shape_.layers() - 1), t.out.pixels.cols, parameters_.out_weight.data,
                parameters_.out_bias.data, base};
    }
    /// Returns the beginning of the base after d doublings.
    Index base_at(const DeviceUpsamplerTrace& t, int d) const {
        Index at = 0;
        for (int k = 0; k < d; ++k) at += 3 * size_of(t, 2 * k).pixels();
        return at;
    }
    void make_base(const CudaQueue& queue, DeviceUpsamplerTrace& t) {
        t.base.reserve(queue, static_cast<std::size_t>(base_at(t, shape_.doublings + 1)));
        const auto run = [&](const auto& source, int d) {
            const Layer s = size_of(t, 2 * d);
            const detail::FirstChannelsKernel<std::decay_t<decltype(source)>> kernel{
                source, s.width, s.height, t.base.data() + base_at(t, d)};
            device_.launch(queue, kernel.blocks_of(), kernel);
        };
        run(detail::PlainPixels{t.in.pixels.data, t.in.width, shape_.in_channels}, 0);
        for (int d = 0; d < shape_.doublings; ++d)
            run(doubled(
                    detail::PlainPixels{t.base.data() + base_at(t, d), size_of(t, 2 * d).width, 3},
                    static_cast<std::size_t>(d)),
                d + 1);
    }

    void last_layer_vjp(const CudaQueue& queue, const DeviceUpsamplerTrace& t,
                        const DeviceColumns<const float>& g_out, const DeviceUpsamplerGradient& to,
                        float* g) {
        detail::LastLayerVjpKernel kernel{
            {}, last_layer(t), t.out.pixels.data, g_out.data, g, g_base_[0].data(), nullptr};
        const int numbers = kernel.numbers();
        sums_.reserve(queue, static_cast<std::size_t>(kernel.blocks_of() * numbers));
        kernel.partial = sums_.data();
        device_.launch(queue, kernel.blocks_of(), kernel);
        const auto sum = [&](float* into, int first, int count) {
            device_.launch(queue, count,
                           detail::OrderedSumKernel{sums_.data() + first, kernel.blocks_of(),
                                                    numbers, 1.0, true, into});
        };
        sum(to.params.out_weight.data, 0, numbers - 3);
        sum(to.params.out_bias.data, numbers - 3, 3);
    }

    /// Cotangent of an image at twice the size of (width, height), doubling d.
    struct Doubled {
        const float* g;
        int width, height, channels;
        std::size_t d;
    };
    struct Destination {
        float* to;
        int channels;
        bool add;
    };
    void double_vjp(const CudaQueue& queue, const Doubled& from, const Destination& to) {
        const detail::DoublingVjpKernel kernel{from.g,
                                               from.width,
                                               from.height,
                                               from.channels,
                                               doubling_[2 * from.d]->gather(),
                                               doubling_[2 * from.d + 1]->gather(),
                                               to.to,
                                               to.channels,
                                               to.add};
        device_.launch(queue, kernel.blocks_of(), kernel);
    }
    /// Adds the cotangent of the base to the first channels of the input's.
    void base_vjp(const CudaQueue& queue, const DeviceUpsamplerTrace& t, float* g_in) {
        float *g = g_base_[0].data(), *other = g_base_[1].data();
        for (int d = shape_.doublings - 1; d >= 0; --d) {
            const Layer s = size_of(t, 2 * d);
            const Doubled from{g, s.width, s.height, 3, static_cast<std::size_t>(d)};
            if (d == 0)
                double_vjp(queue, from, {g_in, shape_.in_channels, true});
            else
                double_vjp(queue, from, {other, 3, false});
            std::swap(g, other);
        }
        if (shape_.doublings > 0) return;
        const detail::AddChannelsKernel kernel{g, t.in.pixels.cols, shape_.in_channels, g_in};
        device_.launch(queue, kernel.blocks_of(), kernel);
    }

    /// Memory of a vjp.
    void reserve(const CudaQueue& queue, const DeviceUpsamplerTrace& t) {
        Index most = 0, channels = 0;
        for (int l = 0; l < shape_.layers(); ++l) {
            const Index wide = std::max(shape_.layer_in(l), shape_.block_out(l / 2));
            most = std::max(most, wide * size_of(t, l).pixels());
            channels = std::max(channels, wide);
        }
        for (auto& b : g_) b.reserve(queue, static_cast<std::size_t>(most));
        means_.reserve(queue, 2 * static_cast<std::size_t>(channels));
        if (shape_.skip)
            for (auto& b : g_base_)
                b.reserve(queue, 3 * static_cast<std::size_t>(t.out.pixels.cols));
    }
    void check(const DeviceUpsamplerParameters& p) const {
        const auto shaped_as = [](const std::string& what, const DeviceColumns<float>& a,
                                  Index rows, Index cols) {
            require(a.rows == rows && a.cols == cols, "DeviceUpsampler", what, " is ", a.rows,
                    " x ", a.cols, ", its shape has ", rows, " x ", cols);
        };
        require(p.conv.size() == convolution_.size(), "DeviceUpsampler", "parameters are of ",
                p.conv.size(), " layers, its shape has ", convolution_.size());
        for (std::size_t l = 0; l < convolution_.size(); ++l)
            shaped_as("weight of layer " + std::to_string(l), p.conv[l], convolution_[l]->outputs(),
                      Index(9) * convolution_[l]->inputs());
        shaped_as("last weight", p.out_weight, 3, shape_.capacity);
        shaped_as("last bias", p.out_bias, 3, 1);
    }

    Device device_;
    UpsamplerShape shape_;
    DeviceUpsamplerParameters parameters_;
    std::vector<std::unique_ptr<DeviceConvolution<Device, N>>> convolution_;
    std::vector<std::unique_ptr<detail::DeviceDoubling<Device>>>
        doubling_; ///< across and down of each
    DeviceInstanceNorm<Device> norm_;
    DeviceBuffer<std::uint16_t> planes_[2];
    DeviceBuffer<float> g_[2], g_base_[2], partial_, means_;
    DeviceBuffer<double> sums_;
    DeviceBuffer<detail::StripMoments> moments_;
};

} // namespace rye
