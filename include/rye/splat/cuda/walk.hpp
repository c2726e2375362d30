// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/walk.hpp: sixteen visits of a strip's 64 pixels at once, as both walks over
/// pixels of a device take them. In a warp, lane 4 n + q has column n of the strip, all its 8 rows,
/// and visits 4 q ... 4 q + 3: so a visit's offset u is computed once for a column, weights lie as
/// the operands of matrix units want them, and what runs along visits, transmittance forward and
/// the colour behind on the way back, is a scan over four lanes.
/// As in splat/blend.hpp, T_i+1 = T_i (1 - alpha_i), weight_i = alpha_i T_i.
#pragma once

#include <rye/splat/cuda/visits.hpp>

namespace rye {

/// The visits of each lane, in their column.
template <class W, class A>
struct Visits {
    using F = typename W::F;

    F u[4];
    F v[4]; ///< in the middle row of the strip
    F vy[4];
    F rest[4]; ///< log2 o - u^2
    F depth[4];
    F floor[A::has_floor ? 4 : 1], cut[A::has_floor ? 4 : 1];

    /// splat(i): visit i of the lane; column x and middle row y, from the tile's centre.
    template <class Splats>
    RYE_DEVICE Visits(const Splats& splat, const F& x, float y, const A& accuracy) {
        expanded<4>([&](auto i) {
            const TileSplat<W> s = splat(i);
            u[i] = W::fma(s.ux, x, s.u0);
            vy[i] = s.vy;
            v[i] = W::fma(vy[i], F(y), W::fma(s.vx, x, s.v0));
            rest[i] = W::fma(-u[i], u[i], s.log2_opacity);
            depth[i] = s.depth;
            if constexpr (A::has_floor) {
                floor[i] = s.floor;
                cut[i] = W::log2(F(static_cast<float>(accuracy.alpha_min)) + floor[i]);
            }
        });
        static_cast<void>(accuracy);
    }

    /// alpha of visit i in row `row`; 0 where it is not reached.
    RYE_DEVICE F alpha(int i, int row, const F& least, const F& alpha_max) const {
        const F at = W::fma(vy[i], F(static_cast<float>(row) - 3.5F), v[i]);
        const F exponent = W::fma(-at, at, rest[i]);
        F a = W::exp2(exponent);
        if constexpr (A::has_floor) {
            a = a - floor[i];
            return select(exponent >= cut[i], W::min(alpha_max, a), F(0.0F));
        } else {
            return select(exponent >= least, W::min(alpha_max, a), F(0.0F));
        }
    }
};

/// What a pixel's four visits of a lane take from it.
template <class W>
struct Taken {
    using F = typename W::F;
    F alpha[4];  ///< 0 where the pixel is full
    F before[4]; ///< transmittance in front of each
    F weight[4];
    F product; ///< of 1 - alpha, where none is left out
};

/// The rules by which a pixel gets full, for the scan of its transmittance.
template <class W, class A>
struct Transmittance {
    using F = typename W::F;
    F alpha_max, stop, least; ///< `least`: the exponent at the cut

    RYE_DEVICE explicit Transmittance(const A& a)
        : alpha_max(static_cast<float>(a.alpha_max)),
          stop(static_cast<float>(a.stop)),
          least(least_exponent(a)) {}

    /// Whether a pixel can still take something.
    RYE_DEVICE auto open(const F& t) const {
        return t >= (A::stop_rule == Stop::inclusive ? stop : F(0.0F)) && t > F(0.0F);
    }

    /// Four visits of each of four lanes, of transmittance t in front of them all.
    RYE_DEVICE Taken<W> take(const F (&alpha)[4], const F& t) const {
        Taken<W> r;
        const F one(1.0F);
        const F keep0 = one - alpha[0], keep1 = one - alpha[1], keep2 = one - alpha[2],
                keep3 = one - alpha[3];
        const F two = keep0 * keep1, three = two * keep2;
        r.product = three * keep3;
        const F near = W::template quad_up<1>(r.product, 1.0F);
        const F nearer = near * W::template quad_up<1>(near, 1.0F);
        const F start = t * (nearer * W::template quad_up<2>(near, 1.0F));
        r.before[0] = start;
        r.before[1] = start * keep0;
        r.before[2] = start * two;
        r.before[3] = start * three;
        expanded<4>([&](auto i) {
            r.alpha[i] = select(taken(r, i), alpha[i], F(0.0F));
            r.weight[i] = r.alpha[i] * r.before[i];
        });
        return r;
    }

    /// The transmittance behind all of them.
    RYE_DEVICE F behind(const Taken<W>& r, const F& t) const {
        const F last = r.before[0] * r.product;
        if constexpr (A::stop_rule == Stop::never) {
            return W::template of_quad<3>(last);
        } else {
            F least_taken = t;
            expanded<4>([&](auto i) {
                F next = last;
                if constexpr (i < 3) next = r.before[i + 1];
                least_taken = select(taken(r, i), next, least_taken);
            });
            F end = W::min(least_taken, W::template across<1>(least_taken));
            end = W::min(end, W::template across<2>(end));
            if constexpr (A::stop_rule == Stop::exclusive) {
                // Full before it falls below `stop`: its sign is turned.
                const F lowest = W::template of_quad<3>(last);
                end = select(lowest >= stop, end, -W::max(end, -end));
            }
            return end;
        }
    }

  private:
    /// Visits follow one another and transmittance never rises: what comes after one that is not
    /// taken is not taken either.
    template <class I>
    RYE_DEVICE auto taken(const Taken<W>& r, I i) const {
        if constexpr (A::stop_rule == Stop::inclusive) {
            return r.before[i] >= stop;
        } else if constexpr (A::stop_rule == Stop::exclusive) {
            if constexpr (i < 3)
                return r.before[i + 1] >= stop;
            else
                return r.before[0] * r.product >= stop;
        } else {
            return r.before[i] >= F(0.0F);
        }
    }
};

/// A warp's pixels: those of strip w of a tile.
template <class W>
struct StripPixels {
    using F = typename W::F;
    using U = typename W::U;
    int left, top;     ///< of the strip [px]
    int width, height; ///< of the image [px]
    F x;               ///< of the lane's column, from the tile's centre [px]
    float y;           ///< of the middle row, likewise

    RYE_DEVICE StripPixels(std::uint32_t tile, std::uint32_t columns, int w, int image_width,
                           int image_height)
        : left(static_cast<int>(tile % columns) * tile_edge + w % 2 * strip_edge),
          top(static_cast<int>(tile / columns) * tile_edge + w / 2 * strip_edge),
          width(image_width),
          height(image_height),
          x(F(static_cast<float>(w % 2 * strip_edge) - 7.5F) + W::number(W::lane() / U(4))),
          y(static_cast<float>(w / 2 * strip_edge) - 4.0F) {}

    /// Whether a pixel is in the image: that of the lane's column and row j, or of another column.
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

/// x of quad lane k in rows 2 k and 2 k + 1: of eight rows that all four lanes have, the two that
/// each writes.
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

} // namespace rye
