// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp.hpp: Mlp's forward pass and vjp for points in device memory: a block of points
/// through all layers by one kernel, on units of matrices.
///     DeviceMlp<CudaDevice, MlpTiles<1, 256, 128>> network(device, shape);
///     network.set(queue, parameters, frame);              // once a step
///     network.forward_into(queue, points, out);
///     network.vjp_into(queue, g_out, {gradient, g_points, g_frame});
/// Products take floats as N planes of bf16: relative errors about 3e-3, 1e-5 and 1e-6 for N = 1, 2
/// and 3. Sums are floats in a fixed order: the same build gives the same bits. Shapes of one plane
/// that mlp_groups.hpp has kernels for take those where the program has code for sm_90a.
#pragma once

#include <string>
#include <type_traits>
#include <vector>

#include <rye/core/error.hpp>
#include <rye/nn/cuda/mlp_groups.hpp>
#include <rye/nn/cuda/mlp_kernels.hpp>
#include <rye/nn/cuda/mlp_weight_merge.hpp>
#include <rye/nn/cuda/mlp_weights.hpp>
#include <rye/nn/mlp.hpp>

namespace rye {

/// The arrays of a network of the host in device memory; `of` gives an array's, as Resident::of.
template <class A, class Of>
DeviceMlpParameters device_parameters(const Mlp<float, A>& m, const Of& of) {
    DeviceMlpParameters p;
    for (std::size_t l = 0; l < m.weight.size(); ++l) {
        p.weight.push_back(of(m.weight[l]));
        p.bias.push_back(of(m.bias[l]));
    }
    return p;
}

/// Points that pass a network: all columns of an array, or those that a list in device memory
/// names, of which there is room for `room`.
struct DeviceMlpPoints {
    DeviceColumns<const float> inputs; ///< point inputs x N
    detail::DevicePoints of = {};
    Index room = inputs.cols;
};

/// A network in device memory with its forward pass and vjp, on the stream of each call.
template <class Device, class Tiles = MlpTiles<1, 256, 128>, Activation A = LeakyRelu>
class DeviceMlp {
  public:
    /// Returns true if the tiles have room for a shape.
    static bool fits(const MlpShape& shape) {
        bool all = shape.layers() <= detail::DeviceMlpNetwork::most_layers &&
                   shape.point_inputs() <= Tiles::inputs;
        for (int l = 0; l < shape.layers(); ++l) all = all && shape.layer_out(l) <= Tiles::width;
        return all;
    }

    /// Throws an Error for a shape that does not fit the tiles.
    DeviceMlp(const Device& device, const MlpShape& shape) : device_(device), shape_(shape) {
        const auto within = [](const std::string& what, int x, int most) {
            require(x >= 0 && x <= most, "DeviceMlp", what, " is ", x, ", its tiles have room for ",
                    most);
        };
        within("number of layers", shape.layers(), detail::DeviceMlpNetwork::most_layers);
        within("number of point inputs", shape.point_inputs(), Tiles::inputs);
        for (int l = 0; l < shape.layers(); ++l)
            within("width of layer " + std::to_string(l), shape.layer_out(l), Tiles::width);
        if constexpr (Groups::there)
            if (Groups::fits(shape)) processors_ = processors_of_groups(device);
    }

    DeviceMlp(const DeviceMlp&) = delete;
    DeviceMlp& operator=(const DeviceMlp&) = delete;

    const MlpShape& shape() const { return shape_; }
    /// Returns true if the device has kernels of groups for the shape (mlp_groups.hpp).
    bool by_groups() const { return processors_ > 0; }

    /// Vjps take their memory there; it must live as long as the network.
    void share(DeviceMlpScratch& scratch) { scratch_ = &scratch; }

    /// Takes weights and biases, with frame inputs of the given values (null if there are none).
    void set(const CudaQueue& queue, const DeviceMlpParameters& p, const float* frame) {
        check(p);
        parameters_ = p;
        if constexpr (Groups::there)
            if (by_groups()) {
                frame_ = frame;
                return groups_.set(device_, queue, shape_, processors_, p, frame);
            }
        const int count = shape_.layers(), inputs = shape_.point_inputs();
        Index words = 0, biases = 0;
        for (int l = 0; l < count; ++l) {
            const int out = shape_.layer_out(l), hidden = shape_.hidden_in(l);
            const auto room = [&](int in) {
                words += detail::MlpPackJob::words(in, Tiles::tiles(out), Tiles::N) +
                         detail::MlpPackJob::words(out, Tiles::tiles(in), Tiles::N);
            };
            if (hidden > 0) room(hidden);
            if (shape_.reads_input(l)) room(inputs);
            biases += detail::padded_16(out);
        }
        words += Tiles::Full::tiles * 64 * Tiles::N; // what begins is read, whatever its steps
        packed_.reserve(queue, static_cast<std::size_t>(words));
        numbers_.reserve(queue, 2 * static_cast<std::size_t>(biases) + 1);
        std::uint32_t* word = packed_.data();
        float* bias = numbers_.data();
        network_.layers = count;
        network_.inputs = inputs;
        detail::MlpPackKernel pack{};
        pack.planes = Tiles::N;
        for (int l = 0; l < count; ++l) {
            const auto i = static_cast<std::size_t>(l);
            const int out = shape_.layer_out(l), hidden = shape_.hidden_in(l);
            detail::DeviceMlpLayer& layer = network_.layer[l];
            layer = {hidden, out, shape_.reads_input(l), {}, {}, {}, bias, nullptr, nullptr};
            const float* const w = p.weight[i].data;
            const auto operand = [&](const float* from, int k, int n, Index k_apart,
                                     Index n_apart) {
                const int tiles = Tiles::tiles(n);
                return detail::MlpOperand{
                    pack.add({from, k_apart, n_apart, k, n, tiles, nullptr, 0}, word),
                    detail::padded_16(k) / 16, tiles};
            };
            const float* const of_input = w + Index(hidden) * out;
            layer.to_out = operand(w, hidden, out, out, 1);
            if (layer.takes_input) { // directly behind
                layer.to_out.steps += operand(of_input, inputs, out, out, 1).steps;
                layer.out_to_input = operand(of_input, out, inputs, 1, out);
            }
            if (hidden > 0) layer.out_to_hidden = operand(w, out, hidden, 1, out);
            bias += detail::padded_16(out);
        }
        device_.launch(queue, pack.all, pack);
        set_frame(queue, frame);
    }

    /// Other frame inputs for the weights and biases that were taken.
    void set_frame(const CudaQueue& queue, const float* frame) {
        frame_ = frame;
        if constexpr (Groups::there)
            if (by_groups()) return groups_.set_frame(device_, queue, shape_, parameters_, frame);
        detail::MlpBiasKernel biases{};
        biases.frame = frame;
        float* bias = numbers_.data();
        for (int l = 0; l < network_.layers; ++l) {
            const auto i = static_cast<std::size_t>(l);
            const detail::DeviceMlpLayer& layer = network_.layer[l];
            biases.add(
                {parameters_.bias[i].data,
                 parameters_.weight[i].data + Index(layer.hidden + network_.inputs) * layer.out,
                 layer.out, layer.takes_input ? shape_.frame_inputs : 0, bias, 0});
            bias += detail::padded_16(layer.out);
        }
        device_.launch(queue, biases.all, biases);
    }

    /// out (outputs x room) of points, before any output activation. `keep`: what a vjp reads.
    void forward_into(const CudaQueue& queue, const DeviceMlpPoints& points,
                      const DeviceColumns<float>& out, bool keep = true) {
        const Index room = points.room;
        shaped("points", points.inputs.rows, room, shape_.point_inputs(), room);
        shaped("outputs", out.rows, out.cols, shape_.outputs(), room);
        require(static_cast<std::uint64_t>(rye::max(room, points.inputs.cols)) *
                        static_cast<std::uint64_t>(rye::max(Tiles::width, Tiles::inputs)) <
                    std::uint64_t(1) << 32U,
                "DeviceMlp", "number of points is ", rye::max(room, points.inputs.cols),
                ", 2^32 numbers of a layer are the most");
        network_.points = static_cast<std::uint32_t>(room);
        network_.of = points.of;
        if constexpr (Groups::there)
            if (by_groups())
                return groups_.forward_into(device_, queue, points.inputs, points.of, room, out,
                                            keep);
        if (keep) place(queue);
        device_.launch(queue, blocks(),
                       detail::MlpForwardKernel<Tiles, A>{network_, points.inputs, out, keep});
    }
    /// Puts the forward pass of all columns on the stream.
    void forward_into(const CudaQueue& queue, const DeviceColumns<const float>& points,
                      const DeviceColumns<float>& out, bool keep = true) {
        forward_into(queue, DeviceMlpPoints{points}, out, keep);
    }

    /// Gradients for the cotangent g_out (outputs x room) of the last forward pass, which kept
    /// what is read here.
    void vjp_into(const CudaQueue& queue, const DeviceColumns<const float>& g_out,
                  const detail::DeviceMlpGradient& g) {
        const Index n = network_.points;
        check(g.params);
        shaped("cotangents", g_out.rows, g_out.cols, shape_.outputs(), n);
        if (g.points.data != nullptr)
            shaped("gradient of points", g.points.rows, network_.of.which ? n : g.points.cols,
                   shape_.point_inputs(), n);
        if constexpr (Groups::there)
            if (by_groups())
                return groups_.vjp_into(device_, queue, g_out, g, *scratch_, shape_, parameters_,
                                        frame_);
        place_cotangents(queue);
        device_.launch(queue, blocks(),
                       detail::MlpReverseKernel<Tiles, A>{network_, g_out, g.points, g.add});
        detail::MlpWeightKernel<Tiles::N, Cut::wide> weights{cut(), kept_.data(),
                                                             scratch_->partial.data()};
        device_.launch(queue, weights.cut.all, weights);
        detail::MlpMergeKernel<Cut::wide> merge{weights.cut, weights.partial, {}};
        detail::MlpFrameKernel frame{{}, 0, shape_.frame_inputs, frame_, g.add, g.frame};
        float* sum = numbers_.data();
        for (int l = 0; l < network_.layers; ++l) sum += detail::padded_16(network_.layer[l].out);
        for (int l = 0; l < network_.layers; ++l) {
            const auto i = static_cast<std::size_t>(l);
            const detail::DeviceMlpLayer& layer = network_.layer[l];
            float* const g_weight = g.params.weight[i].data;
            merge.set(l, {g_weight, g.params.bias[i].data, sum, 0});
            if (layer.takes_input && shape_.frame_inputs > 0) {
                const Index before = Index(layer.hidden + network_.inputs) * layer.out;
                frame.layer[frame.layers++] = {parameters_.weight[i].data + before,
                                               g_weight + before, sum, layer.out};
            }
            sum += detail::padded_16(layer.out);
        }
        device_.launch(queue, merge.all, merge);
        device_.launch(queue, frame.blocks_of(), frame);
    }

    /// Memory that is held, without what is shared [bytes].
    std::size_t bytes() const {
        return packed_.bytes() + numbers_.bytes() + kept_.bytes() + own_scratch_.bytes() +
               groups_.bytes();
    }

  private:
    using Groups = detail::MlpGroupsOf<Device, Tiles, A>;
    using Cut = MlpWeightCut<Tiles::width <= 128 ? 128 : 256>;

    Index blocks() const { return (Index(network_.points) + Tiles::points - 1) / Tiles::points; }
    /// Numbers of a layer's outputs for all points, in planes.
    std::size_t halves(int width) const {
        return std::size_t(Tiles::N) * network_.points *
               static_cast<std::size_t>(detail::padded_16(width));
    }
    void place(const CudaQueue& queue) {
        std::size_t all = halves(network_.inputs);
        for (int l = 0; l + 1 < network_.layers; ++l) all += halves(network_.layer[l].out);
        kept_.reserve(queue, all + 8);
        std::uint16_t* at = kept_.data();
        network_.input = at;
        at += halves(network_.inputs);
        for (int l = 0; l + 1 < network_.layers; ++l) {
            network_.layer[l].activated = at;
            at += halves(network_.layer[l].out);
        }
    }
    void place_cotangents(const CudaQueue& queue) {
        std::size_t all = 0;
        for (int l = 0; l < network_.layers; ++l) all += halves(network_.layer[l].out);
        scratch_->cotangents.reserve(queue, all + 8);
        std::uint16_t* at = scratch_->cotangents.data();
        for (int l = 0; l < network_.layers; ++l) {
            network_.layer[l].cotangent = at;
            at += halves(network_.layer[l].out);
        }
        scratch_->partial.reserve(queue, static_cast<std::size_t>(cut().all) *
                                             static_cast<std::size_t>(Cut::of_block));
    }
    /// Returns the slices of the gradients of the weights.
    Cut cut() const {
        Cut c{};
        c.layers = network_.layers;
        c.points = network_.points;
        c.of = network_.of;
        const auto place = [&](const std::uint16_t* p) {
            return static_cast<std::uint32_t>((p - kept_.data()) / 8);
        };
        for (int l = 0; l < c.layers; ++l) {
            const detail::DeviceMlpLayer& layer = network_.layer[l];
            c.layer[l] = {{layer.hidden, layer.takes_input ? network_.inputs : 0},
                          layer.out,
                          layer.cotangent,
                          l > 0 ? place(network_.layer[l - 1].activated) : 0U,
                          place(network_.input),
                          0,
                          0};
        }
        c.divide();
        return c;
    }
    void check(const DeviceMlpParameters& p) const {
        const auto layers = static_cast<std::size_t>(shape_.layers());
        require(p.weight.size() == layers && p.bias.size() == layers, "DeviceMlp",
                "parameters are of ", p.weight.size(), " layers, its shape has ", layers);
        for (std::size_t l = 0; l < layers; ++l) {
            const int out = shape_.layer_out(static_cast<int>(l));
            shaped("weights", p.weight[l].rows, p.weight[l].cols, out,
                   shape_.fan_in(static_cast<int>(l)));
            shaped("biases", p.bias[l].rows, p.bias[l].cols, out, 1);
        }
    }
    static void shaped(const std::string& what, Index rows, Index cols, Index want_rows,
                       Index want_cols) {
        require(rows == want_rows && cols == want_cols, "DeviceMlp", what, " are ", rows, " x ",
                cols, ", its shape has ", want_rows, " x ", want_cols);
    }

    Device device_;
    MlpShape shape_;
    DeviceMlpParameters parameters_;
    const float* frame_ = nullptr;
    detail::DeviceMlpNetwork network_{};
    DeviceBuffer<std::uint32_t> packed_;
    DeviceBuffer<float> numbers_;      ///< biases, then sums of cotangents
    DeviceBuffer<std::uint16_t> kept_; ///< inputs, and outputs of hidden layers
    DeviceMlpScratch own_scratch_;
    DeviceMlpScratch* scratch_ = &own_scratch_;
    int processors_ = 0; ///< with kernels of groups for the shape
    Groups groups_;
};

} // namespace rye
