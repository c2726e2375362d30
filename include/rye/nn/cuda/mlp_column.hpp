// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_column.hpp: Mlp of one column in device memory, for networks that run once a
/// frame: a block passes all layers, in float. Gradients of weights are products of two columns.
#pragma once

#include <string>

#include <rye/backend/cuda/each.hpp>
#include <rye/nn/cuda/mlp.hpp>

namespace rye {

namespace detail {

/// A layer of a network of one column.
struct MlpColumnLayer {
    const float* weight; ///< out x (hidden + inputs)
    const float* bias;
    int hidden, inputs, out; ///< hidden is 0 for the first layer, inputs where they are not taken
    float* value;            ///< outputs
    float* cotangent;        ///< cotangents of the sums before the activation
};

/// A network of one column as its kernels take it.
struct MlpColumnNetwork {
    MlpColumnLayer layer[DeviceMlpNetwork::most_layers];
    int layers;
    const float* input;
};

/// All layers, forward.
template <class A>
struct MlpColumnForwardKernel {
    static constexpr const char* name = "network of a column, forward";
    static constexpr int threads = 256, blocks = 1;
    struct Shared {};
    MlpColumnNetwork network;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        for (int l = 0; l < network.layers; ++l) {
            const MlpColumnLayer& layer = network.layer[l];
            const float* const below = l > 0 ? network.layer[l - 1].value : nullptr;
            const bool last = l + 1 == network.layers;
            block.each_thread([&](int t) {
                for (int o = t; o < layer.out; o += threads) {
                    const float* w = layer.weight + o;
                    float sum = 0;
                    for (int k = 0; k < layer.hidden; ++k, w += layer.out) sum += *w * below[k];
                    for (int k = 0; k < layer.inputs; ++k, w += layer.out)
                        sum += *w * network.input[k];
                    sum += layer.bias[o];
                    layer.value[o] = last ? sum : A::value(sum);
                }
            });
        }
    }
};

/// Cotangents of all layers' sums, and of the inputs; `g_out` is that of the outputs.
template <class A>
struct MlpColumnReverseKernel {
    static constexpr const char* name = "network of a column, reverse";
    static constexpr int threads = 256, blocks = 1;
    struct Shared {};
    MlpColumnNetwork network;
    const float* g_out;
    float* g_input; ///< overwritten

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        const MlpColumnLayer& top = network.layer[network.layers - 1];
        block.each_thread([&](int t) {
            for (int o = t; o < top.out; o += threads) top.cotangent[o] = g_out[o];
            for (int k = t; k < network.layer[0].inputs; k += threads) g_input[k] = 0.0F;
        });
        for (int l = network.layers - 1; l >= 0; --l) {
            const MlpColumnLayer& layer = network.layer[l];
            block.each_thread([&](int t) {
                for (int k = t; k < layer.hidden + layer.inputs; k += threads) {
                    const float* const w = layer.weight + Index(k) * layer.out;
                    float sum = 0;
                    for (int o = 0; o < layer.out; ++o) sum += w[o] * layer.cotangent[o];
                    if (k >= layer.hidden)
                        g_input[k - layer.hidden] += sum;
                    else
                        network.layer[l - 1].cotangent[k] =
                            A::vjp(network.layer[l - 1].value[k], sum);
                }
            });
        }
    }
};

/// Adds the gradient of number i of a layer's weights, or of its biases, which follow.
struct MlpColumnWeight {
    static constexpr const char* name = "network of a column, weights";
    MlpColumnLayer layer;
    const float* below;
    const float* input;
    float* weight; ///< added to
    float* bias;   ///< added to

    Index count() const { return Index(layer.hidden + layer.inputs + 1) * layer.out; }
    RYE_DEVICE void operator()(Index i) const {
        const Index k = i / layer.out, o = i % layer.out;
        const float g = layer.cotangent[o];
        if (k < layer.hidden)
            weight[i] += g * below[k];
        else if (k < layer.hidden + layer.inputs)
            weight[i] += g * input[k - layer.hidden];
        else
            bias[o] += g;
    }
};

} // namespace detail

/// A network of one column on a device, without frame inputs of its own.
template <class Device, Activation A = LeakyRelu>
class DeviceMlpColumn {
  public:
    /// Throws an Error for more layers than a kernel has room for.
    DeviceMlpColumn(const Device& device, const MlpShape& shape) : device_(device), shape_(shape) {
        require(shape.layers() <= detail::DeviceMlpNetwork::most_layers, "DeviceMlpColumn",
                "number of layers is ", shape.layers(), ", expected at most ",
                detail::DeviceMlpNetwork::most_layers);
        require(shape.frame_inputs == 0, "DeviceMlpColumn", "number of frame inputs is ",
                shape.frame_inputs, ", expected 0");
    }
    const MlpShape& shape() const { return shape_; }

    /// Takes the weights and biases, and where the inputs lie (inputs x 1).
    void set(const CudaQueue& queue, const DeviceMlpParameters& p, const float* input) {
        std::size_t numbers = 0;
        for (int l = 0; l < shape_.layers(); ++l)
            numbers += 2 * static_cast<std::size_t>(shape_.layer_out(l));
        numbers_.reserve(queue, numbers + 1);
        float* at = numbers_.data();
        network_.layers = shape_.layers();
        network_.input = input;
        for (int l = 0; l < network_.layers; ++l) {
            const auto i = static_cast<std::size_t>(l);
            const int out = shape_.layer_out(l);
            network_.layer[l] = {p.weight[i].data,
                                 p.bias[i].data,
                                 shape_.hidden_in(l),
                                 shape_.reads_input(l) ? shape_.inputs() : 0,
                                 out,
                                 at,
                                 at + out};
            at += 2 * out;
        }
    }
    /// The outputs, before any output activation, in device memory.
    float* outputs() const { return network_.layer[network_.layers - 1].value; }

    void forward_into(const CudaQueue& queue) const {
        device_.launch(queue, 1, detail::MlpColumnForwardKernel<A>{network_});
    }
    /// Adds the gradients of weights and biases; overwrites that of the inputs.
    void vjp_into(const CudaQueue& queue, const float* g_out, const DeviceMlpParameters& gradient,
                  float* g_input) const {
        device_.launch(queue, 1, detail::MlpColumnReverseKernel<A>{network_, g_out, g_input});
        for (int l = 0; l < network_.layers; ++l) {
            const auto i = static_cast<std::size_t>(l);
            const detail::MlpColumnWeight weights{
                network_.layer[l], l > 0 ? network_.layer[l - 1].value : nullptr, network_.input,
                gradient.weight[i].data, gradient.bias[i].data};
            launch_each(device_, queue, weights.count(), weights);
        }
    }
    std::size_t bytes() const { return numbers_.bytes(); }

  private:
    Device device_;
    MlpShape shape_;
    detail::MlpColumnNetwork network_{};
    DeviceBuffer<float> numbers_;
};

} // namespace rye
