// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/records.hpp: data between the kernels of a render, in device memory.
#pragma once

#include <cstdint>

#include <rye/backend/cuda.hpp>
#include <rye/backend/cuda/unrolled.hpp>
#include <rye/splat/cuda/gaussians.hpp>
#include <rye/splat/footprint.hpp>

namespace rye {

/// The images of a render, in the caller's memory. Depth and contributor may be null.
struct DeviceImages {
    DeviceColumns<float> feature;                  ///< C x pixels
    DeviceColumns<float> alpha;                    ///< 1 x pixels
    DeviceColumns<float> depth = {};               ///< 1 x pixels
    DeviceColumns<std::uint32_t> contributor = {}; ///< 1 x pixels
};

/// Cotangents of the images. Alpha's and depth's may be null.
struct DeviceCotangent {
    DeviceColumns<const float> feature;
    DeviceColumns<const float> alpha = {};
    DeviceColumns<const float> depth = {};
};

inline constexpr std::uint32_t none_of = 0xFFFFFFFF; ///< no group, no Gaussian

namespace detail {

/// A visible Gaussian as pixels see it: Splat without what follows from the policy.
struct SplatRecord {
    Quad4 place; ///< x, y [px], ux, vx
    Quad4 shape; ///< vy, log2 o, depth, floor
};

/// The columns of tiles [begin, end) in each row of tiles that a Gaussian reaches; of more rows
/// than `most` they follow from its footprint.
struct alignas(16) TileSpans {
    static constexpr int most = 6;
    std::uint16_t first, rows; ///< first row of tiles, number of rows; 0 rows: not visible
    std::uint32_t key;         ///< of the Gaussian's depth
    std::uint16_t begin[most], end[most];
};

/// Numbers of the slots that a pair of a Gaussian and a tile has in the tile's strips.
struct alignas(16) StripSlots {
    std::uint32_t of[4];
};

} // namespace detail

/// Counts of a render. Sums include what did not fit.
struct FrameReport {
    std::uint32_t non_finite; ///< Gaussians left out for a NaN or an infinity
    std::uint32_t entries_low, entries_high; ///< pairs of a tile and a Gaussian, 64 bits
    std::uint32_t groups;                    ///< groups of visits, and at most one a strip more
    std::uint32_t overflow;                  ///< entries did not fit: nothing was drawn
    std::uint32_t ranked;                    ///< room taken for the ranks of entries
};

namespace detail {

/// Sizes and places of a frame's memory.
struct FrameMemory {
    std::uint32_t count; ///< Gaussians
    std::uint32_t tiles, columns;
    std::uint32_t blocks;  ///< blocks of Gaussians
    std::uint32_t entries; ///< capacity
    std::uint32_t groups;  ///< capacity; 0: the render keeps nothing for a vjp

    // By Gaussian.
    SplatRecord* record;
    TileSpans* spans;
    Footprint<float>* footprint; ///< only if there are more rows of tiles than spans hold
    std::uint32_t* places;       ///< number of places
    std::uint32_t* block_places; ///< [blocks]: number of places in it, then before it
    std::uint32_t* block_ranks;  ///< [blocks]: where the ranks of its entries are
    // By tile.
    std::uint32_t* counters; ///< number of entries
    std::uint32_t* begin;    ///< tile t has entries [begin[t], begin[t + 1])
    std::uint32_t* order;    ///< tiles, the longest lists first
    std::uint32_t* last;     ///< [strips] last group of the strip, or none_of
    // By number of groups, in classes.
    std::uint32_t* walked;    ///< [classes] strips whose groups are kept
    std::uint32_t* walked_of; ///< [classes x strips] those strips, in any order
    // By entry.
    std::uint64_t* key;    ///< depth, then place, or Gaussian if nothing is kept; in any order
    std::uint32_t* sorted; ///< Gaussians near to far, as far as they were sorted
    std::uint32_t* rank;   ///< until lists are made, in the memory of `sorted`: places in lists
    // By place: a pair of a Gaussian and a tile, in the order of Gaussians, then of tiles. None if
    // nothing is kept for a vjp.
    std::uint32_t* owner;  ///< the Gaussian
    std::uint32_t* touched; ///< bits [8 places, strips]: 1 if the strip has a slot
    StripSlots* slot;       ///< index of the slot of each strip, if there is one
    // By group of visits of a strip.
    std::uint32_t* before; ///< the strip's group nearer to the eye, or none_of
    std::uint32_t* visits; ///< 16 Gaussians, then their 16 places
    float* transmittance;  ///< [64 pixels] in front of the group
    float* partial;        ///< 16 slots: partial gradients of its visits

    FrameReport* report;

    /// Classes of strips by their groups.
    static constexpr std::uint32_t classes = 32;
    RYE_DEVICE static std::uint32_t class_of(std::uint32_t n) {
        return n < 16 ? n : rye::min(16 + (n - 16) / 4, classes - 1);
    }
    /// Counters lie apart: neighbours in a line of the cache would wait for one another.
    static constexpr std::uint32_t apart = 8;
    RYE_DEVICE std::uint32_t* counter(std::uint32_t tile) const {
        return counters + std::size_t(tile) * apart;
    }
    RYE_DEVICE std::uint32_t tile(int row, int column) const {
        return static_cast<std::uint32_t>(row) * columns + static_cast<std::uint32_t>(column);
    }
    RYE_DEVICE std::uint32_t* counter(int row, int column) const {
        return counter(tile(row, column));
    }
};

/// Side of a strip of a tile: the pixels of a warp [px].
inline constexpr int strip_edge = 8;
/// Strips of a tile.
inline constexpr int tile_strips = 4;
/// Visits that a warp takes at once.
inline constexpr int group_visits = 16;

/// Constants that depend on the number of channels C that a kernel is made for.
template <int C>
struct ChannelLayout {
    static constexpr bool products = C > 4; ///< sums over channels are of matrices
    static constexpr int padded = products ? (C + 15) / 16 * 16 : 4;
    static constexpr int head = products ? 8 : 7;         ///< features begin here in a slot
    static constexpr int stride = (head + C + 3) / 4 * 4; ///< numbers in a slot
    static_assert(C >= 1 && (C <= 4 || C % 8 == 0) && C <= 32);
};

} // namespace detail

} // namespace rye
