// SPDX-License-Identifier: Apache-2.0
/// rye/math/linalg.hpp: small vectors and symmetric matrices over every scalar, and two forms that
/// keep needle-shaped Gaussians accurate in float: the determinant of a Gram matrix by
/// Cauchy-Binet, and a factor of the precision matrix in place of the conic.
/// Source: Golub and Van Loan, "Matrix Computations", 4.1 (LDL^T); Cauchy-Binet for 2 x 3
/// factors.
#pragma once

#include <cmath>

#include <rye/core/columns.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

/// Returns a . b, summed from the first entry on, for batches too.
template <Scalar T, int N>
RYE_HD T dot(const Vec<T, N>& a, const Vec<T, N>& b) {
    T s = a[0] * b[0];
    for (int i = 1; i < N; ++i) s += a[i] * b[i];
    return s;
}

/// Returns the cross product a x b.
template <Scalar T>
RYE_HD Vec3<T> cross(const Vec3<T>& a, const Vec3<T>& b) {
    return Vec3<T>(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]);
}

/// Returns select(condition, a, b), entry by entry.
template <class Condition, Scalar T, int R, int C>
RYE_HD Mat<T, R, C> select_all(const Condition& c, const Mat<T, R, C>& a, const Mat<T, R, C>& b) {
    Mat<T, R, C> r;
    for (int i = 0; i < R * C; ++i) r.data()[i] = select(c, a.data()[i], b.data()[i]);
    return r;
}

/// Returns x / |x| without underflow or overflow of |x|^2; the zero vector stays zero, with
/// derivative 0.
template <Scalar T, int N>
RYE_HD Vec<T, N> normalized(const Vec<T, N>& x) {
    using std::abs, std::sqrt;
    T m = abs(x[0]);
    for (int i = 1; i < N; ++i) m = max(m, T(abs(x[i])));
    const auto zero = m == T(0);
    const T s = select(zero, T(1), m);
    Vec<T, N> u;
    for (int i = 0; i < N; ++i) u[i] = x[i] / s;
    const T n = sqrt(select(zero, T(1), dot(u, u)));                      // in [1, sqrt(N)]
    for (int i = 0; i < N; ++i) u[i] = select(zero, T(0), T(u[i] / n));
    return u;
}

/// Returns |x| without underflow or overflow of |x|^2; derivative 0 at x = 0.
template <Scalar T, int N>
RYE_HD T norm(const Vec<T, N>& x) {
    using std::abs, std::sqrt;
    T m = abs(x[0]);
    for (int i = 1; i < N; ++i) m = max(m, T(abs(x[i])));
    const auto zero = m == T(0);
    const T s = select(zero, T(1), m);
    Vec<T, N> u;
    for (int i = 0; i < N; ++i) u[i] = x[i] / s;
    return select(zero, T(0), T(s * sqrt(select(zero, T(1), dot(u, u)))));
}

/// Returns the cotangent of x for y = x / |x|: (g - y (y . g)) / |x|, and 0 at x = 0.
template <Scalar T, int N>
RYE_HD Vec<T, N> normalized_vjp(const Vec<T, N>& x, const Vec<T, N>& g) {
    const Vec<T, N> y = normalized(x);
    const T n = norm(x);
    const auto zero = n == T(0);
    const T safe = select(zero, T(1), n);
    const T along = dot(y, g);
    Vec<T, N> r;
    for (int i = 0; i < N; ++i) r[i] = select(zero, T(0), T((g[i] - y[i] * along) / safe));
    return r;
}

/// A symmetric 2 x 2 matrix. Each entry is stored once: the cotangent of xy is that of the stored
/// number, so it holds both off-diagonal parts and needs no factor 1/2.
template <Scalar T>
struct Sym2 {
    T xx, xy, yy;

    RYE_HD T determinant() const { return xx * yy - xy * xy; }
    RYE_HD T quadratic(const Vec2<T>& d) const {
        return xx * d[0] * d[0] + T(2) * xy * d[0] * d[1] + yy * d[1] * d[1];
    }
};

/// Returns <cotangent, tangent> over the stored numbers of Sym2.
template <Scalar T>
RYE_HD T pairing(const Sym2<T>& g, const Sym2<T>& d) {
    return g.xx * d.xx + g.xy * d.xy + g.yy * d.yy;
}

/// A symmetric 3 x 3 matrix, for export: a Gaussian's covariance is kept as its factor M = R S,
/// since M M^T loses its smallest axis (it is indefinite for half of all needles of 1 : 1e-4).
template <Scalar T>
struct Sym3 {
    T xx, xy, xz, yy, yz, zz;
};

namespace detail {

/// Returns M M^T for a factor with three rows.
template <Scalar T>
RYE_HD Sym3<T> gram(const Mat3<T>& m) {
    const Vec3<T> x = m.row(0), y = m.row(1), z = m.row(2);
    return {dot(x, x), dot(x, y), dot(x, z), dot(y, y), dot(y, z), dot(z, z)};
}

/// Returns M M^T + d I for the two rows of a 2 x 3 factor; d >= 0 is the dilation.
template <Scalar T>
RYE_HD Sym2<T> gram(const Vec3<T>& x, const Vec3<T>& y, const T& d) {
    return {dot(x, x) + d, dot(x, y), dot(y, y) + d};
}

/// Returns det(M M^T + d I) = |x cross y|^2 + d (|x|^2 + |y|^2) + d^2, every term >= 0. The direct
/// form xx yy - xy^2 is 20 % wrong for a needle of 1000 px.
template <Scalar T>
RYE_HD T gram_determinant(const Vec3<T>& x, const Vec3<T>& y, const T& d) {
    const Vec3<T> n = cross(x, y);
    return dot(n, n) + d * (dot(x, x) + dot(y, y)) + d * d;
}

/// A factor of the precision P = (M M^T + d I)^-1: with u = k1 dx and v = k2 (dy - m dx), the form
/// d^T P d is u^2 + v^2, never negative for any needle. Three numbers, as in a conic.
template <Scalar T>
struct PrecisionFactor {
    T k1, k2, m;

    RYE_HD T quadratic(const T& dx, const T& dy) const {
        const T u = k1 * dx, v = k2 * (dy - m * dx);
        return u * u + v * v;
    }
};

/// Returns the factor of the precision from the rows of M and the dilation. Requires a positive
/// determinant. The choice of the pivot, x or y, does not matter: the rounding error of v is
/// u |x| |y| / sqrt(det) either way.
template <Scalar T>
RYE_HD PrecisionFactor<T> precision_factor(const Vec3<T>& x, const Vec3<T>& y, const T& d) {
    using std::sqrt;
    const T a = dot(x, x) + d;
    const T det = gram_determinant(x, y, d);
    return {T(1) / sqrt(a), sqrt(a / det), dot(x, y) / a};
}

} // namespace detail

} // namespace rye
