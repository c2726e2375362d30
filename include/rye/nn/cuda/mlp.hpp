// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp.hpp: Mlp's forward pass and vjp for points in device memory: a block of points
/// through all layers by one kernel, on units of matrices.
///     DeviceMlp<CudaDevice, MlpTiles<1, 256, 128>> network(device, shape);
///     network.set(queue, parameters, frame);              // once a step
///     network.forward_into(queue, points, out);
///     network.vjp_into(queue, g_out, {gradient, g_points, g_frame});
/// Products take floats as N planes of bf16: relative errors about 3e-3, 1e-5 and 1e-6 for N = 1, 2
/// and 3. Sums are floats in a fixed order: the same build gives the same bits.
#pragma once

#include <string>
#include <vector>

#include <rye/core/error.hpp>
#include <rye/nn/cuda/mlp_weights.hpp>
#include <rye/nn/mlp.hpp>

namespace rye {

/// Weights (out x fan_in) and biases (out x 1) in device memory, as Mlp has them.
struct DeviceMlpParameters {
    std::vector<DeviceColumns<float>> weight, bias;
};

/// Destinations of gradients; null pointers skip one.
struct DeviceMlpGradient {
    DeviceMlpParameters params;       ///< added to
    DeviceColumns<float> points = {}; ///< overwritten, point inputs x N
    float* frame = nullptr;           ///< overwritten, frame inputs
};

/// A network in device memory with its forward pass and vjp, on the stream of each call.
template <class Device, class Tiles = MlpTiles<1, 256, 128>, Activation A = LeakyRelu>
class DeviceMlp {
  public:
    /// Throws an Error for a shape that does not fit the tiles.
    DeviceMlp(const Device& device, const MlpShape& shape) : device_(device), shape_(shape) {
        const auto within = [](const std::string& what, int x, int most) {
            require(x >= 0 && x <= most, "DeviceMlp",
                    what + " is " + std::to_string(x) + ", its tiles have room for " +
                        std::to_string(most));
        };
        within("number of layers", shape.layers(), DeviceMlpNetwork::most_layers);
        within("number of point inputs", shape.point_inputs(), Tiles::inputs);
        for (int l = 0; l < shape.layers(); ++l)
            within("width of layer " + std::to_string(l), shape.layer_out(l), Tiles::width);
    }

    const MlpShape& shape() const { return shape_; }

    /// Takes weights and biases, with frame inputs of the given values (null if there are none).
    void set(const CudaQueue& queue, const DeviceMlpParameters& p, const float* frame) {
        check(p);
        parameters_ = p;
        frame_ = frame;
        const int count = shape_.layers(), inputs = shape_.point_inputs();
        Index words = 0, biases = 0;
        for (int l = 0; l < count; ++l) {
            const int out = shape_.layer_out(l), hidden = shape_.hidden_in(l);
            words += 2 * MlpPackKernel::words(hidden, out, Tiles::N);
            if (shape_.reads_input(l)) words += 2 * MlpPackKernel::words(inputs, out, Tiles::N);
            biases += out;
        }
        packed_.reserve(queue, static_cast<std::size_t>(words) + 1);
        numbers_.reserve(queue, 2 * static_cast<std::size_t>(biases) + 1);
        std::uint32_t* word = packed_.data();
        float* bias = numbers_.data();
        network_.layers = count;
        network_.inputs = inputs;
        for (int l = 0; l < count; ++l) {
            const auto i = static_cast<std::size_t>(l);
            const int out = shape_.layer_out(l), hidden = shape_.hidden_in(l);
            DeviceMlpLayer& layer = network_.layer[l];
            layer = {
                hidden,  out,    shape_.reads_input(l), nullptr, nullptr, nullptr, nullptr, bias,
                nullptr, nullptr};
            const float* const w = p.weight[i].data;
            const auto pack = [&](const std::uint32_t*& to, const float* from, int k, int n,
                                  Index k_apart, Index n_apart) {
                const MlpPackKernel kernel{from, k_apart, n_apart, k, n, Tiles::N, word};
                device_.launch(queue, kernel.blocks_of(), kernel);
                to = word;
                word += MlpPackKernel::words(k, n, Tiles::N);
            };
            pack(layer.hidden_to_out, w, hidden, out, out, 1);
            pack(layer.out_to_hidden, w, out, hidden, 1, out);
            const float* const of_input = w + Index(hidden) * out;
            if (layer.takes_input) {
                pack(layer.input_to_out, of_input, inputs, out, out, 1);
                pack(layer.out_to_input, of_input, out, inputs, 1, out);
            }
            const MlpBiasKernel kernel{p.bias[i].data,
                                       of_input + Index(inputs) * out,
                                       frame,
                                       out,
                                       layer.takes_input ? shape_.frame_inputs : 0,
                                       bias};
            device_.launch(queue, kernel.blocks_of(), kernel);
            bias += out;
        }
    }

    /// out (outputs x N) of points (point inputs x N), before any output activation. `keep`: what
    /// a vjp reads.
    void forward_into(const CudaQueue& queue, const DeviceColumns<const float>& points,
                      const DeviceColumns<float>& out, bool keep = true) {
        shaped("points", points.rows, points.cols, shape_.point_inputs(), points.cols);
        shaped("outputs", out.rows, out.cols, shape_.outputs(), points.cols);
        require(static_cast<std::uint64_t>(points.cols) * Tiles::width < std::uint64_t(1) << 32U,
                "DeviceMlp",
                "number of points is " + std::to_string(points.cols) +
                    ", 2^32 numbers of a layer are the most");
        network_.points = static_cast<std::uint32_t>(points.cols);
        if (keep) place(queue);
        device_.launch(queue, blocks(), MlpForwardKernel<Tiles, A>{network_, points, out, keep});
    }

    /// Gradients for the cotangent g_out (outputs x N) of the last forward pass, which kept what
    /// is read here.
    void vjp_into(const CudaQueue& queue, const DeviceColumns<const float>& g_out,
                  const DeviceMlpGradient& g) {
        const Index n = network_.points;
        check(g.params);
        shaped("cotangents", g_out.rows, g_out.cols, shape_.outputs(), n);
        if (g.points.data != nullptr)
            shaped("gradient of points", g.points.rows, g.points.cols, shape_.point_inputs(), n);
        device_.launch(queue, blocks(), MlpReverseKernel<Tiles, A>{network_, g_out, g.points});
        using Weights = MlpWeightKernel<Tiles::N>;
        bool again = false;
        float* sum = numbers_.data();
        for (int l = 0; l < network_.layers; ++l) sum += network_.layer[l].out;
        for (int l = 0; l < network_.layers; ++l) {
            const auto i = static_cast<std::size_t>(l);
            const DeviceMlpLayer& layer = network_.layer[l];
            const MlpColumns columns{layer.hidden, layer.takes_input ? network_.inputs : 0};
            partial_.reserve(queue, std::size_t(Weights::slices) *
                                        static_cast<std::size_t>(columns.all()) *
                                        static_cast<std::size_t>(padded_16(layer.out)));
            const Weights weights{columns,
                                  layer.out,
                                  network_.points,
                                  layer.cotangent,
                                  l > 0 ? network_.layer[l - 1].activated : nullptr,
                                  network_.input,
                                  partial_.data()};
            device_.launch(queue, weights.blocks_of(), weights);
            const int of_frame = layer.takes_input ? shape_.frame_inputs : 0;
            const MlpMergeKernel merge{columns,
                                       layer.out,
                                       Weights::slices,
                                       of_frame,
                                       partial_.data(),
                                       frame_,
                                       g.params.weight[i].data,
                                       g.params.bias[i].data,
                                       sum};
            device_.launch(queue, merge.blocks_of(), merge);
            if (g.frame != nullptr && of_frame > 0) {
                const Index before = Index(layer.hidden + network_.inputs) * layer.out;
                const MlpFrameKernel frame{
                    parameters_.weight[i].data + before, sum, layer.out, of_frame, again, g.frame};
                device_.launch(queue, frame.blocks_of(), frame);
                again = true;
            }
            sum += layer.out;
        }
    }

    /// Memory that is held [bytes].
    std::size_t bytes() const {
        return packed_.bytes() + numbers_.bytes() + kept_.bytes() + partial_.bytes();
    }

  private:
    Index blocks() const { return (Index(network_.points) + Tiles::points - 1) / Tiles::points; }
    void place(const CudaQueue& queue) {
        const std::size_t n = network_.points;
        std::size_t halves =
            std::size_t(Tiles::N) * n * static_cast<std::size_t>(padded_16(network_.inputs));
        const auto of = [&](int l) {
            return std::size_t(Tiles::N) * n *
                   static_cast<std::size_t>(padded_16(network_.layer[l].out));
        };
        for (int l = 0; l < network_.layers; ++l)
            halves += (l + 1 < network_.layers ? 2 : 1) * of(l);
        kept_.reserve(queue, halves + 8);
        std::uint16_t* at = kept_.data();
        const auto next = [&](std::size_t size) {
            std::uint16_t* const own = at;
            at += size;
            return own;
        };
        network_.input =
            next(std::size_t(Tiles::N) * n * static_cast<std::size_t>(padded_16(network_.inputs)));
        for (int l = 0; l < network_.layers; ++l) {
            network_.layer[l].cotangent = next(of(l));
            network_.layer[l].activated = l + 1 < network_.layers ? next(of(l)) : nullptr;
        }
    }
    void check(const DeviceMlpParameters& p) const {
        const auto layers = static_cast<std::size_t>(shape_.layers());
        require(p.weight.size() == layers && p.bias.size() == layers, "DeviceMlp",
                "parameters are of " + std::to_string(p.weight.size()) + " layers, its shape has " +
                    std::to_string(layers));
        for (std::size_t l = 0; l < layers; ++l) {
            const int out = shape_.layer_out(static_cast<int>(l));
            shaped("weights", p.weight[l].rows, p.weight[l].cols, out,
                   shape_.fan_in(static_cast<int>(l)));
            shaped("biases", p.bias[l].rows, p.bias[l].cols, out, 1);
        }
    }
    static void shaped(const std::string& what, Index rows, Index cols, Index want_rows,
                       Index want_cols) {
        require(rows == want_rows && cols == want_cols, "DeviceMlp",
                what + " are " + std::to_string(rows) + " x " + std::to_string(cols) +
                    ", its shape has " + std::to_string(want_rows) + " x " +
                    std::to_string(want_cols));
    }

    Device device_;
    MlpShape shape_;
    DeviceMlpParameters parameters_;
    const float* frame_ = nullptr;
    DeviceMlpNetwork network_{};
    DeviceBuffer<std::uint32_t> packed_;
    DeviceBuffer<float> numbers_; ///< biases, then sums of cotangents
    DeviceBuffer<std::uint16_t> kept_;
    DeviceBuffer<float> partial_;
};

} // namespace rye
