// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/field.hpp: a network weighted by an influence (avatar/field.hpp) over points in
/// device memory:
///     out += gain * lambda(x) * squash(MLP([input(x), frame code]))
/// of the points that a list in device memory names, a point once. Networks write their outputs one
/// after the other in the order of the list; kernels here take them to the points and back.
#pragma once

#include <rye/backend/cuda/each.hpp>
#include <rye/backend/cuda/lists.hpp>
#include <rye/nn/cuda/mlp.hpp>

namespace rye {

/// Tiles of an avatar's networks: N planes, widths of layers, numbers of a feature and of a
/// position's code, each at most that many (multiples of 32).
template <int N, int width = 256, int features = 128, int codes = 64>
struct DeviceNetworks {
    using OfFeatures = MlpTiles<N, width, features>;
    using OfPositions = MlpTiles<N, width, codes>;
};

namespace detail {

/// Points that a driver moves, in device memory, and their influence.
struct DeviceInfluenced {
    DevicePoints points;
    Index room;          ///< for that many of them
    const float* lambda; ///< 1 x N
};

/// The share of a field in a number of a point, by the squashed output y.
RYE_HD inline float field_term(float gain, float lambda, float y) { return gain * lambda * y; }

/// Outputs of a field's network for the points of its list.
struct DeviceFieldOutputs {
    DeviceInfluenced set;
    Squash squash; ///< that the outputs have yet to go through
    float gain;
    DeviceColumns<const float> output; ///< rows x room

    /// Adds the field's rows from `row` on, of a point, to n sums.
    template <int n>
    RYE_DEVICE void add(Index point, Index row, float* sum) const {
        const float lambda = set.lambda[point];
        if (!(lambda > 0.0F)) return;
        const std::uint32_t count = set.points.among(static_cast<std::uint32_t>(set.room)),
                            k = place_in_list(set.points.which, count,
                                              static_cast<std::uint32_t>(point));
        if (k == count) return; // the list has no room
        const float* const y = output.data + Index(k) * output.rows + row;
        for (int r = 0; r < n; ++r) sum[r] += field_term(gain, lambda, squash_value(squash, y[r]));
    }
};

/// Squashes number i of the outputs and adds it to its point.
struct FieldAdd {
    static constexpr const char* name = "field";
    DeviceInfluenced set;
    Squash squash;
    float gain;
    DeviceColumns<float> output; ///< rows x room
    float* out;                  ///< rows x N, added to

    /// A number of the outputs, squashed, and the sum that it joins; none beyond the list.
    struct Term {
        float y, sum;
        Index to; ///< of the sum, or -1
    };
    RYE_DEVICE Term read(Index i) const {
        const auto rows =
            static_cast<std::uint32_t>(output.rows); // DeviceMlp: 2^32 numbers at most
        const std::uint32_t k = static_cast<std::uint32_t>(i) / rows;
        if (k >= set.points.among(static_cast<std::uint32_t>(set.room))) return {0, 0, -1};
        const auto point = static_cast<Index>(set.points.column(k));
        const float y = squash_value(squash, output.data[i]);
        const std::uint32_t row = static_cast<std::uint32_t>(i) % rows;
        const Index to = point * output.rows + static_cast<Index>(row);
        return {y, out[to] + field_term(gain, set.lambda[point], y), to};
    }
    RYE_DEVICE void write(Index i, const Term& term) const {
        if (term.to < 0) return;
        if (squash != Squash::none) output.data[i] = term.y;
        out[term.to] = term.sum;
    }
};

/// Cotangents of a field's network and of the influence; `group` lanes do a point.
struct FieldCotangentKernel {
    static constexpr const char* name = "field, reverse";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {
        float along[threads];
    };
    DeviceInfluenced set;
    Squash squash;
    float gain;
    int group; ///< a power of two, at most 32
    DeviceColumns<const float> output;
    const float* g_out; ///< rows x N
    float* g_output;    ///< rows x room
    float* g_lambda;    ///< 1 x N, added to

    static int group_of(Index rows) {
        int group = 1;
        while (group < 32 && group < rows) group *= 2;
        return group;
    }
    Index blocks_of() const { return (set.room * group + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const auto each = static_cast<std::uint32_t>(threads / group);
        const std::uint32_t first = static_cast<std::uint32_t>(block.index()) * each;
        const std::uint32_t count = set.points.among(static_cast<std::uint32_t>(set.room));
        if (first >= count) return;
        const auto point_of = [&](int t) { return first + static_cast<std::uint32_t>(t / group); };
        block.each_lane([&](int t) {
            float along = 0;
            const std::uint32_t k = point_of(t);
            if (k < count) {
                const Index point = set.points.column(k), rows = output.rows;
                const float w = gain * set.lambda[point];
                for (Index r = t % group; r < rows; r += group) {
                    const float y = output.data[k * rows + r], g = g_out[point * rows + r];
                    g_output[k * rows + r] = w * g * squash_slope(squash, y);
                    along += y * g;
                }
            }
            shared.along[t] = along;
        });
        for (int apart = group / 2; apart > 0; apart /= 2)
            block.each_lane([&](int t) {
                if (t % group < apart) shared.along[t] += shared.along[t + apart];
            });
        block.each_lane([&](int t) {
            const std::uint32_t k = point_of(t);
            if (t % group == 0 && k < count)
                g_lambda[set.points.column(k)] += gain * shared.along[t];
        });
    }
};

/// Gradients of a field, all added to; frame may be null.
struct DeviceFieldGradients {
    DeviceMlpParameters params;
    DeviceColumns<float> inputs; ///< D x N
    float* lambda;               ///< 1 x N
    float* frame;
};

/// Memory that fields need while they run, which those of one stream share.
struct DeviceFieldScratch {
    DeviceMlpScratch mlp;
    DeviceBuffer<float> g_output;

    std::size_t bytes() const { return mlp.bytes() + g_output.bytes(); }
};

/// A field on a device, with what its vjp reads.
template <class Device, class Tiles, Activation A = LeakyRelu>
class DeviceField {
  public:
    /// Throws an Error for a shape that does not fit the tiles.
    DeviceField(const Device& device, const MlpShape& shape, Squash squash, float gain,
                DeviceFieldScratch& scratch)
        : device_(device),
          mlp_(device, shape),
          scratch_(&scratch),
          squash_(squash),
          gain_(gain) {
        mlp_.share(scratch.mlp);
    }

    /// Takes the network's parameters, and where the frame's code lies.
    void set(const CudaQueue& queue, const DeviceMlpParameters& p, const float* frame) {
        mlp_.set(queue, p, frame);
        frame_ = frame;
    }
    /// The frame's code has changed.
    void set_frame(const CudaQueue& queue) { mlp_.set_frame(queue, frame_); }

    /// Adds the field of the points' inputs (D x N) to out (rows x N).
    void add_into(const CudaQueue& queue, const DeviceColumns<const float>& inputs,
                  const DeviceInfluenced& set, const DeviceColumns<float>& out, bool keep) {
        const Index rows = mlp_.shape().outputs();
        require(out.rows == rows && out.cols == inputs.cols, "DeviceField", "sum is ", out.rows,
                " x ", out.cols, ", expected ", rows, " x ", inputs.cols);
        evaluate_into(queue, inputs, set, keep);
        launch_each(device_, queue, rows * set.room,
                    FieldAdd{set, squash_, gain_, output(), out.data});
    }
    /// Runs the network alone: its outputs are not squashed, nor added to anything.
    void evaluate_into(const CudaQueue& queue, const DeviceColumns<const float>& inputs,
                       const DeviceInfluenced& set, bool keep) {
        set_ = set;
        output_.reserve(queue, static_cast<std::size_t>(mlp_.shape().outputs() * set.room) + 1);
        mlp_.forward_into(queue, DeviceMlpPoints{inputs, set.points, set.room}, output(), keep);
    }
    /// Outputs of the last evaluate_into.
    DeviceFieldOutputs evaluated() const { return {set_, squash_, gain_, output()}; }
    /// Outputs that the last add_into added, until the next evaluate_into.
    DeviceFieldOutputs added() const { return {set_, Squash::none, gain_, output()}; }

    /// Pulls g_out (rows x N) back through the last add_into, which kept what is read here.
    void vjp_into(const CudaQueue& queue, const DeviceColumns<const float>& g_out,
                  const DeviceFieldGradients& g) {
        const Index rows = mlp_.shape().outputs();
        scratch_->g_output.reserve(queue, static_cast<std::size_t>(rows * set_.room) + 1);
        const DeviceColumns<float> g_output{scratch_->g_output.data(), rows, set_.room};
        const FieldCotangentKernel kernel{
            set_,     squash_,    gain_,         FieldCotangentKernel::group_of(rows),
            output(), g_out.data, g_output.data, g.lambda};
        device_.launch(queue, kernel.blocks_of(), kernel);
        mlp_.vjp_into(queue, g_output, {g.params, g.inputs, g.frame, true});
    }

    const MlpShape& shape() const { return mlp_.shape(); }
    /// Memory that is held, without what is shared [bytes].
    std::size_t bytes() const { return mlp_.bytes() + output_.bytes(); }

  private:
    DeviceColumns<float> output() const {
        return {output_.data(), mlp_.shape().outputs(), set_.room};
    }

    Device device_;
    DeviceMlp<Device, Tiles, A> mlp_;
    DeviceFieldScratch* scratch_;
    Squash squash_;
    float gain_;
    const float* frame_ = nullptr;
    DeviceInfluenced set_{};
    DeviceBuffer<float> output_;
};

} // namespace detail

} // namespace rye
