// SPDX-License-Identifier: Apache-2.0
/// rye/splat/falloff.hpp: the opacity of a Gaussian at a pixel, and its gradient.
/// alpha = min(alpha_max, o exp(-|w|^2 / 2) - o f), w = L (p - centre), evaluated as
/// 2^(log2 o - u^2 - v^2) with sqrt(log2(e) / 2) folded into L: the cut-off is then a comparison
/// before the exponential, and the exponent never exceeds log2 o.
#pragma once

#include <algorithm>
#include <cmath>

#include <rye/gaussian/project.hpp>
#include <rye/splat/accuracy.hpp>

namespace rye {

/// sqrt(log2(e) / 2) and its inverse: whitened offsets to folded ones and back.
inline constexpr double fold = 0.84932180028801904272;

namespace detail {

/// The inverse of fold.
inline constexpr double unfold = 1.17741002251547469101;

} // namespace detail

/// A Gaussian as a pixel sees it.
template <class T>
struct Splat {
    T x, y;                  ///< centre, from the principal point [px]
    T ux;                    ///< u = ux dx           (folded) [1/px]
    T vx, vy;                ///< v = vx dx + vy dy   (folded) [1/px]
    T log2_opacity;
    T cut;                   ///< exponents below are skipped
    T floor;                 ///< o f, subtracted from the bell; 0 without a floor
    T depth;                 ///< [world units]
};

/// Sums over pixels, g being the cotangent of the exponent -(u^2 + v^2) in natural units. Slots
/// hold them in this order.
template <class T>
struct SplatCotangent {
    T u, v;                  ///< sum of g u, g v
    T uu, uv, vv;            ///< sum of g u^2, g u v, g v^2
    T alpha;                 ///< sum of alpha d/d alpha
    T depth;                 ///< sum of weight d/d depth
};

/// Returns the record of a Gaussian of opacity o > 0.
template <class A, class T>
RYE_HD Splat<T> make_splat(const ScreenGaussian<T>& s, const T& opacity, const A& accuracy) {
    using std::log2;
    using R = real_t<T>;
    Splat<T> r;
    r.x = s.centre[0];
    r.y = s.centre[1];
    r.ux = T(R(fold)) * s.precision.k1;
    r.vy = T(R(fold)) * s.precision.k2;
    r.vx = -r.vy * s.precision.m;
    r.log2_opacity = log2(opacity);
    r.floor = T(0);
    r.cut = T(R(accuracy.alpha_min));
    if constexpr (A::has_floor) {
        r.floor = T(R(accuracy.alpha_floor)) * opacity;
        r.cut += r.floor;
    }
    r.cut = log2(r.cut);
    r.depth = s.depth;
    return r;
}

namespace detail {

/// Returns the gradient of the screen Gaussian from the sums over pixels.
template <class T>
RYE_HD ScreenCotangent<T> screen_cotangent(const Splat<T>& s, const SplatCotangent<T>& g) {
    using R = real_t<T>;
    const T square = T(R(unfold * unfold));        // once to unfold w, once to unfold L
    ScreenCotangent<T> r;
    r.centre = Vec2<T>(square * (s.ux * g.u + s.vx * g.v), square * (s.vy * g.v));
    r.moment = {square * g.uu, square * g.uv, square * g.vv};
    r.depth = g.depth;
    return r;
}

} // namespace detail

} // namespace rye
