// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/records.hpp: what the kernels of a render hand to one another in device memory.
#pragma once

#include <cstdint>

#include <rye/backend/cuda.hpp>
#include <rye/backend/cuda/unrolled.hpp>
#include <rye/splat/footprint.hpp>

namespace rye {

/// Gaussians in device memory, of as many numbers a column as Gaussians<T> has.
template <class T>
struct DeviceGaussians {
    DeviceColumns<T> mean, rotation, scale, opacity, feature;

    RYE_HD Index count() const { return mean.cols; }
    RYE_HD Index channels() const { return feature.rows; }
    template <class U>
        requires(std::same_as<U, const T> && !std::is_const_v<T>)
    operator DeviceGaussians<U>() const {
        return {mean, rotation, scale, opacity, feature};
    }
};

/// The images of a render, in the caller's memory. Depth and contributor may be null.
struct DeviceImages {
    DeviceColumns<float> feature;                 ///< C x pixels
    DeviceColumns<float> alpha;                   ///< 1 x pixels
    DeviceColumns<float> depth = {};              ///< 1 x pixels
    DeviceColumns<std::uint32_t> contributor = {}; ///< 1 x pixels
};

/// Cotangents of the images. Alpha's and depth's may be null.
struct DeviceCotangent {
    DeviceColumns<const float> feature;
    DeviceColumns<const float> alpha = {};
    DeviceColumns<const float> depth = {};
};

inline constexpr std::uint32_t no_slot = 0xFFFFFFFF;
inline constexpr std::uint32_t no_batch = 0xFFFFFFFF;

/// A visible Gaussian as pixels see it: Splat without what follows from the policy.
struct SplatRecord {
    Quad4 place;                 ///< x, y [px], ux, vx
    Quad4 shape;                 ///< vy, log2 o, depth, floor
};

/// The columns of tiles [begin, end) in each row of tiles that a Gaussian reaches; of more rows
/// than `most` they follow from its footprint.
struct alignas(16) TileSpans {
    static constexpr int most = 3;
    std::uint16_t first, rows;   ///< of tiles; no rows: it is not visible
    std::uint16_t begin[most], end[most];
};

/// What a render found out about itself. Sums are of all that it would have taken.
struct FrameReport {
    std::uint32_t non_finite;    ///< Gaussians left out for a NaN, an infinity, no quaternion
    std::uint32_t entries_low, entries_high;  ///< pairs of a tile and a Gaussian, 64 bits
    std::uint32_t batches;       ///< of entries that were walked
    std::uint32_t overflow;      ///< entries did not fit: nothing was drawn
};

/// Sizes and places of a frame's memory.
struct FrameMemory {
    std::uint32_t count;         ///< Gaussians
    std::uint32_t tiles, columns;
    std::uint32_t blocks;        ///< of Gaussians
    std::uint32_t entries;       ///< capacity
    std::uint32_t batches;       ///< capacity; 0: the render keeps nothing for a vjp

    // By Gaussian.
    SplatRecord* record;
    TileSpans* spans;
    Footprint<float>* footprint; ///< of those with more rows of tiles than spans hold
    std::uint32_t* first;        ///< its places are [first, first + count)
    std::uint32_t* places;       ///< how many
    std::uint32_t* block_places; ///< of each block: how many, then how many before it
    // By tile.
    std::uint32_t* counters;     ///< of entries, then where the next one goes
    std::uint32_t* begin;        ///< tile t has entries [begin[t], begin[t + 1])
    std::uint32_t* order;        ///< tiles, the longest lists first
    std::uint32_t* last;         ///< its last batch that was walked, or no_batch
    // By entry.
    std::uint64_t* key;          ///< depth, then place; in the tile's list in any order
    std::uint32_t* sorted_place; ///< near to far, as far as it was walked
    std::uint32_t* sorted_owner;
    // By place: a pair of a Gaussian and a tile, in the order of Gaussians, then of tiles.
    std::uint32_t* owner;        ///< the Gaussian
    std::uint32_t* slot;         ///< where its partial gradient is, or no_slot
    // By batch.
    std::uint32_t* walked;       ///< a WalkedBatch each
    float* transmittance;        ///< of each strip and group, before it: 64 pixels
    float* partial;              ///< slots of gradients

    FrameReport* report;

    /// Counters lie apart: neighbours in a line of the cache would wait for one another.
    static constexpr std::uint32_t apart = 8;
    RYE_DEVICE std::uint32_t* counter(std::uint32_t tile) const {
        return counters + std::size_t(tile) * apart;
    }
    RYE_DEVICE std::uint32_t* counter(int row, int column) const {
        return counter(static_cast<std::uint32_t>(row) * columns +
                       static_cast<std::uint32_t>(column));
    }
};

/// Side of a strip of a tile: the pixels of a warp [px].
inline constexpr int strip_edge = 8;
inline constexpr int strips = 4;
/// Visits that a warp takes at once.
inline constexpr int group_visits = 16;

/// A batch of a tile's entries as the render walked it, so that its vjp walks the same.
template <int words>
struct WalkedBatch {
    std::uint32_t before;        ///< the tile's batch nearer to the eye, or no_batch
    std::uint32_t start, count;  ///< entries, from the tile's first
    std::uint32_t groups;        ///< of visits that each strip walked, 8 bits each
    std::uint32_t visits[strips][words];  ///< entries that a strip visits, a bit each
};

/// What depends on the number of channels C that a kernel is made for.
template <int C>
struct ChannelLayout {
    static constexpr bool products = C > 4;           ///< sums over channels are of matrices
    static constexpr int padded = products ? (C + 15) / 16 * 16 : 4;
    static constexpr int batch = C > 8 ? 64 : 128;    ///< entries that are staged at once
    static constexpr int groups = batch / group_visits;
    static constexpr int words = batch / 32;
    static constexpr int stride = products ? 8 + C : 12; ///< of a slot
    static constexpr int head = 8;                    ///< features begin here in a slot
    static_assert(C >= 1 && (C <= 4 || C % 8 == 0) && C <= 32);
};

} // namespace rye
