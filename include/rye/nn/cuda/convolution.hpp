// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/convolution.hpp: nn/convolution.hpp's 3 x 3 convolution with zero padding for images
/// in device memory, on units of matrices, and its vjps.
///     DeviceConvolution<CudaDevice, 2> layer(device, inputs, outputs);
///     layer.set(queue, weight);                            // once a step
///     image_planes_into<2>(device, queue, source, planes);
///     layer.forward_into(queue, planes, out);
/// Products take floats as N planes of bf16: relative errors about 3e-3, 1e-5 and 1e-6 for N = 1, 2
/// and 3. Sums are in a fixed order: the same build gives the same bits.
#pragma once

#include <string>

#include <rye/nn/cuda/convolution_kernels.hpp>
#include <rye/nn/cuda/convolution_operands.hpp>
#include <rye/nn/cuda/convolution_weights.hpp>

namespace rye {

/// Writes an image of a source (image_planes.hpp) as N planes; `to.data` has room for
/// to.halves(N) numbers.
template <int N, class Device, class Source>
void image_planes_into(const Device& device, const CudaQueue& queue, const Source& source,
                       const DeviceImagePlanes& to) {
    const std::uint64_t eights =
        static_cast<std::uint64_t>(N) * static_cast<std::uint64_t>(to.width) *
        static_cast<std::uint64_t>(to.height) * static_cast<std::uint64_t>(to.padded() / 8);
    require(eights < std::uint64_t(1) << 32U, "image planes", "image of ", to.width, " x ",
            to.height, " x ", to.channels, " is too large, 2^35 numbers are the most");
    const detail::ImagePlanesKernel<N, Source> kernel{source, to};
    device.launch(queue, kernel.blocks_of(), kernel);
}

/// A convolution of `inputs` to `outputs` channels in device memory.
template <class Device, int N>
class DeviceConvolution {
  public:
    DeviceConvolution(const Device& device, int inputs, int outputs)
        : device_(device),
          inputs_(inputs),
          outputs_(outputs) {
        require(inputs >= 1 && outputs >= 1, "DeviceConvolution", "got ", inputs, " inputs and ",
                outputs, " outputs, expected at least 1");
    }

    /// Blocks that the gradient of the weights is cut into, about; its rounding depends on it.
    int weight_blocks = ConvolutionSlices::aim;

    int inputs() const { return inputs_; }
    int outputs() const { return outputs_; }

    /// Takes weights, outputs x 9 inputs. Throws an Error for another shape.
    void set(const CudaQueue& queue, const DeviceColumns<const float>& weight) {
        detail::ConvolutionPackKernel kernel;
        take(queue, weight, kernel);
        device_.launch(queue, kernel.blocks_of(), kernel);
    }
    /// The same, as two jobs of a kernel that is launched later.
    void take(const CudaQueue& queue, const DeviceColumns<const float>& weight,
              detail::ConvolutionPackKernel& to) {
        require(weight.rows == outputs_ && weight.cols == Index(9) * inputs_, "DeviceConvolution",
                "weights are ", weight.rows, " x ", weight.cols, ", expected ", outputs_, " x ",
                9 * inputs_);
        const Index in = inputs_, out = outputs_;
        to.job[to.count++] = job(
            queue, {weight.data, 0, in * out, out, 1, inputs_, outputs_, 0, N, nullptr}, forward_);
        // The adjoint's taps are turned by 180 degrees.
        to.job[to.count++] = job(
            queue, {weight.data, 8 * in * out, -in * out, 1, out, outputs_, inputs_, 0, N, nullptr},
            adjoint_);
    }
    /// out (outputs x pixels, floats) of an image's planes; with a bias (`outputs` numbers)
    /// relu(out + bias).
    void forward_into(const CudaQueue& queue, const DeviceImagePlanes& in, float* out,
                      const float* bias = nullptr) const {
        channels("image", in.channels, inputs_);
        multiply(queue, in, forward_.data(), {outputs_, out, bias, nullptr});
    }
    /// The same without a bias, and moments of the channels of the result, over strips of its
    /// pixels; returns how many strips.
    Index forward_into(const CudaQueue& queue, const DeviceImagePlanes& in, float* out,
                       DeviceBuffer<detail::StripMoments>& moments) const {
        channels("image", in.channels, inputs_);
        Index count = 0;
        with_tiles(outputs_, [&](auto tiles) {
            count =
                detail::ConvolutionKernel<decltype(tiles)>{in, nullptr, {outputs_, out}}.strips();
        });
        moments.reserve(queue, static_cast<std::size_t>(count * outputs_) + 1);
        multiply(queue, in, forward_.data(), {outputs_, out, nullptr, moments.data()});
        return count;
    }
    /// The cotangent of the image (inputs x pixels, floats), from that of the output as planes.
    void vjp_input_into(const CudaQueue& queue, const DeviceImagePlanes& g, float* g_in) const {
        channels("cotangent", g.channels, outputs_);
        multiply(queue, g, adjoint_.data(), {inputs_, g_in, nullptr, nullptr});
    }
    /// Adds the cotangent of the weights. `partial` is memory for its sums.
    void vjp_weight_into(const CudaQueue& queue, const DeviceImagePlanes& in,
                         const DeviceImagePlanes& g, float* g_weight,
                         DeviceBuffer<float>& partial) const {
        channels("image", in.channels, inputs_);
        channels("cotangent", g.channels, outputs_);
        require(in.width == g.width && in.height == g.height, "DeviceConvolution", "image of ",
                in.width, " x ", in.height, ", its cotangent of ", g.width, " x ", g.height);
        if (in.pixels() == 0) return;
        const ConvolutionSlices cut{in.width, in.height, inputs_, outputs_, N, weight_blocks};
        partial.reserve(queue, cut.numbers());
        with_blocks(cut, [&](auto high, auto wide) {
            const detail::ConvolutionWeightKernel<N, decltype(high)::value, decltype(wide)::value>
                kernel{cut, in, g, partial.data()};
            device_.launch(queue, kernel.blocks_of(), kernel);
        });
        const detail::ConvolutionMergeKernel merge{cut, partial.data(), g_weight};
        device_.launch(queue, merge.blocks_of(), merge);
    }
    /// Memory that is held [bytes].
    std::size_t bytes() const { return forward_.bytes() + adjoint_.bytes(); }

  private:
    /// f of the sizes of a block's work for this many outputs.
    template <class F>
    static void with_tiles(int outputs, const F& f) {
        if constexpr (N == 3)
            f(detail::ConvolutionTiles<3, 32, 2, 4, 2>());
        else if (outputs <= 32)
            f(detail::ConvolutionTiles < N, 32, N == 1 ? 8 : 4, 4, N > ());
        else
            f(detail::ConvolutionTiles < N, 64, N == 1 ? 8 : 4, 2 * N, 2 > ());
    }

    /// f of the outputs and the inputs of a block of the weights' gradient.
    template <class F>
    static void with_blocks(const ConvolutionSlices& cut, const F& f) {
        const auto with_inputs = [&](auto high) {
            if constexpr (N == 1)
                if (cut.wide() == 64) return f(high, Constant<64>{});
            f(high, Constant<32>{});
        };
        if constexpr (N == 1)
            if (cut.high() == 64) return with_inputs(Constant<64>{});
        with_inputs(Constant<32>{});
    }

    detail::ConvolutionPackJob job(const CudaQueue& queue, detail::ConvolutionPackJob job,
                                   DeviceBuffer<std::uint32_t>& to) const {
        with_tiles(job.n_count, [&](auto tiles) { job.outputs = decltype(tiles)::outputs; });
        to.reserve(queue, static_cast<std::size_t>(job.words()) * N);
        job.to = to.data();
        return job;
    }
    void multiply(const CudaQueue& queue, const DeviceImagePlanes& in, const std::uint32_t* weight,
                  const detail::ConvolutionResult& r) const {
        require(weight != nullptr, "DeviceConvolution", "weights were not set");
        require(static_cast<std::uint64_t>(in.width) * static_cast<std::uint64_t>(r.outputs) <
                    std::uint64_t(1) << 32U,
                "DeviceConvolution", "a row has more than 2^32 numbers");
        with_tiles(r.outputs, [&](auto tiles) {
            const detail::ConvolutionKernel<decltype(tiles)> kernel{in, weight, r};
            device_.launch(queue, kernel.blocks_of(), kernel);
        });
    }
    static void channels(const char* what, int got, int want) {
        require(got == want, "DeviceConvolution", what, " has ", got, " channels, expected ", want);
    }

    Device device_;
    int inputs_, outputs_;
    DeviceBuffer<std::uint32_t> forward_, adjoint_;
};

} // namespace rye
