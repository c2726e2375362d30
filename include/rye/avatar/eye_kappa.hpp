// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_kappa.hpp: the gradient of an avatar's kappa: of the eyeball's turn, and of the
/// skin's network that reads the same optical axis. Head frame; angles (pitch, yaw) [rad].
/// Source: rig/gaze.hpp for the angles; the Jacobian of two angles comes from duals.
#pragma once

#include <rye/autodiff/dual.hpp>
#include <rye/avatar/drivers.hpp>
#include <rye/avatar/head_pose.hpp>
#include <rye/math/rotation.hpp>

namespace rye {

namespace detail {

/// The angles of an eye (0: the subject's left) of the 2 x 2 parameter [rad].
template <class T>
KappaAngles<T> kappa_of(const Columns<T>& kappa, std::size_t eye) {
    const Index e = static_cast<Index>(eye);
    return {kappa(0, e), kappa(1, e)};
}

/// The tracked gaze of an eye (0: the subject's left) with its frame's correction, a column of
/// TwoStream::delta_gaze: (pitch, yaw) of the left eye, then of the right [rad].
template <class T>
RYE_HD Vec3<T> corrected_gaze(const Vec3<T>& tracked, const T* correction, std::size_t eye) {
    return apply_kappa<T>(tracked, KappaAngles<T>{correction[2 * eye], correction[2 * eye + 1]});
}

/// Cotangents of an eye's turn, as a matrix and as a quaternion.
template <class T>
struct TurnCotangent {
    Mat3<T> rotation = Mat3<T>::Zero();
    Quat<T> quaternion = Quat<T>::Zero();

    /// Adds those of one point and its rotation.
    RYE_HD void add(const MovedPoint<T>& at_rest, const MovedPoint<T>& g) {
        rotation += g.mean * at_rest.mean.transpose();
        quaternion += quat_product_vjp_left<T>(at_rest.rotation, g.rotation);
    }
};

} // namespace detail

/// Numbers that a TurnCotangent is summed as: matrix, quaternion.
inline constexpr int turn_sums = 13;

namespace detail {

/// Adds it to sums, from the first on.
template <class T, class Sums>
RYE_HD void add_turn_sums(const TurnCotangent<T>& g, Sums& sum, int from) {
    const auto at = [from](int k) { return static_cast<std::size_t>(from + k); };
    for (int k = 0; k < 9; ++k) sum[at(k)] += g.rotation.data()[k];
    for (int k = 0; k < 4; ++k) sum[at(9 + k)] += g.quaternion[k];
}
/// Adds such sums to it.
template <class T>
RYE_HD void take_turn_sums(const T* sum, TurnCotangent<T>& g) {
    for (int k = 0; k < 9; ++k) g.rotation.data()[k] += sum[k];
    for (int k = 0; k < 4; ++k) g.quaternion[k] += sum[9 + k];
}

/// Cotangents that an eye's kappa acts on: those of the smallest rotation to the optical axis, of
/// the axis itself, and of the gaze's code, or null.
template <class T>
struct OpticalCotangent {
    TurnCotangent<T> turn;
    Vec3<T> axis;
    const VecX<T>* code;
};

} // namespace detail

/// The optical axis and the turn to it, with their derivatives by (pitch, yaw) of kappa.
template <class T>
struct KappaTangent {
    using D = Dual<T, 2>;
    Vec3<D> optical;
    Quat<D> turn;
    Mat3<D> matrix;

    RYE_HD KappaTangent(const Vec3<T>& visual, const KappaAngles<T>& kappa)
        : optical(apply_kappa<D>(
              Vec3<D>(D(visual[0]), D(visual[1]), D(visual[2])),
              KappaAngles<D>{D::variable(kappa.pitch, 0), D::variable(kappa.yaw, 1)})),
          turn(shortest_arc<D>(Vec3<D>(D(0), D(0), D(1)), normalized(optical))),
          matrix(quat_matrix(turn)) {}

    /// The turn's part of the cotangent of an angle, 0 or 1.
    RYE_HD T of_turn(const detail::TurnCotangent<T>& g, std::size_t angle) const {
        T s = T(0);
        for (Index i = 0; i < 9; ++i)
            s += g.rotation(i / 3, i % 3) * matrix(i / 3, i % 3).d[angle];
        for (Index i = 0; i < 4; ++i) s += g.quaternion(i) * turn(i).d[angle];
        return s;
    }
};

/// The cotangent of (pitch, yaw) of kappa.
template <Encoding C = PositionalEncoding, class T>
Vec2<T> kappa_vjp(const AvatarConfig& config, const Vec3<T>& visual, const KappaAngles<T>& kappa,
                  const std::type_identity_t<detail::OpticalCotangent<T>>& g) {
    const KappaTangent<T> tangent(visual, kappa);
    const Columns<Dual<T, 2>> code =
        C::encode(pitch_yaw(tangent.optical), config.gaze_frequencies);
    Vec2<T> sum;
    for (std::size_t a = 0; a < 2; ++a) {
        T s = tangent.of_turn(g.turn, a);
        if (g.code != nullptr)
            for (Index i = 0; i < g.code->size(); ++i) s += (*g.code)(i) * code(i, 0).d[a];
        for (int i = 0; i < 3; ++i) s += g.axis[i] * tangent.optical[i].d[a];
        sum[static_cast<Index>(a)] = s;
    }
    return sum;
}

} // namespace rye
