// SPDX-License-Identifier: Apache-2.0
/// rye/loss/cuda/smoothness.hpp: the smoothness prior of loss/smoothness.hpp over values in device
/// memory. The graph is sent once, with the list of points that name each point as a neighbour, so
/// that a point gathers its gradient in a fixed order.
#pragma once

#include <algorithm>
#include <limits>

#include <rye/loss/cuda/terms.hpp>
#include <rye/loss/smoothness.hpp>

namespace rye {

namespace detail {

/// Kernel of the value and cotangent of a chunk of numbers.
struct SmoothnessKernel {
    static constexpr const char* name = "smoothness";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {
        double sum[threads];
    };
    DeviceColumns<const float> values;
    const std::int32_t* neighbour; ///< four per point
    const std::int32_t* begin;     ///< start of each point's list in `namer`, points + 1
    const std::int32_t* namer;
    float share, weight;
    float* g; ///< accumulated
    double* partial;

    Index blocks_of() const { return (values.rows * values.cols + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        block.each_thread([&](int t) {
            const Index at = Index(block.index()) * threads + t;
            shared.sum[t] = at < values.rows * values.cols ? one(at) : 0.0;
        });
        add_up(block, shared.sum);
        block.each_thread([&](int t) {
            if (t == 0) partial[block.index()] = shared.sum[0];
        });
    }

  private:
    RYE_DEVICE double one(Index at) const {
        const Index i = at / values.rows, c = at % values.rows;
        const float here = values.data[at];
        float slope = 0;
        double squares = 0;
        for (int k = 0; k < 4; ++k) {
            const float d = here - values.data[neighbour[4 * i + k] * values.rows + c];
            squares += static_cast<double>(d * d);
            slope += detail::square_slope(share, d);
        }
        for (std::int32_t k = begin[i]; k < begin[i + 1]; ++k)
            slope -= detail::square_slope(share, values.data[namer[k] * values.rows + c] - here);
        g[at] += weight * slope;
        return squares;
    }
};

} // namespace detail

/// Smoothness prior with its graph in device memory.
template <class Device>
class DeviceSmoothness {
  public:
    explicit DeviceSmoothness(const Device& device) : device_(device) {}

    /// Copies a graph to the device; waits. Throws an Error for an index out of range.
    void set(const CudaQueue& queue, const detail::NeighbourGraph& graph) {
        const std::size_t n = graph.size();
        require(std::uint64_t(n) * 5 < std::uint64_t(std::numeric_limits<std::int32_t>::max()),
                "smoothness", "the graph has ", n, " points, 2^31 / 5 is the most");
        std::vector<std::int32_t> words(9 * n + 1, 0);
        std::int32_t *const neighbour = words.data(), *const begin = neighbour + 4 * n,
                            *const namer = begin + n + 1;
        for (std::size_t i = 0; i < n; ++i)
            for (std::size_t k = 0; k < 4; ++k) {
                const Index to = graph[i][k];
                require(to >= 0 && static_cast<std::size_t>(to) < n, "smoothness", "neighbour ", k,
                        " of point ", i, " is ", to, ", the graph has ", n, " points");
                neighbour[4 * i + k] = static_cast<std::int32_t>(to);
            }
        std::int32_t* end = namer;
        const std::vector<std::vector<Index>> of = detail::neighbour_of(graph);
        for (std::size_t i = 0; i < n; ++i) {
            for (const Index from : of[i]) *end++ = static_cast<std::int32_t>(from);
            begin[i + 1] = static_cast<std::int32_t>(end - namer);
        }
        words_.reserve(queue, words.size());
        device_.send(queue, words_.data(), words.data(), words.size() * sizeof(std::int32_t));
        points_ = static_cast<Index>(n);
    }
    /// Returns the mean squared difference of values (C x points) as a term of weight `weight`;
    /// adds `weight` times its cotangent to g. Throws an Error for other shapes.
    DeviceLossTerm into(const CudaQueue& queue, const DeviceColumns<const float>& values,
                        double weight, const DeviceColumns<float>& g) {
        require(values.cols == points_, "smoothness", "the graph has ", points_,
                " points, the values ", values.cols);
        require(g.rows == values.rows && g.cols == values.cols, "smoothness", "gradient is ",
                g.rows, " x ", g.cols, ", expected ", values.rows, " x ", values.cols);
        const double share = 1.0 / static_cast<double>(std::max<Index>(values.size(), 1));
        const std::int32_t *const neighbour = words_.data(), *const begin = neighbour + 4 * points_;
        detail::SmoothnessKernel kernel{values,
                                        neighbour,
                                        begin,
                                        begin + points_ + 1,
                                        static_cast<float>(share),
                                        static_cast<float>(weight),
                                        g.data,
                                        nullptr};
        kernel.partial = sums_.reserve(queue, kernel.blocks_of());
        device_.launch(queue, kernel.blocks_of(), kernel);
        return {kernel.partial, kernel.blocks_of(), share, 0.0, weight};
    }
    std::size_t bytes() const { return words_.bytes() + sums_.bytes(); }

  private:
    Device device_;
    DeviceBuffer<std::int32_t> words_;
    Index points_ = 0;
    detail::LossSums sums_;
};

} // namespace rye
