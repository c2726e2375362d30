// SPDX-License-Identifier: Apache-2.0
/// rye/gaussian/move_cloud.hpp: a cloud of Gaussians moved by a similarity: its means, axes, sizes
/// and the harmonics, whose colours turn with it.
/// Harmonics by quadrature: D_km is the integral of Y_k(R p) Y_m(p) over the sphere, exact with 5
/// Gauss-Legendre nodes in z times 10 angles up to degree 9, the product of two of degree 4.
/// Source: Varshalovich et al., "Quantum Theory of Angular Momentum", 1988, for D.
#pragma once

#include <array>
#include <cmath>

#include <rye/gaussian/cloud.hpp>
#include <rye/math/rotation.hpp>

namespace rye {

/// Similarity: p goes to scale R p + translation.
struct Similarity {
    double scale = 1; ///< above 0
    Mat3<double> rotation = Mat3<double>::Identity();
    Vec3<double> translation = Vec3<double>::Zero(); ///< [world units]
};

/// Returns the K x K matrix that turns the K coefficients above band 0, of degrees 1 to `degree`
/// (at most 4), by a rotation: sum_k (D c)_k Y_k(R p) is sum_m c_m Y_m(p).
inline Columns<double> harmonics_rotation(const Mat3<double>& rotation, int degree) {
    constexpr std::array<double, 5> nodes{0, 0.5384693101056831, -0.5384693101056831,
                                          0.9061798459386640, -0.9061798459386640};
    constexpr std::array<double, 5> weights{0.5688888888888889, 0.4786286704993665,
                                            0.4786286704993665, 0.2369268850561891,
                                            0.2369268850561891};
    constexpr double tenth_turn = 0.6283185307179586;
    const Index n = sh_count(degree) - 1;
    Columns<double> d = Columns<double>::Zero(n, n);
    for (std::size_t i = 0; i < nodes.size(); ++i)
        for (int j = 0; j < 10; ++j) {
            const double z = nodes[i], r = std::sqrt(1 - z * z), angle = tenth_turn * j;
            const Vec3<double> p(r * std::cos(angle), r * std::sin(angle), z);
            const VecX<double> y = sh_basis<double>(degree, p).tail(n);
            const VecX<double> turned =
                sh_basis<double>(degree, Vec3<double>(rotation * p)).tail(n);
            d += weights[i] * tenth_turn * turned * y.transpose();
        }
    // Bands do not mix: what is outside of their blocks is rounding.
    for (int a = 1; a <= degree; ++a)
        for (int b = 1; b <= degree; ++b)
            if (a != b) d.block(a * a - 1, b * b - 1, 2 * a + 1, 2 * b + 1).setZero();
    return d;
}

namespace detail {

/// Moves a cloud. Rotations are normalised.
template <Real T>
void move_cloud(GaussianCloud<T>& cloud, const Similarity& s) {
    const Mat3<T> linear = (s.scale * s.rotation).template cast<T>();
    const Vec3<T> translation = s.translation.cast<T>();
    const Quat<T> turn = matrix_quat<double>(s.rotation).template cast<T>();
    cloud.log_scale.array() += static_cast<T>(std::log(s.scale));
    for (Index i = 0; i < cloud.count(); ++i) {
        cloud.mean.col(i) = Vec3<T>(linear * cloud.mean.col(i) + translation);
        const Quat<T> own = quat_normalized<T>(cloud.rotation.col(i));
        cloud.rotation.col(i) = quat_normalized<T>(quat_product<T>(turn, own));
    }
    const Index more = cloud.sh_rest.rows() / 3;
    if (more == 0 || s.rotation.isIdentity(0)) return;
    const Columns<T> d = harmonics_rotation(s.rotation, cloud.degree()).template cast<T>();
    for (Index c = 0; c < 3; ++c) {
        const Columns<T> turned = d * cloud.sh_rest.middleRows(c * more, more);
        cloud.sh_rest.middleRows(c * more, more) = turned;
    }
}

} // namespace detail

} // namespace rye
