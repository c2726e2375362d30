// SPDX-License-Identifier: Apache-2.0
/// rye/splat/raster.hpp: the result of a render, and its trace for the vjp.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include <rye/core/aligned.hpp>
#include <rye/gaussian/view.hpp>
#include <rye/splat/falloff.hpp>
#include <rye/splat/outputs.hpp>
#include <rye/splat/ray_peak.hpp>
#include <rye/splat/tile_lists.hpp>
#include <rye/splat/workspaces.hpp>

namespace rye {

/// Number of the member of a Gaussian that is not visible.
inline constexpr std::uint32_t no_member = 0xFFFFFFFF;

/// A visible Gaussian, all that tiles read of it. In float it fills a line of the cache.
template <class T>
struct alignas(64) VisibleGaussian {
    Splat<T> splat;
    detail::TileRows rows;
    std::uint32_t source;                ///< its index
};
static_assert(sizeof(VisibleGaussian<float>) == 64);

/// The order and the cut-offs of one render, so that its vjp differentiates what was drawn.
template <class T>
struct RasterTrace {
    std::vector<VisibleGaussian<T>> members; ///< visible Gaussians, as `lists` numbers them
    std::vector<std::uint32_t> member;   ///< [Gaussians] its member, or no_member
    std::vector<detail::RayPeak<real_t<T>>> peaks; ///< by member, if they are the order; else empty
    TileLists lists;
    std::vector<Index> used;             ///< [tiles] entries read before all pixels were full
    Index non_finite = 0;                ///< Gaussians left out for a NaN or an infinity
};

/// feature = sum_i T_i a_i c_i + T_end background, alpha = 1 - T_end, and the optional outputs.
template <class T, Outputs O = Outputs{}>
struct Raster : detail::OutputImages<T, O> {
    Image<T> feature;                    ///< C channels
    Image<T> alpha;                      ///< 1 channel, in 0..1
    RasterTrace<T> trace;
};

namespace detail {

/// Strips of a tile that are drawn, a bit each (splat/lanes/group.hpp); their pixels alone are
/// written. The plain walk draws them all.
struct StripMask {
    static constexpr int most = 128;
    std::array<std::uint64_t, 2> words;

    bool has(int strip) const { return (word(strip) & bit(strip)) != 0; }
    bool none() const { return (words[0] | words[1]) == 0; }
    void set(int strip) { words[static_cast<std::size_t>(strip / 64)] |= bit(strip); }
    /// Removes all but the first n strips.
    void keep(int n) {
        const auto low = [](int k) {
            return k <= 0 ? 0 : k >= 64 ? ~std::uint64_t(0) : (std::uint64_t(1) << k) - 1;
        };
        words[0] &= low(n);
        words[1] &= low(n - 64);
    }
    void clear(int strip) { words[static_cast<std::size_t>(strip / 64)] &= ~bit(strip); }

  private:
    std::uint64_t word(int strip) const { return words[static_cast<std::size_t>(strip / 64)]; }
    static std::uint64_t bit(int strip) { return std::uint64_t(1) << (strip % 64); }
};
/// Every strip of a tile.
inline constexpr StripMask all_strips{{~std::uint64_t(0), ~std::uint64_t(0)}};

/// Tiles tile(k) to draw, k in [begin, end), and their strips; null means all.
struct DrawnTiles {
    const Index* tiles = nullptr;
    const StripMask* strips = nullptr;
    Index begin = 0, end = 0;

    DrawnTiles part(Index from, Index to) const { return {tiles, strips, from, to}; }
    Index tile(Index k) const { return tiles != nullptr ? tiles[k] : k; }
    const StripMask& mask(Index k) const { return strips != nullptr ? strips[k] : all_strips; }
};

} // namespace detail

/// Visibility of a Gaussian: not drawn, drawn, or not drawn as a number of it is not finite.
enum class Visibility : std::uint8_t { hidden, visible, non_finite };

namespace detail {

/// Partial gradients, one slot an entry, so that no two threads write to one: a SplatCotangent's
/// numbers, an idle one, and the features, in whole eights, as sums of lanes are written. A slot
/// that is not touched holds none.
template <class T>
struct PartialGradients {
    static constexpr Index head = 8;     ///< features begin here
    AlignedArray<T> numbers;             ///< `stride` of each slot
    std::vector<std::uint8_t> touched;
    Index stride = 0;

    void shape(Index count, Index channels) {
        stride = head + (channels + 7) / 8 * 8;
        numbers.reserve(count * stride);
        touched.assign(static_cast<std::size_t>(count), 0);
    }
    /// Returns features of a slot, the idle ones behind the last channel too: what a walk must
    /// write.
    Index features() const { return stride - head; }
    T* operator[](Index slot) { return numbers.data() + slot * stride; }
    const T* operator[](Index slot) const { return numbers.data() + slot * stride; }
    bool is_touched(Index slot) const { return touched[static_cast<std::size_t>(slot)] != 0; }
};

} // namespace detail

/// Memory that renders may share to spare allocations; it holds no state between calls.
template <class T>
struct RasterScratch {
    using Key = decltype(detail::depth_key(real_t<T>()));

    std::vector<VisibleGaussian<T>> candidates;  ///< by index; only visible ones hold anything
    std::vector<Footprint<real_t<T>>> footprints; ///< by index; only of those whose rows do not
                                                  ///< say which columns
    std::vector<Visibility> state;       ///< by index
    std::vector<std::uint32_t> first_tile; ///< by index: the tile that orders visible ones
    /// [chunks, tiles] Number of members in the tile, then index of the next one.
    std::vector<std::vector<std::uint32_t>> tile_counts;
    detail::BinScratch<Key> bins;
    detail::BinScratch<std::uint64_t> fine_bins; ///< for policies that ask for more bits than T's

    /// Makes room for n Gaussians; room that an earlier render had stays as it is.
    void shape(Index n) {
        const auto count = std::max(candidates.size(), static_cast<std::size_t>(n));
        candidates.resize(count);
        footprints.resize(count);
        state.resize(count);
        first_tile.resize(count);
    }

    detail::PartialGradients<T> slots;
    detail::Workspaces workspaces;
};

namespace detail {

/// A tile and its strips to draw.
struct DrawnTile {
    Index tile;
    const StripMask& strips;
};

/// A pixel (x, y) of the image, in a tile.
struct TilePixel {
    Index tile;
    int x, y;
};

} // namespace detail

/// Inputs of a walk over pixels.
template <class T>
struct Scene {
    const RasterTrace<T>& trace;
    GaussianView<T> gaussians;
    const VecX<T>& background;           ///< C
    T cx, cy;                            ///< principal point [px]
    int width, height;                   ///< [px]

    std::size_t member_of(Index entry) const {
        return trace.lists.entry[static_cast<std::size_t>(entry)].member;
    }
    Index channels() const { return gaussians.channels(); }
    const VisibleGaussian<T>& member(Index entry) const { return trace.members[member_of(entry)]; }
    const Splat<T>& splat(Index entry) const { return member(entry).splat; }
    const T* feature_of(Index entry) const {
        return gaussians.feature_of(static_cast<Index>(member(entry).source));
    }
    Index slot(Index entry) const {
        return static_cast<Index>(trace.lists.entry[static_cast<std::size_t>(entry)].slot);
    }
    Index begin(Index tile) const { return trace.lists.begin[static_cast<std::size_t>(tile)]; }
    Index end(Index tile) const { return trace.lists.begin[static_cast<std::size_t>(tile) + 1]; }
    Index used(Index tile) const { return trace.used[static_cast<std::size_t>(tile)]; }
    /// Returns the top left pixel of a tile, and the end of its pixels.
    int left(Index tile) const {
        return static_cast<int>(tile % trace.lists.columns) * detail::tile_edge;
    }
    int top(Index tile) const {
        return static_cast<int>(tile / trace.lists.columns) * detail::tile_edge;
    }
    int right(Index tile) const { return std::min(width, left(tile) + detail::tile_edge); }
    int bottom(Index tile) const { return std::min(height, top(tile) + detail::tile_edge); }
    Index pixel(int x, int y) const { return static_cast<Index>(y) * width + x; }
};

/// Cotangents of the three images; alpha's and depth's may be absent.
template <class T>
struct RasterCotangent {
    const Columns<T>& feature;           ///< C x pixels
    const Columns<T>* alpha = nullptr;   ///< 1 x pixels
    const Columns<T>* depth = nullptr;   ///< 1 x pixels
};

namespace detail {

/// A tile, and the cotangents of the images that it is part of.
template <class T>
struct TileCotangent {
    const RasterCotangent<T>& images;
    Index tile;
};

} // namespace detail

} // namespace rye
