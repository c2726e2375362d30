// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/walk.hpp: sixteen visits of a strip's 64 pixels at once, as both walks over
/// pixels of a device take them. In a warp, lane 4 n + q has column n of the strip, all its 8 rows,
/// and visits 4 q ... 4 q + 3: so a visit's offset u is computed once for a column, weights lie as
/// the operands of matrix units want them, and what runs along visits, transmittance forward and
/// the colour behind on the way back, is a scan over four lanes.
/// Formulas per pixel, forward and back, are in splat/blend.hpp; scans of a warp are here.
#pragma once

#include <rye/splat/blend.hpp>
#include <rye/splat/cuda/visits.hpp>

namespace rye {

namespace detail {

/// The visits of each lane, in their column.
template <class W, class A>
struct Visits {
    using F = typename W::F;

    F u[4];
    F v[4]; ///< in the middle row of the strip
    F vy[4];
    F rest[4]; ///< log2 o - u^2
    F depth[4];
    F floor[A::has_floor ? 4 : 1], cuts[A::has_floor ? 4 : 1];
    F most; ///< the largest log2 o

    /// splat(i): visit i of the lane; column x and middle row y, from the tile's centre.
    template <class Splats>
    RYE_DEVICE Visits(const Splats& splat, const F& x, float y, const A& accuracy) {
        expanded<4>([&](auto i) {
            const TileSplat<W> s = splat(i);
            u[i] = W::fma(s.ux, x, s.u0);
            vy[i] = s.vy;
            v[i] = W::fma(vy[i], F(y), W::fma(s.vx, x, s.v0));
            rest[i] = less(s.log2_opacity, u[i]);
            depth[i] = s.depth;
            if constexpr (i == 0)
                most = s.log2_opacity;
            else
                most = W::max(most, s.log2_opacity);
            if constexpr (A::has_floor) {
                floor[i] = s.floor;
                cuts[i] = W::log2(F(static_cast<float>(accuracy.alpha_min)) + floor[i]);
            }
        });
        static_cast<void>(accuracy);
    }

    /// Returns the exponent of visit i in row `row`.
    RYE_DEVICE F exponent(int i, int row) const {
        return less(rest[i], W::fma(vy[i], F(static_cast<float>(row) - 3.5F), v[i]));
    }
    RYE_DEVICE F cut(int i, const F& least) const {
        if constexpr (A::has_floor)
            return cuts[i];
        else
            return least;
    }
    RYE_DEVICE F floor_of(int i) const {
        if constexpr (A::has_floor)
            return floor[i];
        else
            return F(0.0F);
    }

  private:
    /// less_square() in one rounding.
    RYE_DEVICE static F less(const F& exponent, const F& w) { return W::fma(-w, w, exponent); }
};

/// The pixels of a warp, for splat/blend.hpp: a group of them, with the instructions of a device.
/// clamps: false if no alpha reaches alpha_max. gated: the stop rule is a product, for walks that
/// wait for the units of comparisons.
template <class W, bool clamps, bool gated>
struct WarpPixels : PixelGroup {
    using F = typename W::F;
    static constexpr bool slope_from_weight = true;

    template <class M>
    RYE_DEVICE static F when(const M& condition, const F& x) {
        return select(condition, x, F(0.0F));
    }
    RYE_DEVICE static F when(std::true_type, const F& x) { return x; }
    RYE_DEVICE static F at_most(const F& most, const F& x) {
        if constexpr (clamps)
            return W::min(most, x);
        else
            return x;
    }
    RYE_DEVICE static F while_open(const F& transmittance, const F& stop, const F& alpha) {
        if constexpr (gated) { // by 1 from `stop` on, by 0 up to the number before
            constexpr float steep = 0x1p120F;
            return alpha * W::saturated(transmittance, F(steep), W::next_below(stop) * F(-steep));
        } else {
            return when(transmittance >= stop, alpha);
        }
    }
    RYE_DEVICE static auto moves(const F& most, const F& x) {
        if constexpr (clamps)
            return x < most;
        else
            return std::true_type();
    }
    RYE_DEVICE static F full(const F& t) { return -W::max(t, -t); }
    RYE_DEVICE static F add_product(const F& c, const F& a, const F& b) { return W::fma(a, b, c); }
};

/// 2^x of a warp's numbers.
template <class W>
struct WarpExp2 {
    RYE_DEVICE typename W::F operator()(const typename W::F& x) const { return W::exp2(x); }
};

} // namespace detail

/// Contributions of a lane's four visits to a pixel.
template <class W>
struct Taken {
    using F = typename W::F;
    detail::Contribution<F> visit[4]; ///< alpha and weight 0 where the pixel is full
    F behind;                 ///< transmittance behind the four
    F product;                ///< product of 1 - alpha, if none is left out
};

namespace detail {

/// The formulas of splat/blend.hpp for four visits of each of four lanes at once.
template <class W, class A, bool clamps = true, bool gated = false>
struct WarpBlend {
    using F = typename W::F;
    Blend<A, F, WarpPixels<W, clamps, gated>, WarpExp2<W>> one_visit;
    F least; ///< the exponent at the cut

    RYE_DEVICE explicit WarpBlend(const A& a) : one_visit(a), least(least_exponent(a)) {}

    /// Returns the contributions of visits v in row `row`, given the transmittance t in front of
    /// all sixteen. The transmittance in front of each lane's four is a scan of the products of
    /// 1 - alpha; within the four it is computed one by one.
    RYE_DEVICE Taken<W> take(const Visits<W, A>& v, int row, const F& t) const {
        Taken<W> r;
        Coverage<F> given[4];
        repeated<4>([&](auto i) {
            given[i] = one_visit.coverage(v.exponent(i, row), v.cut(i, least), v.floor_of(i));
        });
        const F one(1.0F);
        r.product = one - given[0].alpha;
        repeated<3>([&](auto i) { r.product = r.product * (one - given[i + 1].alpha); });
        const F near = W::template quad_up<1>(r.product, 1.0F);
        const F nearer = near * W::template quad_up<1>(near, 1.0F);
        r.behind = t * (nearer * W::template quad_up<2>(near, 1.0F));
        repeated<4>([&](auto i) { r.visit[i] = one_visit.take(given[i], r.behind); });
        return r;
    }

    /// Returns the transmittance behind all visits, t being in front. Transmittance never rises: if
    /// a pixel got full in a lane, the visits of later lanes take nothing.
    RYE_DEVICE F behind(const Taken<W>& r, const F& t) const {
        if constexpr (A::stop_rule == Stop::never) {
            return W::template of_quad<3>(r.behind);
        } else {
            F end = r.behind;
            if constexpr (A::stop_rule == Stop::inclusive)
                end = select(r.visit[0].before >= one_visit.stop, end, t);
            end = W::min(end, W::template across<1>(end));
            return W::min(end, W::template across<2>(end));
        }
    }
};

/// Calls f(the rules) for the walk back over a group of visits: of few channels without the clamp
/// of alpha if no opacity reaches it. The walk of many channels has no registers left for two
/// loops.
template <class W, bool few, class A, class F>
RYE_DEVICE void with_rules(const A& accuracy, const Visits<W, A>& v, const F& f) {
    using std::log2;
    if constexpr (few) {
        const float most = log2(static_cast<float>(accuracy.alpha_max)) - 1e-5F; // of rounding
        if (!W::any(v.most > typename W::F(most))) return f(WarpBlend<W, A, false>(accuracy));
    }
    f(WarpBlend<W, A, true, !few>(accuracy));
}

/// A warp's pixels: those of strip w of a tile.
template <class W>
struct StripPixels {
    using F = typename W::F;
    using U = typename W::U;
    int left, top;     ///< strip's corner [px]
    int width, height; ///< image's extent [px]
    F x;               ///< lane's column, from the tile's centre [px]
    float y;           ///< middle row, from the tile's centre [px]

    RYE_DEVICE StripPixels(std::uint32_t tile, std::uint32_t columns, int w, int image_width,
                           int image_height)
        : left(static_cast<int>(tile % columns) * tile_edge + w % 2 * strip_edge),
          top(static_cast<int>(tile / columns) * tile_edge + w / 2 * strip_edge),
          width(image_width),
          height(image_height),
          x(F(static_cast<float>(w % 2 * strip_edge) - 7.5F) + W::number(W::lane() / U(4))),
          y(static_cast<float>(w / 2 * strip_edge) - 4.0F) {}

    /// Returns true where a pixel is in the image: that of the lane's column and row j, or of
    /// another column.
    RYE_DEVICE auto inside(const U& column, const U& j) const {
        return (column < U(static_cast<std::uint32_t>(rye::max(width - left, 0)))) &&
               (j < U(static_cast<std::uint32_t>(rye::max(height - top, 0))));
    }
    RYE_DEVICE auto inside(const U& j) const { return inside(W::lane() / U(4), j); }
    /// Its number, 0 if it is outside.
    RYE_DEVICE U pixel(const U& column, const U& j) const {
        const auto corner = static_cast<std::uint32_t>(top) * static_cast<std::uint32_t>(width) +
                            static_cast<std::uint32_t>(left);
        return select(inside(column, j),
                      U(corner) + j * U(static_cast<std::uint32_t>(width)) + column, U(0));
    }
    RYE_DEVICE U pixel(const U& j) const { return pixel(W::lane() / U(4), j); }
};

/// Returns x of quad lane k in rows 2 k and 2 k + 1: of eight rows that all four lanes have, the
/// two that each writes.
template <class W, class V>
RYE_DEVICE Array<V, 2> own_rows(const V (&x)[8]) {
    const auto q = W::lane() % typename W::U(4);
    const auto pick = [&](auto odd) {
        V r = x[odd];
        r = select(q == typename W::U(1), x[2 + odd], r);
        r = select(q == typename W::U(2), x[4 + odd], r);
        return select(q == typename W::U(3), x[6 + odd], r);
    };
    return {{pick(Constant<0>{}), pick(Constant<1>{})}};
}

} // namespace detail

} // namespace rye
