// SPDX-License-Identifier: Apache-2.0
/// rye/gaussian/antialias.hpp: what is done about Gaussians that are small on the screen [px].
/// none: nothing, and they vanish between pixel centres. dilate: d is added to both variances, so
/// that each is seen; small ones then blend more than they should. mip: dilated, too, but of its
/// opacity each keeps only share = sqrt(det Sigma / det(Sigma + d I)), so that its light stays what
/// it was at every distance.
/// Source: Yu et al., "Mip-Splatting", 2024, eq. 10, with d of the screen filter.
#pragma once

#include <cmath>

#include <rye/math/linalg.hpp>

namespace rye {

enum class Antialias { none, dilate, mip };

/// From the rows of the factor (numerics: never from the entries of Sigma). In [0, 1]; 1 without
/// dilation.
template <Scalar T>
RYE_HD T dilation_share(const Vec3<T>& x, const Vec3<T>& y, const T& dilation) {
    using std::sqrt;
    const Vec3<T> n = cross(x, y);
    const T plain = dot(n, n), dilated = gram_determinant(x, y, dilation);
    const auto visible = plain > T(0);
    return select(visible, T(sqrt(select(visible, plain, T(1)) /
                                  select(visible, dilated, T(1)))), T(0));
}

/// Adds the cotangents of the rows for that of log(share). What multiplies an opacity hands down
/// the sum of g alpha, which goes to 0 with the share, so nothing grows without bound; a Gaussian
/// without area has none.
template <Scalar T>
RYE_HD void dilation_share_vjp(const Vec3<T>& x, const Vec3<T>& y, const T& dilation,
                               const T& g_log, Vec3<T>& g_x, Vec3<T>& g_y) {
    const Vec3<T> n = cross(x, y);
    const T plain = dot(n, n), dilated = gram_determinant(x, y, dilation);
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
