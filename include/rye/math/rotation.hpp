// SPDX-License-Identifier: Apache-2.0
/// rye/math/rotation.hpp: rotations as quaternions (w, x, y, z), matrices and axis-angle vectors.
/// Angles [rad]. Each formula is branch-free, so it runs on floats, duals and batches alike.
/// Source: Shepperd, "Quaternion from rotation matrix", 1978; Rodrigues' formula.
#pragma once

#include <rye/math/linalg.hpp>

namespace rye {

/// (w, x, y, z); functions that require a unit quaternion say "unit".
template <Scalar T>
using Quat = Vec4<T>;

/// Returns the identity, (1, 0, 0, 0).
template <Scalar T>
RYE_HD Quat<T> quat_identity() {
    return Quat<T>(T(1), T(0), T(0), T(0));
}

/// Returns the inverse rotation of a unit quaternion.
template <Scalar T>
RYE_HD Quat<T> quat_conjugate(const Quat<T>& q) {
    return Quat<T>(q[0], -q[1], -q[2], -q[3]);
}

/// Returns q / |q| for every magnitude; the identity for the zero quaternion.
template <Scalar T>
RYE_HD Quat<T> quat_normalized(const Quat<T>& q) {
    Quat<T> u = normalized(q);
    u[0] = select(dot(u, u) == T(0), T(1), u[0]);
    return u;
}

/// Returns the cotangent of q for quat_normalized: orthogonal to q; 0 for the zero quaternion.
template <Scalar T>
RYE_HD Quat<T> quat_normalized_vjp(const Quat<T>& q, const Quat<T>& g) {
    return normalized_vjp(q, g);
}

/// Returns the Hamilton product: rotation b, then rotation a.
template <Scalar T>
RYE_HD Quat<T> quat_product(const Quat<T>& a, const Quat<T>& b) {
    return Quat<T>(a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
                   a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
                   a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
                   a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]);
}

/// Returns the cotangent of a for a b, for any norms: g b*.
template <Scalar T>
RYE_HD Quat<T> quat_product_vjp_left(const Quat<T>& b, const Quat<T>& g) {
    return quat_product(g, quat_conjugate(b));
}

/// Returns the cotangent of b for a b: a* g.
template <Scalar T>
RYE_HD Quat<T> quat_product_vjp_right(const Quat<T>& a, const Quat<T>& g) {
    return quat_product(quat_conjugate(a), g);
}

/// Returns the matrix of a unit quaternion.
template <Scalar T>
RYE_HD Mat3<T> quat_matrix(const Quat<T>& q) {
    const T &w = q[0], &x = q[1], &y = q[2], &z = q[3];
    const T two = T(2);
    Mat3<T> r;
    r(0, 0) = T(1) - two * (y * y + z * z);
    r(0, 1) = two * (x * y - w * z);
    r(0, 2) = two * (x * z + w * y);
    r(1, 0) = two * (x * y + w * z);
    r(1, 1) = T(1) - two * (x * x + z * z);
    r(1, 2) = two * (y * z - w * x);
    r(2, 0) = two * (x * z - w * y);
    r(2, 1) = two * (y * z + w * x);
    r(2, 2) = T(1) - two * (x * x + y * y);
    return r;
}

/// Returns the cotangent of q for the polynomial of quat_matrix (chain with quat_normalized_vjp).
template <Scalar T>
RYE_HD Quat<T> quat_matrix_vjp(const Quat<T>& q, const Mat3<T>& g) {
    const T &w = q[0], &x = q[1], &y = q[2], &z = q[3];
    const T two = T(2);
    const T ax = g(2, 1) - g(1, 2), ay = g(0, 2) - g(2, 0), az = g(1, 0) - g(0, 1);
    const T sxy = g(0, 1) + g(1, 0), sxz = g(0, 2) + g(2, 0), syz = g(1, 2) + g(2, 1);
    return Quat<T>(two * (x * ax + y * ay + z * az),
                   two * (w * ax + y * sxy + z * sxz - two * x * (g(1, 1) + g(2, 2))),
                   two * (w * ay + x * sxy + z * syz - two * y * (g(0, 0) + g(2, 2))),
                   two * (w * az + x * sxz + y * syz - two * z * (g(0, 0) + g(1, 1))));
}

/// Returns v rotated by a unit quaternion: the same polynomial as quat_matrix(q) v.
template <Scalar T>
RYE_HD Vec3<T> quat_rotate(const Quat<T>& q, const Vec3<T>& v) {
    const Vec3<T> u(q[1], q[2], q[3]);
    Vec3<T> t = cross(u, v);
    for (int i = 0; i < 3; ++i) t[i] = t[i] + t[i];
    const Vec3<T> ut = cross(u, t);
    return Vec3<T>(v[0] + q[0] * t[0] + ut[0], v[1] + q[0] * t[1] + ut[1],
                   v[2] + q[0] * t[2] + ut[2]);
}

/// Returns the unit quaternion, w >= 0, of a rotation matrix (Shepperd: divide by the largest
/// entry).
template <Scalar T>
RYE_HD Quat<T> matrix_quat(const Mat3<T>& r) {
    const T ax = r(2, 1) - r(1, 2), ay = r(0, 2) - r(2, 0), az = r(1, 0) - r(0, 1);
    const T sxy = r(0, 1) + r(1, 0), sxz = r(0, 2) + r(2, 0), syz = r(1, 2) + r(2, 1);
    const T x = r(0, 0), y = r(1, 1), z = r(2, 2);
    T pivot = T(1) + x + y + z;                                           // 4 w^2
    Quat<T> q(pivot, ax, ay, az);                                         // 4 w (w, x, y, z)
    const auto take = [&](const T& square, const Quat<T>& other) {
        const auto larger = square > pivot;
        q = select_all(larger, other, q);
        pivot = select(larger, square, pivot);
    };
    const T xx = T(1) + x - y - z, yy = T(1) - x + y - z, zz = T(1) - x - y + z;
    take(xx, Quat<T>(ax, xx, sxy, sxz));
    take(yy, Quat<T>(ay, sxy, yy, syz));
    take(zz, Quat<T>(az, sxz, syz, zz));
    q = normalized(q);
    return select_all(q[0] < T(0), Quat<T>(-q), q);
}

/// Returns the smallest rotation (no torsion) that takes unit vector a to unit vector b, within
/// 6e-7 rad in float at every angle. At the antipode, where any axis would do, the axis is
/// orthogonal to a.
template <Scalar T>
RYE_HD Quat<T> shortest_arc(const Vec3<T>& a, const Vec3<T>& b) {
    using std::abs, std::sqrt;
    const T zero = T(0), one = T(1), half = T(0.5);
    const Vec3<T> h = a + b, v = b - a;
    const T hh = dot(h, h), vv = dot(v, v);
    const auto near = hh >= vv;                                           // less than 90 degrees
    const T length = sqrt(select(hh == zero, one, hh));
    const Vec3<T> axb = cross(a, b);

    // Beyond 90 degrees the axis comes from h x v = 2 a x b, whose factors stay accurate.
    const Vec3<T> ax(abs(a[0]), abs(a[1]), abs(a[2]));
    const auto first = (ax[0] <= ax[1]) && (ax[0] <= ax[2]);
    const auto second = ax[1] <= ax[2];
    const Vec3<T> any(select(first, one, zero), select(first, zero, select(second, one, zero)),
                      select(first, zero, select(second, zero, one)));
    Vec3<T> n = cross(h, v);
    n = normalized(select_all(dot(n, n) == zero, cross(a, any), n));
    const T sine = half * sqrt(select(near, one, vv));

    Quat<T> q;
    q[0] = select(hh == zero, zero, half * length);
    for (int i = 0; i < 3; ++i) q[i + 1] = select(near, axb[i] / length, sine * n[i]);
    return normalized(q);
}

namespace detail {

/// Returns sin(sqrt(s)) / sqrt(s): smooth in s >= 0, with its derivatives, at 0 too.
template <Scalar T>
RYE_HD T sinc_of_square(const T& s) {
    using std::sin, std::sqrt;
    T tail = T(1);                                                        // nested Taylor, s < 1
    for (int k = 9; k >= 1; --k) tail = T(1) - s * constant<T>(1.0 / (2 * k * (2 * k + 1))) * tail;
    const auto small = s < T(1);
    const T angle = sqrt(select(small, T(1), s));
    return select(small, tail, sin(angle) / angle);
}

/// Returns d sinc_of_square / ds = (cos(t) - sin(t) / t) / (2 s), t = sqrt(s); its Taylor tail for
/// s < 1.
template <Scalar T>
RYE_HD T sinc_of_square_slope(const T& s) {
    using std::cos, std::sin, std::sqrt;
    T tail = T(1);
    for (int k = 9; k >= 1; --k) tail = T(1) - s * constant<T>(1.0 / (2 * k * (2 * k + 3))) * tail;
    const auto small = s < T(1);
    const T safe = select(small, T(1), s);
    const T angle = sqrt(safe);
    const T direct = (cos(angle) - sin(angle) / angle) / (safe + safe);
    return select(small, constant<T>(-1.0 / 6.0) * tail, direct);
}

} // namespace detail

/// Returns the spherical interpolation from a (t = 0) to b (t = 1) along the shorter arc; unit
/// quaternions. The ratio of sines is a ratio of sincs, so neither equal nor opposite ends are
/// special cases.
template <Scalar T>
RYE_HD Quat<T> quat_slerp(const Quat<T>& a, const Quat<T>& b, const T& t) {
    using std::atan2;
    const Quat<T> end = select_all(dot(a, b) < T(0), Quat<T>(-b), b);
    const T angle = T(2) * atan2(norm(Quat<T>(end - a)), norm(Quat<T>(end + a)));  // to pi / 2
    const T s = angle * angle, r = T(1) - t, whole = detail::sinc_of_square(s);
    const T wa = r * detail::sinc_of_square(T(r * r * s)) / whole;
    const T wb = t * detail::sinc_of_square(T(t * t * s)) / whole;
    Quat<T> q;
    for (int i = 0; i < 4; ++i) q[i] = wa * a[i] + wb * end[i];
    return normalized(q);
}

/// Returns exp([w]x) = I + A [w]x + B (w w^T - |w|^2 I), A = sinc(|w|), B = (1 - cos|w|) / |w|^2,
/// which is sinc(|w|/2)^2 / 2, free of cancellation.
template <Scalar T>
RYE_HD Mat3<T> so3_exp(const Vec3<T>& w) {
    const T s = dot(w, w), h = detail::sinc_of_square(T(0.25) * s);
    const T a = detail::sinc_of_square(s), b = T(0.5) * h * h;
    Mat3<T> r;
    for (int j = 0; j < 3; ++j)
        for (int i = 0; i < 3; ++i) r(i, j) = b * w[i] * w[j];
    r(0, 0) = T(1) - b * (w[1] * w[1] + w[2] * w[2]);
    r(1, 1) = T(1) - b * (w[0] * w[0] + w[2] * w[2]);
    r(2, 2) = T(1) - b * (w[0] * w[0] + w[1] * w[1]);
    r(2, 1) += a * w[0], r(1, 2) -= a * w[0];
    r(0, 2) += a * w[1], r(2, 0) -= a * w[1];
    r(1, 0) += a * w[2], r(0, 1) -= a * w[2];
    return r;
}

/// Returns the cotangent of w for so3_exp.
template <Scalar T>
RYE_HD Vec3<T> so3_exp_vjp(const Vec3<T>& w, const Mat3<T>& g) {
    const T s = dot(w, w), quarter = T(0.25) * s, h = detail::sinc_of_square(quarter);
    const T a = detail::sinc_of_square(s), b = T(0.5) * h * h;
    const T a_s = detail::sinc_of_square_slope(s),
            b_s = T(0.25) * h * detail::sinc_of_square_slope(quarter);
    const Vec3<T> k(g(2, 1) - g(1, 2), g(0, 2) - g(2, 0), g(1, 0) - g(0, 1));
    const T trace = g(0, 0) + g(1, 1) + g(2, 2);
    Vec3<T> sw;                                                           // (g + g^T) w - 2 tr(g) w
    for (int i = 0; i < 3; ++i) {
        sw[i] = T(-2) * trace * w[i];
        for (int j = 0; j < 3; ++j) sw[i] += (g(i, j) + g(j, i)) * w[j];
    }
    const T g_s = dot(k, w) * a_s + T(0.5) * dot(sw, w) * b_s;
    Vec3<T> r;
    for (int i = 0; i < 3; ++i) r[i] = a * k[i] + b * sw[i] + T(2) * g_s * w[i];
    return r;
}

/// Returns the unit quaternion of exp([w]x): (cos(|w|/2), w sin(|w|/2) / |w|).
template <Scalar T>
RYE_HD Quat<T> so3_exp_quat(const Vec3<T>& w) {
    const T s = dot(w, w), sixteenth = T(0.0625) * s, h = detail::sinc_of_square(sixteenth);
    const T k = T(0.5) * detail::sinc_of_square(T(0.25) * s);
    return Quat<T>(T(1) - T(2) * sixteenth * h * h, k * w[0], k * w[1], k * w[2]);
}

/// Returns the axis-angle vector, |w| <= pi, of a unit quaternion of either sign: 2 atan2(|v|, w) v
/// / |v|.
template <Scalar T>
RYE_HD Vec3<T> quat_log(const Quat<T>& unit) {
    using std::atan2, std::sqrt;
    const Quat<T> q = select_all(unit[0] < T(0), Quat<T>(-unit), unit);
    const T vv = q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    const auto small = vv < T(1.0 / 64.0);
    const T w = select(small, q[0], T(1));
    const T t = select(small, vv, T(0)) / (w * w);                        // tan(|w|/2)^2 < 1/63
    T tail = T(0);                                                        // atan(r) / r, t = r^2
    for (int k = 9; k >= 0; --k) tail = constant<T>(1.0 / (2 * k + 1)) - t * tail;
    const T v = sqrt(select(small, T(1), vv));
    const T f = T(2) * select(small, tail / w, atan2(v, q[0]) / v);
    return Vec3<T>(f * q[1], f * q[2], f * q[3]);
}

/// Returns the axis-angle vector, |w| <= pi, of a rotation matrix; accurate at 0 and at pi.
template <Scalar T>
RYE_HD Vec3<T> so3_log(const Mat3<T>& r) {
    return quat_log(matrix_quat(r));
}

} // namespace rye
