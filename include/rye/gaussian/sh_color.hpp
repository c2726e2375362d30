// SPDX-License-Identifier: Apache-2.0
/// rye/gaussian/sh_color.hpp: view-dependent colour max(0, 1/2 + sum_k b_k(d) c_k), with d the unit
/// direction from the eye to the Gaussian and b the real spherical harmonics.
/// A Gaussian at the eye has no direction: only its constant band counts, and d gets no gradient.
/// The template argument `most` bounds the degree: bands above it cost neither work nor code, and
/// their gradient is 0. Bands whose coefficients are 0 change no bit.
#pragma once

#include <rye/gaussian/cloud.hpp>

namespace rye {

/// One colour and the intermediate values of its derivative.
template <Scalar T, int Degree>
struct ShColor {
    static constexpr int more = sh_count(Degree) - 1;
    Vec3<T> offset;            ///< mean - eye [world units]
    ShArray<T, Degree> basis;
    Vec3<T> raw;               ///< before max(0, .)

    /// The rest coefficients of successive channels are `stored` apart.
    RYE_HD ShColor(const Vec3<T>& mean, const Vec3<T>& eye, const T* constant_band, const T* rest,
            Index stored = more)
        : offset(mean - eye), basis(sh_basis<T, Degree>(normalized(offset))) {
        for (int c = 0; c < 3; ++c) {
            raw[c] = T(real_t<T>(0.5)) + basis[0] * constant_band[c];
            for (int k = 0; k < more; ++k)
                raw[c] += basis[static_cast<std::size_t>(k) + 1] * rest[c * stored + k];
        }
    }
    RYE_HD Vec3<T> rgb() const {
        const T zero = T(0);
        return Vec3<T>(select(raw[0] > zero, raw[0], zero), select(raw[1] > zero, raw[1], zero),
                       select(raw[2] > zero, raw[2], zero));
    }
    /// Returns the cotangent of the mean and writes those of the coefficients, `g_rest` maybe over
    /// `rest`.
    RYE_HD Vec3<T> vjp(const Vec3<T>& g, const T* rest, T* g_constant_band, T* g_rest,
                Index stored = more) const {
        ShArray<T, Degree> g_basis;
        for (T& b : g_basis) b = T(0);
        for (int c = 0; c < 3; ++c) {
            const T gc = select(raw[c] > T(0), g[c], T(0));
            g_constant_band[c] = basis[0] * gc;
            for (int k = 0; k < more; ++k) {
                const auto b = static_cast<std::size_t>(k) + 1;
                g_basis[b] += rest[c * stored + k] * gc;
                g_rest[c * stored + k] = basis[b] * gc;
            }
        }
        return normalized_vjp(offset, sh_basis_vjp<T, Degree>(normalized(offset), g_basis));
    }
};

/// Returns 3 x N colours of a cloud seen from `eye`.
template <int most = 4, class T>
Columns<T> sh_colors(const GaussianCloud<T>& cloud, const Vec3<T>& eye) {
    using Map3 = Eigen::Map<const Vec3<T>>;
    Columns<T> rgb(3, cloud.count());
    const Index rest = cloud.sh_rest.rows();
    detail::with_sh_degree_up_to<most>(cloud.degree(), [&](auto degree) {
        for (Index i = 0; i < cloud.count(); ++i) {
            const ShColor<T, degree()> color(Map3(cloud.mean.data() + 3 * i), eye,
                                             cloud.sh_constant.data() + 3 * i,
                                             cloud.sh_rest.data() + i * rest, rest / 3);
            Eigen::Map<Vec3<T>>(rgb.data() + 3 * i) = color.rgb();
        }
    });
    return rgb;
}

/// Writes the gradients of sh_constant and sh_rest, and adds that of the mean.
template <int most = 4, class T>
void sh_colors_vjp(const GaussianCloud<T>& cloud, const Vec3<T>& eye, const Columns<T>& g_rgb,
                   GaussianCloud<T>& g) {
    using Map3 = Eigen::Map<const Vec3<T>>;
    const Index rest = cloud.sh_rest.rows();
    if (most < cloud.degree()) g.sh_rest.setZero();
    detail::with_sh_degree_up_to<most>(cloud.degree(), [&](auto degree) {
        for (Index i = 0; i < cloud.count(); ++i) {
            const T* coefficients = cloud.sh_rest.data() + i * rest;
            const ShColor<T, degree()> color(Map3(cloud.mean.data() + 3 * i), eye,
                                             cloud.sh_constant.data() + 3 * i, coefficients,
                                             rest / 3);
            Eigen::Map<Vec3<T>>(g.mean.data() + 3 * i) +=
                color.vjp(Map3(g_rgb.data() + 3 * i), coefficients, g.sh_constant.data() + 3 * i,
                          g.sh_rest.data() + i * rest, rest / 3);
        }
    });
}

} // namespace rye
