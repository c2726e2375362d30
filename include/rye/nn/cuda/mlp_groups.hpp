// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_groups.hpp: a network's kernels of groups, for devices and shapes that have
/// them; DeviceMlp (mlp.hpp) chooses.
#pragma once

#include <vector>

#include <rye/nn/cuda/mlp_group_kernels.hpp>
#include <rye/nn/cuda/mlp_group_weights.hpp>
#include <rye/nn/cuda/mlp_weight_merge.hpp>
#include <rye/nn/mlp_shape.hpp>

namespace rye {

/// Memory that a vjp needs while it runs. Networks of one stream may share it.
struct DeviceMlpScratch {
    DeviceBuffer<std::uint16_t> cotangents;
    DeviceBuffer<float> partial;

    std::size_t bytes() const { return cotangents.bytes() + partial.bytes(); }
};

/// Weights (out x fan_in) and biases (out x 1) in device memory, as Mlp has them.
struct DeviceMlpParameters {
    std::vector<DeviceColumns<float>> weight, bias;
};

namespace detail {

/// Destinations of gradients; null pointers skip one.
struct DeviceMlpGradient {
    DeviceMlpParameters params;       ///< added to
    DeviceColumns<float> points = {}; ///< point inputs x N, of points that passed
    float* frame = nullptr;           ///< frame inputs
    bool add = false;                 ///< to `points` and `frame`, which else are overwritten
};

/// The network of a DeviceMlp whose Tiles these are.
template <class Device, class MlpTiles_, class A>
class MlpGroups {
  public:
    using Tiles = MlpGroupTiles<MlpTiles_, A>;
    static constexpr int width = Tiles::width;
    static constexpr bool there = true;

    static bool fits(const MlpShape& shape) { return Tiles::fits(shape); }

    /// Takes weights and biases, and frame inputs. `processors`: of the device.
    void set(const Device& device, const CudaQueue& queue, const MlpShape& s, int processors,
             const DeviceMlpParameters& p, const float* frame) {
        processors_ = processors;
        stays_ = Tiles::stays(s);
        const int count = s.layers(), inputs = s.point_inputs(), bytes = Tiles::operand_bytes(s);
        network_.layers = count;
        network_.inputs = inputs;
        network_.out = s.outputs();
        network_.bytes = bytes;
        network_.takes_input = 0;
        operands_.reserve(queue, static_cast<std::size_t>(bytes) / 2); // twice `bytes`
        numbers_.reserve(queue, static_cast<std::size_t>(2 * count * width));
        network_.forward = operands_.data();
        network_.reverse = operands_.data() + bytes / 4;
        forward_ = reverse_ = to_points_ = {};
        network_.bias = numbers_.data();
        MlpGroupPackKernel pack;
        pack.to = operands_.data();
        const auto weights = [&](int l) { return p.weight[static_cast<std::size_t>(l)].data; };
        for (int l = 0; l < count; ++l) {
            const int out = s.layer_out(l), hidden = s.hidden_in(l);
            const int n = l + 1 < count ? 128 : Tiles::last;
            const bool takes = s.reads_input(l);
            if (takes) network_.takes_input |= 1U << static_cast<unsigned>(l);
            for (int first = 0; first < out; first += n) {
                const float* const w = weights(l) + first;
                if (hidden > 0) forward_.add(width, n);
                if (takes) forward_.add(Tiles::inputs, n);
                if (hidden > 0)
                    pack.add(MlpGroupPackJob{w, out, 1, hidden, out - first, width, n, 0});
                if (takes)
                    pack.add(MlpGroupPackJob{w + Index(hidden) * out, out, 1, inputs, out - first,
                                             Tiles::inputs, n, 0});
            }
        }
        for (int l = count - 1; l > 0; --l)
            for (int first = 0; first < width; first += 128) {
                const int out = s.layer_out(l), k = l + 1 < count ? width : Tiles::last;
                reverse_.add(k, 128);
                pack.add(MlpGroupPackJob{weights(l) + Index(first) * out, 1, out, out, width, k,
                                         128, 0});
            }
        to_points_ = reverse_;
        const auto to_input = [&](int l) {
            const int out = s.layer_out(l), k = l + 1 < count ? width : Tiles::last;
            if (!s.reads_input(l)) return;
            to_points_.add(k, Tiles::inputs);
            pack.add(MlpGroupPackJob{weights(l) + Index(s.hidden_in(l)) * out, 1, out, out, inputs,
                                     k, Tiles::inputs, 0});
        };
        for (int l = 0; l < count; ++l) to_input(l);
        add_biases(pack, s, p, frame);
        device.launch(queue, pack.all(), pack);
    }
    /// Other frame inputs for the weights and biases that were taken.
    void set_frame(const Device& device, const CudaQueue& queue, const MlpShape& s,
                   const DeviceMlpParameters& p, const float* frame) {
        MlpGroupPackKernel pack;
        add_biases(pack, s, p, frame);
        device.launch(queue, pack.all(), pack);
    }

    void forward_into(const Device& device, const CudaQueue& queue,
                      const DeviceColumns<const float>& points, const DevicePoints& of, Index room,
                      const DeviceColumns<float>& out, bool keep) {
        network_.points = static_cast<std::uint32_t>(room);
        network_.of = of;
        if (keep) place(queue);
        const Index blocks = grid();
        const auto launch = [&](auto streamed) {
            device.launch(queue, blocks,
                          MlpGroupForwardKernel<Tiles, A, streamed()>{
                              network_, points, out, keep, static_cast<int>(blocks), forward_});
        };
        by_source(launch);
    }
    void vjp_into(const Device& device, const CudaQueue& queue,
                  const DeviceColumns<const float>& g_out, const DeviceMlpGradient& g,
                  DeviceMlpScratch& scratch, const MlpShape& s, const DeviceMlpParameters& p,
                  const float* frame_inputs) {
        const int hidden = network_.layers - 1;
        const std::size_t tile = std::size_t(64) * network_.tiles();
        const int kept = padded_16(network_.out);
        scratch.cotangents.reserve(queue,
                                   tile * static_cast<std::size_t>(hidden * width + kept) + 8);
        network_.cotangent = scratch.cotangents.data();
        network_.last_cotangent =
            network_.cotangent + tile * static_cast<std::size_t>(hidden * width);
        const Index blocks = grid();
        const auto launch = [&](auto streamed) {
            device.launch(queue, blocks,
                          MlpGroupReverseKernel<Tiles, A, streamed()>{
                              network_, g_out, g.points, g.add, static_cast<int>(blocks),
                              g.points.data != nullptr ? to_points_ : reverse_});
        };
        by_source(launch);
        const MlpGroupWeightCut cut = cut_of(s, kept);
        scratch.partial.reserve(queue, static_cast<std::size_t>(cut.numbers));
        float* const partial = scratch.partial.data();
        device.launch(queue, cut.all, MlpGroupWeightKernel<Tiles>{cut, partial});
        MlpGroupMergeKernel merge{cut, partial, network_.inputs, {}, 0};
        MlpFrameKernel frame{{}, 0, s.frame_inputs, frame_inputs, g.add, g.frame};
        for (int l = 0; l < network_.layers; ++l) {
            const auto i = static_cast<std::size_t>(l);
            float* const g_weight = g.params.weight[i].data;
            float* const sum = numbers(network_.layers + l);
            merge.set(l, {g_weight, g.params.bias[i].data, sum, s.layer_out(l), 0});
            if (s.reads_input(l) && s.frame_inputs > 0) {
                const Index before = Index(s.hidden_in(l) + network_.inputs) * s.layer_out(l);
                frame.layer[frame.layers++] = {p.weight[i].data + before, g_weight + before, sum,
                                               s.layer_out(l)};
            }
        }
        device.launch(queue, merge.all, merge);
        device.launch(queue, frame.blocks_of(), frame);
    }
    std::uint32_t points() const { return network_.points; }
    const DevicePoints& of() const { return network_.of; }

    std::size_t bytes() const {
        return operands_.bytes() + numbers_.bytes() + kept_.bytes() + signs_.bytes();
    }

  private:
    /// Numbers of layer l: biases with the products of the frame inputs, and from layer `layers` on
    /// sums of cotangents.
    float* numbers(int l) const { return numbers_.data() + Index(l) * width; }
    void add_biases(MlpGroupPackKernel& pack, const MlpShape& s, const DeviceMlpParameters& p,
                    const float* frame) const {
        pack.frame = frame;
        for (int l = 0; l < s.layers(); ++l) {
            const auto i = static_cast<std::size_t>(l);
            const int out = s.layer_out(l), before = s.hidden_in(l) + s.point_inputs();
            pack.add(MlpBiasJob{p.bias[i].data, p.weight[i].data + Index(before) * out, out,
                                s.reads_input(l) ? s.frame_inputs : 0, numbers(l), 0});
        }
    }
    /// Calls f(integral_constant) of the kernels whose operands pass through, or stay.
    template <class F>
    void by_source(const F& f) const {
        if (stays_) return f(std::false_type());
        if constexpr (Tiles::streams) f(std::true_type());
    }
    /// Blocks of the passes through the layers.
    Index grid() const {
        const Index tiles = network_.tiles();
        return rye::min(Index(processors_), (tiles + Tiles::groups - 1) / Tiles::groups);
    }
    void place(const CudaQueue& queue) {
        const std::size_t tile = std::size_t(64) * network_.tiles();
        const auto hidden = static_cast<std::size_t>(network_.layers - 1);
        kept_.reserve(queue, tile * (hidden * width + Tiles::inputs) + 8);
        signs_.reserve(queue, tile * hidden * (width / 32) + 8);
        network_.input = kept_.data();
        network_.activated = kept_.data() + tile * Tiles::inputs;
        network_.signs = signs_.data();
    }
    /// Returns the slices of the gradients of the weights.
    MlpGroupWeightCut cut_of(const MlpShape& s, int kept) const {
        using Kernel = MlpGroupWeightKernel<Tiles>;
        MlpGroupWeightCut c{};
        c.layers = network_.layers;
        c.input = network_.input;
        c.points = network_.points;
        c.of = network_.of;
        const Index apart = Index(network_.tiles()) * 64 * width;
        for (int l = 0; l < c.layers; ++l) {
            const bool last = l + 1 == c.layers;
            c.layer[l] = {l > 0 ? network_.activated + (l - 1) * apart : nullptr,
                          last ? network_.last_cotangent : network_.cotangent + l * apart,
                          l > 0 ? width : 0,
                          s.reads_input(l) ? Tiles::inputs : 0,
                          last ? Tiles::last : width,
                          last ? kept : width,
                          last ? Kernel::high_last : Kernel::high,
                          0,
                          0,
                          0};
        }
        c.divide();
        return c;
    }

    int processors_ = 0;
    bool stays_ = true; ///< whether operands do, in shared memory
    MlpGroupNetwork network_{};
    MlpGroupPieces forward_, reverse_, to_points_; ///< reverse passes without, and to the inputs
    DeviceBuffer<std::uint32_t> operands_; ///< of the forward pass, then of the reverse one
    DeviceBuffer<float> numbers_;          ///< biases, then sums of cotangents
    DeviceBuffer<std::uint16_t> kept_;     ///< inputs, and outputs of hidden layers
    DeviceBuffer<std::uint32_t> signs_;    ///< of those outputs
};

/// Nothing, for tiles without such kernels.
struct NoMlpGroups {
    static constexpr bool there = false;
    static std::size_t bytes() { return 0; }
};

template <class Device, class Tiles, class A>
using MlpGroupsOf =
    std::conditional_t<MlpGroupTiles<Tiles, A>::there, MlpGroups<Device, Tiles, A>, NoMlpGroups>;

} // namespace detail

} // namespace rye
