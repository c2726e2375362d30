// SPDX-License-Identifier: Apache-2.0
/// benchmarks/roofline/bound.hpp: lower bounds on the time of a render and of its gradient, for one
/// thread that has the vectors, caches and memory of a measured machine. A stage takes at least its
/// products or its bytes, whichever is longer; stages follow each other.
#pragma once

#include <algorithm>
#include <cmath>

#include "machine.hpp"

namespace rye::bench {

/// Bytes that a stage has to move.
struct Traffic {
    double read, written;

    /// Takes so many seconds at this speed: as much is copied as is both read and written.
    double seconds(const MemorySpeed& speed) const {
        const double both = std::min(read, written);
        return 2 * both / speed.copy + (read - both) / speed.read + (written - both) / speed.copy;
    }
};

/// The least times of the stages of a render and of its gradient [s].
struct StageBounds {
    double project, sort, lists, blend;
    double reverse, project_vjp;

    double forward() const { return project + sort + lists + blend; }
    double both() const { return forward() + reverse + project_vjp; }
};

/// The work of a render of a scene, by lists of tiles and vectors of pixels.
struct SplatWork {
    double gaussians, channels, pixels;
    double visible;          ///< Gaussians that reach a tile
    double entries;          ///< pairs of a tile and a Gaussian
    double pairs;            ///< pairs of a pixel and a Gaussian that are blended
    double blocks;           ///< pairs of an entry and a block of as many pixels as a vector has
                             ///< lanes, of which some are blended
    double touched;          ///< entries of which some pixel is blended

    /// Products of a blended pixel: the exponent 2, 2^x of degree 5, the weight 1.
    static constexpr double blend_products = 8;
    /// Products of its reverse step: the same again, the colour's and the alpha's cotangent, 6
    /// moments.
    static constexpr double reverse_products = 21;
    /// Products of a Gaussian's projection, with a Gaussian in each lane: 95, and 5 divisions and
    /// roots of 5 each; about twice of its reverse.
    static constexpr double project_products = 120, project_vjp_products = 240;
    /// Sums of an entry, besides those of channels: centre 2, precision 3, opacity 1.
    static constexpr double entry_sums = 6;
    /// Vector operations, of which a core has as many a cycle as products, that a sum over lanes
    /// takes if many are done at once: it is moved beside another and added.
    static constexpr double sum_operations = 2;

    /// Returns the share that is blended of all pixels in the lanes of those blocks.
    double live(double lanes) const { return pairs / (blocks * lanes); }

    double forward_flops() const { return 2 * pairs * (blend_products + channels); }
    double backward_flops() const { return 2 * pairs * (reverse_products + 2 * channels); }

    /// Reads every input and writes every output, once [byte].
    Traffic forward_traffic() const {
        return {4 * gaussians * (11 + channels), 4 * pixels * (channels + 2)};
    }
    Traffic backward_traffic() const {
        return {4 * gaussians * (11 + channels) + 4 * pixels * channels,
                4 * gaussians * (11 + channels)};
    }
    double forward_bytes() const { return forward_traffic().read + forward_traffic().written; }
    double backward_bytes() const { return backward_traffic().read + backward_traffic().written; }

    /// Returns products of vectors. Pixels are in the lanes; or, of many channels, channels are in
    /// the lanes of the colours' products, one blended pair after another.
    double blend_vectors(double lanes) const {
        return std::min(blocks * (blend_products + channels),
                        blocks * blend_products + pairs * std::ceil(channels / lanes));
    }
    double reverse_vectors(double lanes) const {
        const double pixels_in_lanes = blocks * (reverse_products + 2 * channels) +
                                       touched * sum_operations * (entry_sums + channels);
        const double channels_in_lanes = blocks * (reverse_products + channels) +
                                         pairs * std::ceil(channels / lanes) +
                                         touched * sum_operations * entry_sums;
        return std::min(pixels_in_lanes, channels_in_lanes);
    }

    /// Returns the least time of each stage.
    StageBounds bounds(const Machine& m) const {
        const MemorySpeed& forward = m.memory.at(forward_bytes());
        const MemorySpeed& both = m.memory.at(forward_bytes() + backward_bytes());
        const double vectors = m.vector_products();
        const double read = 4 * gaussians * 11;
        return {std::max(gaussians * project_products / m.lanes / vectors,
                         Traffic{read, 0}.seconds(forward)),
                visible / m.keys,
                entries / m.entries,
                std::max(blend_vectors(m.lanes) / vectors,
                         Traffic{4 * visible * channels, forward_traffic().written}
                             .seconds(forward)),
                std::max(reverse_vectors(m.lanes) / vectors,
                         Traffic{4 * (visible + pixels) * channels, 0}.seconds(both)),
                std::max(gaussians * project_vjp_products / m.lanes / vectors,
                         Traffic{read, backward_traffic().written}.seconds(both))};
    }
};

} // namespace rye::bench
