// SPDX-License-Identifier: Apache-2.0
/// rye/gaussian/antialias.hpp: treatment of Gaussians that are small on the screen [px].
/// none: unchanged; they vanish between pixel centres. dilate: d is added to both variances, so
/// that each covers a pixel centre; small ones then contribute too much. mip: dilated, and the
/// opacity is multiplied by share = sqrt(det Sigma / det(Sigma + d I)), which keeps the integrated
/// contribution the same at every distance.
/// Source: Yu et al., "Mip-Splatting", 2024, eq. 10, with d of the screen filter.
#pragma once

#include <cmath>

#include <rye/math/linalg.hpp>

namespace rye {

/// Treatment of Gaussians that are small on the screen: unchanged, dilated, or dilated with the
/// same integral.
enum class Antialias { none, dilate, mip };

/// Returns sqrt(det Sigma / det(Sigma + d I)) in [0, 1], from the rows of the factor, never from
/// the entries of Sigma. 1 without dilation.
template <Scalar T>
RYE_HD T dilation_share(const Vec3<T>& x, const Vec3<T>& y, const T& dilation) {
    using std::sqrt;
    const Vec3<T> n = cross(x, y);
    const T plain = dot(n, n), dilated = detail::gram_determinant(x, y, dilation);
    const auto visible = plain > T(0);
    return select(visible, T(sqrt(select(visible, plain, T(1)) /
                                  select(visible, dilated, T(1)))), T(0));
}

/// Adds the cotangents of the rows, given that of log(share). Since that is g alpha summed over
/// pixels, which goes to 0 with the share, nothing grows without bound; a Gaussian without area
/// gets 0.
template <Scalar T>
RYE_HD void dilation_share_vjp(const Vec3<T>& x, const Vec3<T>& y, const T& dilation,
                               const T& g_log, Vec3<T>& g_x, Vec3<T>& g_y) {
    const Vec3<T> n = cross(x, y);
    const T plain = dot(n, n), dilated = detail::gram_determinant(x, y, dilation);
    const auto visible = plain > T(0);
    const T a = select(visible, T(g_log / select(visible, plain, T(1))), T(0));
    const T b = select(visible, T(g_log / select(visible, dilated, T(1))), T(0));
    const Vec3<T> by_x = cross(y, n), by_y = cross(n, x); // half the slopes of det Sigma
    for (int i = 0; i < 3; ++i) {
        g_x[i] += a * by_x[i] - b * (by_x[i] + dilation * x[i]);
        g_y[i] += a * by_y[i] - b * (by_y[i] + dilation * y[i]);
    }
}

} // namespace rye
