// SPDX-License-Identifier: Apache-2.0
/// rye/splat/tiles.hpp: the pixels and tiles in which a Gaussian can be seen. Pixel units.
/// Source: bounds as in Radl et al., "StopThePop", 2024, but per row of tiles and exact.
#pragma once

#include <cmath>
#include <concepts>
#include <cstdint>
#include <type_traits>

#include <rye/core/array.hpp>
#include <rye/core/bit_cast.hpp>
#include <rye/math/linalg.hpp>
#include <rye/splat/accuracy.hpp>

namespace rye {

namespace detail {

/// Side of a tile [px]: 16 has half the entries of 8.
inline constexpr int tile_edge = 16;
/// Pixels of a tile.
inline constexpr int tile_pixels = tile_edge * tile_edge;

} // namespace detail

/// The region where a Gaussian's alpha can reach alpha_min: an ellipse, or a square.
template <class R>              // Real, or a batch of them
struct Footprint {
    R x, y;                      ///< centre in the image [px]
    R radius;                    ///< [standard deviations]; of a square: half its side [px]
    Sym2<R> covariance;          ///< [px^2]
    R determinant;               ///< [px^4]
};

/// Pixels or tiles [begin, end).
struct Span {
    int begin = 0, end = 0;
};

namespace detail {

/// The same in whole numbers of type R: Real, or a batch of them.
template <class R>
struct PixelInterval {
    R begin, end;
};

/// Returns whole pixels whose centres lie in [low, high], cut to [0, size).
template <class R>
RYE_HD PixelInterval<R> pixel_interval(const R& low, const R& high, int size) {
    using std::ceil, std::floor;
    using S = real_t<R>;
    const R top(static_cast<S>(size));
    const R b = ceil(min(top, R(max(R(S(0)), R(low - R(S(0.5)))))));
    const R e = floor(min(top, R(max(R(S(-1)), R(high - R(S(0.5))))))) + R(S(1));
    return {b, min(top, e)};
}

} // namespace detail

/// Returns the interval in integers.
template <Real R>
RYE_HD Span whole(const detail::PixelInterval<R>& r) {
    return {static_cast<int>(r.begin), static_cast<int>(r.end)};
}
/// Returns the pixels of a row or column of `size` whose centres lie in [low, high].
template <Real R>
RYE_HD Span pixels_between(R low, R high, int size) {
    return whole(detail::pixel_interval(low, high, size));
}
/// Returns the number of tiles along a side of an image.
RYE_HD inline int tiles_across(int pixels) {
    return (pixels + detail::tile_edge - 1) / detail::tile_edge;
}
/// Returns the tiles that these pixels lie in.
RYE_HD inline Span tiles_of(const Span& px) {
    if (px.begin >= px.end) return {};
    return {px.begin / detail::tile_edge, (px.end - 1) / detail::tile_edge + 1};
}

/// The footprint's rows of pixels, and for each row of tiles its columns of tiles.
template <Support support, class R>  // Real, or a batch of them
struct Cover {
    using S = real_t<R>;
    Footprint<R> f;
    int width, height;           ///< image's extent [px]

    RYE_HD Span rows() const { return whole(row_range()); }

    RYE_HD detail::PixelInterval<R> row_range() const {
        using std::sqrt;
        if constexpr (support == Support::square) {
            return square(f.y, height);
        } else {
            const R reach = f.radius * sqrt(f.covariance.yy) + slack();
            return detail::pixel_interval(R(f.y - reach), R(f.y + reach), height);
        }
    }

    /// Returns the columns of tiles in tile row `row`; only pixels within `rows` count.
    RYE_HD Span columns(int row, const Span& rows) const {
        const auto top = static_cast<R>(max(row * detail::tile_edge, rows.begin));
        const auto bottom = static_cast<R>(min((row + 1) * detail::tile_edge, rows.end));
        return tiles_of(whole(Slabs(*this).pixels(top, bottom)));
    }

    /// The widest part of the footprint within rows [top, bottom) of pixels.
    struct Slabs {
        const Cover& c;
        R slack, tilt, widest, squared, inverse_yy, left_over;

        RYE_HD explicit Slabs(const Cover& cover) : c(cover) {
            using std::sqrt;
            const Footprint<R>& from = cover.f;
            slack = c.slack();
            inverse_yy = R(S(1)) / from.covariance.yy;
            tilt = from.covariance.xy * inverse_yy;                         // slope of E[x | y]
            // y of the rightmost point
            widest = from.radius * from.covariance.xy / sqrt(from.covariance.xx);
            squared = from.radius * from.radius;
            left_over = from.determinant * inverse_yy;
        }
        RYE_HD detail::PixelInterval<R> pixels(const R& top, const R& bottom) const {
            if constexpr (support == Support::square) {
                return c.square(c.f.x, c.width);
            } else {
                const R low = top + R(S(0.5)) - c.f.y, high = bottom - R(S(0.5)) - c.f.y;
                return detail::pixel_interval(R(c.f.x + end(-widest, low, high, S(-1)) - slack),
                                              R(c.f.x + end(widest, low, high, S(1)) + slack),
                                              c.width);
            }
        }

      private:
        /// Returns the left (-1) or right (+1) end of the ellipse at the y in [low, high] nearest
        /// to `nearest`.
        RYE_HD R end(const R& nearest, const R& low, const R& high, S side) const {
            using std::sqrt;
            const R at = min(high, R(max(low, nearest)));
            const R rest = max(R(S(0)), R(squared - at * at * inverse_yy));
            return tilt * at + R(side) * sqrt(R(rest * left_over));
        }
    };

  private:
    /// Returns a margin for rounding, which moves a bound by a few units in the last place of a
    /// position.
    RYE_HD R slack() const {
        using std::abs, std::sqrt;
        return R(S(8) * Limits<S>::epsilon) *
               (abs(f.x) + abs(f.y) + f.radius * sqrt(f.covariance.xx) +
                f.radius * sqrt(f.covariance.yy) + R(S(1)));
    }

    /// Returns the 16 px tiles that [centre - radius, centre + radius] touches, as pixels.
    RYE_HD detail::PixelInterval<R> square(const R& centre, int size) const {
        using std::floor;
        constexpr S coarse = 16;
        const R top(static_cast<S>(size) + coarse), zero(S(0)), p = centre - R(S(0.5));
        const auto touched = [&](const R& edge) {
            const R cut = min(top, R(max(zero, edge)));
            return R(min(R(static_cast<S>(size)), R(floor(R(cut * R(1 / coarse))) * R(coarse))));
        };
        return {touched(R(p - f.radius)), touched(R(p + f.radius + R(coarse - 1)))};
    }
};

namespace detail {

/// Rows of pixels, and the columns of tiles in the few rows of tiles that most Gaussians span.
struct TileRows : Span {
    static constexpr int most = 3;
    Array<Array<std::uint16_t, 2>, most> columns;

    RYE_HD int first_row() const { return begin / tile_edge; }
    RYE_HD int last_row() const { return (end + tile_edge - 1) / tile_edge; }
    /// Returns true if an image's columns of tiles fit.
    RYE_HD static bool fits(int width) { return width / tile_edge < 0xFFFF; }
    RYE_HD bool known(int width) const { return last_row() - first_row() <= most && fits(width); }
};

/// Tiles [begin, end) of a row of tiles.
struct TileRowSpan {
    int row, begin, end;
};

} // namespace detail

/// Calls f for each row of tiles that a footprint reaches; `rows` are its rows of pixels, not
/// empty, and footprint() is called only if these do not give the columns.
template <Support support, Real R, class Rows, class Footprint, class F>
void each_tile_row(int width, int height, const Rows& rows, const Footprint& footprint,
                   const F& f) {
    const int begin = rows.begin / detail::tile_edge,
              end = (rows.end + detail::tile_edge - 1) / detail::tile_edge;
    if constexpr (std::same_as<Rows, detail::TileRows>)
        if (rows.known(width)) {
            for (int y = begin; y < end; ++y) {
                const auto& c = rows.columns[static_cast<std::size_t>(y - begin)];
                f(detail::TileRowSpan{y, c[0], c[1]});
            }
            return;
        }
    const Cover<support, R> cover{footprint(), width, height};
    for (int y = begin; y < end; ++y) {
        const Span s = cover.columns(y, rows);
        f(detail::TileRowSpan{y, s.begin, s.end});
    }
}

namespace detail {

/// Returns the bits that compare as the number does.
template <Real R>
RYE_HD auto depth_key(R depth) {
    using Bits = std::conditional_t<sizeof(R) == 4, std::uint32_t, std::uint64_t>;
    const Bits b = bit_cast<Bits>(depth);
    constexpr Bits sign = Bits(1) << (8 * sizeof(Bits) - 1);
    return (b & sign) != 0 ? static_cast<Bits>(~b) : static_cast<Bits>(b | sign);
}

} // namespace detail

} // namespace rye
