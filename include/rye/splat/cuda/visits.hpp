// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/visits.hpp: a Gaussian as the pixels of one tile see it, and the test whether it
/// reaches a strip of 8 x 8 of them. Offsets are from the tile's centre, so that those of pixels
/// are small numbers without error. Every lane has a Gaussian of its own.
#pragma once

#include <cstdint>

#include <rye/splat/cuda/records.hpp>

namespace rye {

/// Number of bf16 numbers that stand for one float in products of matrices: the relative errors of
/// 1, 2 and 3 are about 2.4e-3, 4.2e-6 and 6e-9. A policy may choose it by a static `planes`.
template <class A>
inline constexpr int planes_of = [] {
    if constexpr (requires { A::planes; })
        return A::planes;
    else
        return A::exp2_degree == 0 || A::exp2_degree > 5 || std::derived_from<A, Tight> ? 3 : 2;
}();

/// Inputs of a walking kernel.
struct DeviceScene {
    DeviceColumns<const float> feature; ///< C x N
    const float* background;            ///< C numbers
    Index first_channel;                ///< channels [first, first + channels) are drawn
    int channels;
    float cx, cy;      ///< [px]
    int width, height; ///< [px]

    RYE_DEVICE float background_of(int c) const {
        return c < channels ? background[first_channel + c] : 0.0F;
    }
};

namespace detail {

/// Returns the exponent below which alpha is 0.
template <class A>
RYE_DEVICE float least_exponent(const A& accuracy) {
    using std::log2;
    return log2(static_cast<float>(accuracy.alpha_min));
}

/// Gaussians about a tile's centre.
template <class W>
struct TileSplat {
    using F = typename W::F;
    using U = typename W::U;
    using M = typename W::M;
    /// u = u0 + ux x, v = v0 + vx x + vy y.
    F u0, ux, v0, vx, vy, log2_opacity, depth, floor;

    /// Unpacks a record's eight numbers.
    RYE_DEVICE TileSplat(const Array<F, 4>& place, const Array<F, 4>& shape, float centre_x,
                         float centre_y)
        : ux(place[2]),
          vx(place[3]),
          vy(shape[0]),
          log2_opacity(shape[1]),
          depth(shape[2]),
          floor(shape[3]) {
        const F dx = F(centre_x) - place[0], dy = F(centre_y) - place[1];
        u0 = ux * dx;
        v0 = W::fma(vx, dx, vy * dy);
    }
    RYE_DEVICE TileSplat() {}

    /// Returns true where strip w has a pixel whose exponent reaches the cut: exactly, but for a
    /// margin as large as rounding may be. `least`: the exponent at the cut, without a floor.
    template <class A>
    RYE_DEVICE M reaches(int w, const A& accuracy, float least) const {
        F cut(least);
        if constexpr (A::has_floor)
            cut = W::log2(F(static_cast<float>(accuracy.alpha_min)) + floor);
        const F reach = W::fma(log2_opacity - cut, F(1.0001F), F(1e-5F));
        const F left(static_cast<float>(w % 2 * strip_edge) - 7.5F),
            top(static_cast<float>(w / 2 * strip_edge) - 7.5F), side(strip_edge - 1);
        const F right = left + side, bottom = top + side;
        const F du = F(1e-6F) * W::fma(F(8.0F), size(ux), size(u0));
        const F dv = F(1e-6F) * W::fma(F(8.0F), size(vx) + size(vy), size(v0));
        // The least u^2 + v^2 between the strip's pixels: at the centre, or on an edge.
        const F ul = W::fma(ux, left, u0), ur = W::fma(ux, right, u0);
        const F vl = W::fma(vx, left, v0), vr = W::fma(vx, right, v0);
        const F vt = vy * top, vb = vy * bottom;
        const F nl = nearest(vl + vt, vl + vb, dv), nr = nearest(vr + vt, vr + vb, dv);
        const F el = W::max(size(ul) - du, F(0.0F)), er = W::max(size(ur) - du, F(0.0F));
        F best = W::min(W::fma(el, el, nl * nl), W::fma(er, er, nr * nr));
        const F inverse = F(1.0F) / W::max(W::fma(ux, ux, vx * vx), F(1e-30F));
        best = W::min(best, on_row(v0 + vt, inverse, left, right, du, dv));
        best = W::min(best, on_row(v0 + vb, inverse, left, right, du, dv));
        const F x = -u0 / select(size(ux) > F(0.0F), ux, F(1.0F)); // of the centre
        const F at = W::fma(vx, x, v0);
        const auto inside =
            nearest(ul, ur, du) == F(0.0F) && nearest(at + vt, at + vb, F(4.0F) * dv) == F(0.0F);
        return inside || reach >= best;
    }

  private:
    RYE_DEVICE static F size(const F& x) { return W::max(x, -x); }
    /// Returns the least |x| of an interval, less what rounding may take away; 0 where it holds a
    /// 0.
    RYE_DEVICE static F nearest(const F& a, const F& b, const F& slack) {
        return W::max(W::max(W::min(a, b), -W::max(a, b)) - slack, F(0.0F));
    }
    /// Returns the least of a horizontal edge, v being `v` in the middle column.
    RYE_DEVICE F on_row(const F& v, const F& inverse, const F& left, const F& right, const F& du,
                        const F& dv) const {
        const F x = W::min(right, W::max(left, -W::fma(u0, ux, v * vx) * inverse));
        const F a = W::max(size(W::fma(ux, x, u0)) - du, F(0.0F));
        const F b = W::max(size(W::fma(vx, x, v)) - dv, F(0.0F));
        return W::fma(a, a, b * b);
    }
};

/// The centre of a tile, from the principal point [px].
struct TileCentre {
    float x, y;
    RYE_DEVICE TileCentre(const DeviceScene& scene, std::uint32_t tile, std::uint32_t columns)
        : x(static_cast<float>(static_cast<int>(tile % columns) * tile_edge + tile_edge / 2) -
            scene.cx),
          y(static_cast<float>(static_cast<int>(tile / columns) * tile_edge + tile_edge / 2) -
            scene.cy) {}
};

} // namespace detail

} // namespace rye
