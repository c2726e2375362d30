// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_weight_cut.hpp: what the gradients of a network's weights are cut into: blocks
/// of inputs by outputs of a layer, and fixed slices of the points.
#pragma once

#include <rye/nn/cuda/mlp_operands.hpp>

namespace rye {

namespace detail {

/// The inputs of a layer side by side, each in whole operands: hidden, points'.
struct MlpColumns {
    int hidden, input; ///< numbers of the layer's two inputs; 0: it does not take that one
    RYE_HD int input_at() const { return padded_16(hidden); }
    RYE_HD int all() const { return padded_16(hidden) + padded_16(input); }
};

/// A layer's part of the work: blocks of `high` inputs by all outputs by a slice of the points.
struct MlpWeightLayer {
    MlpColumns columns;
    int out;
    const std::uint16_t* cotangent; ///< planes x points x padded_16(out)
    std::uint32_t hidden, input;    ///< where those lie among what was kept [groups of 8]
    int slices, first;              ///< slices of the points; first block
};

} // namespace detail

/// Slices of the gradients of the weights of a network whose layers have at most `wide_` outputs.
/// They follow from shapes alone, so that sums keep their order.
template <int wide_>
struct MlpWeightCut {
    static_assert(wide_ == 128 || wide_ == 256);
    static constexpr int high = 128, wide = wide_; ///< inputs and outputs of a block, at most
    static constexpr int together = 256 / wide;    ///< blocks of a unit
    static constexpr int aim = 132 * together;     ///< blocks: for each unit of the largest devices
    static constexpr std::uint32_t least = 256;          ///< points of a slice
    static constexpr int warps = 8, of_lane = wide / 2;  ///< sums
    static constexpr int numbers = warps * of_lane * 32; ///< a block, less sums of cotangents
    static constexpr int of_block = numbers + wide;
    detail::MlpWeightLayer layer[detail::DeviceMlpNetwork::most_layers];
    int layers, all;      ///< blocks
    std::uint32_t points; ///< that there is room for
    detail::DevicePoints of;

    RYE_HD static int tiles(const detail::MlpWeightLayer& l) {
        return (l.columns.all() + high - 1) / high;
    }
    /// Operands of 16 outputs of each of four warps, at most.
    RYE_HD static int own(const detail::MlpWeightLayer& l) {
        return (detail::padded_16(l.out) / 16 + 3) / 4;
    }
    /// Sets slices and blocks.
    void divide() {
        const auto cost =
            [](const detail::MlpWeightLayer& l) { // cost of a tile: copies, products, waiting
                const int rows = rye::min(l.columns.all(), int(high)),
                          columns = detail::padded_16(l.out);
                return rows + columns + rows * columns / 256 + 96;
            };
        int total = 0;
        for (int l = 0; l < layers; ++l) total += tiles(layer[l]) * cost(layer[l]);
        all = 0;
        for (int l = 0; l < layers; ++l) {
            layer[l].slices = rye::max(1, cost(layer[l]) * aim / rye::max(total, 1));
            all += tiles(layer[l]) * layer[l].slices;
        }
        // The rest goes to the longest slices: a block more than `aim` would double the time.
        for (;;) {
            int longest = -1;
            for (int l = 0; l < layers; ++l)
                if (all + tiles(layer[l]) <= aim &&
                    (longest < 0 || cost(layer[l]) * layer[longest].slices >
                                        cost(layer[longest]) * layer[l].slices))
                    longest = l;
            if (longest < 0) break;
            ++layer[longest].slices;
            all += tiles(layer[longest]);
        }
        int first = 0;
        for (int l = 0; l < layers; ++l) {
            layer[l].first = first;
            first += tiles(layer[l]) * layer[l].slices;
        }
    }
    /// Points of a slice of so many, a multiple of 64.
    RYE_HD static std::uint32_t points_of(std::uint32_t count, int slices) {
        const auto most = static_cast<std::uint32_t>(slices), parts = (count + 63) / 64;
        return rye::max((parts + most - 1) / most * 64, std::uint32_t(least));
    }
};

} // namespace rye
