// SPDX-License-Identifier: Apache-2.0
/// rye/math/harmonics.hpp: real spherical harmonics up to degree 4, as homogeneous polynomials of a
/// direction: no poles, and at the zero direction only the constant band remains. Order and signs
/// those of 3D Gaussian Splatting (band l from m = -l to l, Condon-Shortley phase).
/// Source: Sloan, "Efficient Spherical Harmonic Evaluation", 2013.
#pragma once

#include <string>
#include <type_traits>

#include <rye/core/array.hpp>
#include <rye/core/error.hpp>
#include <rye/math/linalg.hpp>

namespace rye {

/// Returns the number of basis functions up to a degree.
RYE_HD constexpr int sh_count(int degree) { return (degree + 1) * (degree + 1); }

/// Returns the degree of a number of basis functions; throws Error if it is none of 1, 4, 9, 16,
/// 25.
inline int sh_degree(int count) {
    for (int d = 0; d <= 4; ++d)
        if (sh_count(d) == count) return d;
    throw Error("sh_degree: got " + std::to_string(count) +
                " coefficients, expected 1, 4, 9, 16 or 25");
}

namespace detail {

/// Returns the factor that makes basis function k orthonormal on the sphere, sign included. The
/// table is inside the function because device code cannot read a global one.
RYE_HD inline double sh_factor(std::size_t k) {
    static constexpr Array<double, 25> factors{
        0.28209479177387814,                                                    // l = 0
        -0.4886025119029199, 0.4886025119029199, -0.4886025119029199,           // l = 1
        1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792,
        0.5462742152960396,                                                     // l = 2
        -0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154,
        -0.4570457994644658, 1.445305721320277, -0.5900435899266435,            // l = 3
        2.5033429417967046, -1.7701307697799304, 0.9461746957575601, -0.6690465435572892,
        0.10578554691520431, -0.6690465435572892, 0.47308734787878004, -1.7701307697799304,
        0.6258357354491761};                                                    // l = 4
    return factors[k];
}

} // namespace detail

/// A number for each basis function of degrees 0 to Degree.
template <Scalar T, int Degree>
using ShArray = Array<T, static_cast<std::size_t>(sh_count(Degree))>;

/// Returns the basis at a unit direction.
template <Scalar T, int Degree>
RYE_HD ShArray<T, Degree> sh_basis(const Vec3<T>& direction) {
    static_assert(Degree >= 0 && Degree <= 4, "sh_basis: the degree must be 0 to 4");
    const T &x = direction[0], &y = direction[1], &z = direction[2];
    ShArray<T, Degree> b;
    b[0] = T(1);
    if constexpr (Degree >= 1) b[1] = y, b[2] = z, b[3] = x;
    if constexpr (Degree >= 2) {
        const T xx = x * x, yy = y * y, zz = z * z, s = xx + yy;
        b[4] = x * y, b[5] = y * z, b[6] = T(2) * zz - s, b[7] = x * z, b[8] = xx - yy;
        if constexpr (Degree >= 3) {
            b[9] = y * (T(3) * xx - yy), b[10] = x * y * z, b[11] = y * (T(4) * zz - s);
            b[12] = z * (T(2) * zz - T(3) * s), b[13] = x * (T(4) * zz - s);
            b[14] = z * (xx - yy), b[15] = x * (xx - T(3) * yy);
        }
        if constexpr (Degree >= 4) {
            b[16] = x * y * (xx - yy), b[17] = y * z * (T(3) * xx - yy);
            b[18] = x * y * (T(6) * zz - s), b[19] = y * z * (T(4) * zz - T(3) * s);
            b[20] = zz * (T(8) * zz - T(24) * s) + T(3) * s * s;
            b[21] = x * z * (T(4) * zz - T(3) * s), b[22] = (xx - yy) * (T(6) * zz - s);
            b[23] = x * z * (xx - T(3) * yy);
            b[24] = xx * (xx - T(3) * yy) - yy * (T(3) * xx - yy);
        }
    }
    for (std::size_t k = 0; k < b.size(); ++k) b[k] = constant<T>(detail::sh_factor(k)) * b[k];
    return b;
}

/// Returns the cotangent of the direction (chain with normalized_vjp).
template <Scalar T, int Degree>
RYE_HD Vec3<T> sh_basis_vjp(const Vec3<T>& direction, const ShArray<T, Degree>& g) {
    const T &x = direction[0], &y = direction[1], &z = direction[2];
    ShArray<T, Degree> w;
    for (std::size_t k = 0; k < w.size(); ++k) w[k] = constant<T>(detail::sh_factor(k)) * g[k];
    T dx = T(0), dy = T(0), dz = T(0);
    if constexpr (Degree >= 1) dx += w[3], dy += w[1], dz += w[2];
    if constexpr (Degree >= 2) {
        const T xx = x * x, yy = y * y, zz = z * z, s = xx + yy;
        dx += w[4] * y + w[7] * z + T(2) * x * (w[8] - w[6]);
        dy += w[4] * x + w[5] * z - T(2) * y * (w[8] + w[6]);
        dz += w[5] * y + w[7] * x + T(4) * z * w[6];
        if constexpr (Degree >= 3) {
            const T xy = x * y, xz = x * z, yz = y * z, d = T(3) * (xx - yy);
            dx += T(6) * xy * w[9] + yz * w[10] - T(2) * xy * w[11] - T(6) * xz * w[12] +
                  (T(4) * zz - T(3) * xx - yy) * w[13] + T(2) * xz * w[14] + d * w[15];
            dy += d * w[9] + xz * w[10] + (T(4) * zz - xx - T(3) * yy) * w[11] -
                  T(6) * yz * w[12] - T(2) * xy * w[13] - T(2) * yz * w[14] - T(6) * xy * w[15];
            dz += xy * w[10] + T(8) * yz * w[11] + (T(6) * zz - T(3) * s) * w[12] +
                  T(8) * xz * w[13] + (xx - yy) * w[14];
        }
        if constexpr (Degree >= 4) {
            const T xyz = x * y * z, d = T(3) * (xx - yy);
            const T p = T(3) * xx - yy, q = xx - T(3) * yy;              // y p and x q are cubics
            dx += y * p * w[16] + T(6) * xyz * w[17] + y * (T(6) * zz - T(3) * xx - yy) * w[18] -
                  T(6) * xyz * w[19] + T(12) * x * (s - T(4) * zz) * w[20] +
                  z * (T(4) * zz - T(9) * xx - T(3) * yy) * w[21] +
                  T(4) * x * (T(3) * zz - xx) * w[22] + z * d * w[23] + T(4) * x * q * w[24];
            dy += x * q * w[16] + z * d * w[17] + x * (T(6) * zz - xx - T(3) * yy) * w[18] +
                  z * (T(4) * zz - T(3) * xx - T(9) * yy) * w[19] +
                  T(12) * y * (s - T(4) * zz) * w[20] - T(6) * xyz * w[21] +
                  T(4) * y * (yy - T(3) * zz) * w[22] - T(6) * xyz * w[23] - T(4) * y * p * w[24];
            dz += y * p * w[17] + T(12) * xyz * w[18] + y * (T(12) * zz - T(3) * s) * w[19] +
                  T(16) * z * (T(2) * zz - T(3) * s) * w[20] + x * (T(12) * zz - T(3) * s) * w[21] +
                  T(12) * z * (xx - yy) * w[22] + x * q * w[23];
        }
    }
    return Vec3<T>(dx, dy, dz);
}

namespace detail {

/// Calls f(std::integral_constant<int, degree>) for a degree known at run time.
template <class F>
auto with_sh_degree(int degree, F&& f) {
    switch (degree) {
        case 0: return f(std::integral_constant<int, 0>{});
        case 1: return f(std::integral_constant<int, 1>{});
        case 2: return f(std::integral_constant<int, 2>{});
        case 3: return f(std::integral_constant<int, 3>{});
        case 4: return f(std::integral_constant<int, 4>{});
        default: break;
    }
    throw Error("sh_basis: got degree " + std::to_string(degree) + ", expected 0 to 4");
}

/// Calls f(std::integral_constant<int, min(degree, most)>); generates no code for higher degrees.
template <int most, class F>
auto with_sh_degree_up_to(int degree, F&& f) {
    static_assert(most >= 0 && most <= 4, "sh_basis: the degree must be 0 to 4");
    if constexpr (most == 4) {
        return with_sh_degree(degree, f);
    } else {
        if constexpr (most > 0)
            if (degree < most) return with_sh_degree_up_to<most - 1>(degree, f);
        return f(std::integral_constant<int, most>{});
    }
}

} // namespace detail

/// Returns the basis, for a degree known at run time.
template <Scalar T>
VecX<T> sh_basis(int degree, const Vec3<T>& direction) {
    return detail::with_sh_degree(degree, [&](auto d) {
        const ShArray<T, d()> b = sh_basis<T, d()>(direction);
        VecX<T> r(static_cast<Index>(b.size()));
        for (std::size_t k = 0; k < b.size(); ++k) r[static_cast<Index>(k)] = b[k];
        return r;
    });
}

/// Returns the cotangent of the direction, for a degree known at run time; g has sh_count(degree)
/// entries.
template <Scalar T>
Vec3<T> sh_basis_vjp(int degree, const Vec3<T>& direction, const VecX<T>& g) {
    return detail::with_sh_degree(degree, [&](auto d) {
        ShArray<T, d()> a;
        for (std::size_t k = 0; k < a.size(); ++k) a[k] = g[static_cast<Index>(k)];
        return sh_basis_vjp<T, d()>(direction, a);
    });
}

} // namespace rye
