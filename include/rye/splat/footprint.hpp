// SPDX-License-Identifier: Apache-2.0
/// rye/splat/footprint.hpp: the extent of a screen Gaussian, from the numbers that a pixel reads of
/// it. Pixel units.
#pragma once

#include <cmath>
#include <type_traits>

#include <rye/splat/falloff.hpp>
#include <rye/splat/tiles.hpp>

namespace rye::detail {

/// Returns a screen Gaussian's extent without derivatives, in the image's pixels.
template <class A, class T>
RYE_HD auto footprint_of(const ScreenGaussian<T>& s, const Splat<T>& splat, const T& cx,
                         const T& cy) {
    using std::ceil, std::sqrt;
    using R = real_t<T>;
    using V = std::remove_cvref_t<decltype(value_of(std::declval<const T&>()))>;
    Footprint<V> f;
    f.x = value_of(s.centre[0]) + value_of(cx);
    f.y = value_of(s.centre[1]) + value_of(cy);
    f.covariance = {value_of(s.covariance.xx), value_of(s.covariance.xy),
                    value_of(s.covariance.yy)};
    f.determinant = value_of(s.determinant);
    if constexpr (A::support == Support::square) {
        const V mid = V(R(0.5)) * (f.covariance.xx + f.covariance.yy);
        const V spread = sqrt(max(V(R(0.1)), V(mid * mid - f.determinant)));
        f.radius = ceil(V(R(3)) * sqrt(mid + spread));                    // [px]
    } else {
        // exponent >= cut  <=>  |w|^2 <= 2 ln(2) (log2 o - cut); the factor covers rounding.
        const V reach = value_of(splat.log2_opacity) - value_of(splat.cut);
        f.radius = V(R(unfold) * (R(1) + R(16) * Limits<R>::epsilon)) *
                   sqrt(max(V(R(0)), reach));
    }
    return f;
}

} // namespace rye::detail
