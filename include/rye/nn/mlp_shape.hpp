// SPDX-License-Identifier: Apache-2.0
/// rye/nn/mlp_shape.hpp: the sizes of a multilayer perceptron's layers, and how its points are cut
/// into tasks of threads. The cuts depend on the sizes alone, so results do not depend on the
/// number of threads.
#pragma once

#include <algorithm>
#include <vector>

#include <rye/core/parallel.hpp>

namespace rye {

/// Sizes of the layers of an MLP.
struct MlpShape {
    std::vector<int> dims; ///< sizes of the input, the hidden layers and the output
    int frame_inputs = 0;  ///< number of trailing inputs that all points share
    static constexpr int middle = -1, no_skip = 0;
    int skip_layer = middle; ///< takes the input again

    int layers() const { return static_cast<int>(dims.size()) - 1; }
    int skip() const {
        return skip_layer == middle ? static_cast<int>(dims.size()) / 2 : skip_layer;
    }
    int inputs() const { return dims.front(); }
    int outputs() const { return dims.back(); }
    int point_inputs() const { return dims.front() - frame_inputs; }
    int layer_out(int l) const { return dims[static_cast<std::size_t>(l) + 1]; }
    /// Width of the hidden part of a layer's input; 0 for the first layer.
    int hidden_in(int l) const { return l == 0 ? 0 : dims[static_cast<std::size_t>(l)]; }
    bool reads_input(int l) const { return l == 0 || l == skip(); }
    int fan_in(int l) const { return hidden_in(l) + (reads_input(l) ? inputs() : 0); }
};

namespace detail {

/// The most points of a block that passes all layers: about 128 KiB of the widest layer, whole
/// tiles.
inline Index mlp_block(const MlpShape& s) {
    const int widest = *std::max_element(s.dims.begin(), s.dims.end());
    return std::clamp<Index>(32768 / std::max(widest, 1) / 12 * 12, 60, 504);
}

/// n in whole multiples.
constexpr Index rounded_up(Index n, Index multiple) { return chunk_count(n, multiple) * multiple; }

/// Points per task of a forward pass: whole tiles, and whole vectors of any number of outputs; at
/// least 64 tasks where there are many points, so that many threads end together.
inline Index mlp_task(const MlpShape& s, Index points) {
    constexpr Index whole = 48;
    return std::clamp<Index>(rounded_up(chunk_count(points, 64), whole), whole,
                             std::max(whole, mlp_block(s) / whole * whole));
}

/// Points per partial sum of weight gradients: 16 equal chunks, or 32 of many points, so that as
/// many threads have the same work; fewer of few points, as a sum costs as much as 40 points.
inline Index mlp_chunk(Index points) {
    constexpr Index tile = 12, fewest = 192, many = 16 * 512;
    return std::max(fewest, rounded_up(chunk_count(points, points < many ? 16 : 32), tile));
}

/// Points per block of a chunk: equal ones, none larger than mlp_block.
inline Index mlp_piece(const MlpShape& s, Index chunk) {
    return rounded_up(chunk_count(chunk, chunk_count(chunk, mlp_block(s))), 12);
}

/// A network's weights and biases in one column, layer after layer: a partial sum of gradients.
struct MlpOffsets {
    std::vector<Index> weight, bias; ///< where those of a layer begin
    Index size = 0;

    explicit MlpOffsets(const MlpShape& s) {
        for (int l = 0; l < s.layers(); ++l) {
            weight.push_back(size);
            bias.push_back(size += Index(s.layer_out(l)) * s.fan_in(l));
            size += s.layer_out(l);
        }
    }
};

} // namespace detail

} // namespace rye
