// SPDX-License-Identifier: Apache-2.0
/// rye/rig/gaze.hpp: gaze directions. Frame: the head's, x to the subject's left, y up, z out of
/// the face. Angles [rad]: yaw = atan2(x, z), + toward the subject's left; pitch, + up.
/// Source: the angle convention of ETH-XGaze (Zhang et al., 2020), in the head's frame.
#pragma once

#include <cmath>
#include <string>

#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/math/linalg.hpp>
#include <rye/nn/encoding.hpp>

namespace rye {

/// Largest angle of an anatomical gaze from straight ahead [rad] (70 degrees).
inline constexpr double gaze_range = 1.2217304763960307;

/// Axis of an eye that gazes refer to: the eyeball's optical axis, or the line of sight, which
/// differs by a constant per person.
enum class GazeAxis { optical, visual };

/// Returns the unit vector (cos p sin y, sin p, cos p cos y).
template <Scalar T>
RYE_HD Vec3<T> gaze_vector(const T& pitch, const T& yaw) {
    using std::cos, std::sin;
    const T c = cos(pitch);
    return Vec3<T>(c * sin(yaw), sin(pitch), c * cos(yaw));
}

/// Returns (pitch, yaw) of a direction of any length; at a pole the yaw is 0. Uses atan2: in float,
/// asin(y) does not resolve angles below 3e-4 rad from the pole.
template <Scalar T>
RYE_HD Vec2<T> pitch_yaw(const Vec3<T>& v) {
    using std::atan2, std::hypot;
    return Vec2<T>(atan2(v[1], hypot(v[0], v[2])), atan2(v[0], v[2]));
}

/// Returns the angle between two directions of any length [rad]: 2 atan2(|a - b|, |a + b|), which
/// resolves small angles that acos rounds to 0.
template <Scalar T>
RYE_HD T angular_error(const Vec3<T>& a, const Vec3<T>& b) {
    using std::atan2;
    const Vec3<T> u = normalized(a), v = normalized(b);
    return T(2) * atan2(norm(Vec3<T>(u - v)), norm(Vec3<T>(u + v)));
}

/// Returns |a - b|^2 of two unit directions: a training loss, smooth where the angle is not.
template <Scalar T>
RYE_HD T chord_error(const Vec3<T>& a, const Vec3<T>& b) {
    const Vec3<T> d = a - b;
    return dot(d, d);
}

namespace detail {

/// Normalises a direction from external input; throws an Error if it is not finite or shorter than
/// 1e-6, since its direction would be noise.
template <Scalar T>
Vec3<T> checked_gaze(const Vec3<T>& v) {
    using std::isfinite;
    const auto text = [](const T& x) { return number_text(static_cast<double>(value_of(x))); };
    const bool finite = isfinite(v[0]) && isfinite(v[1]) && isfinite(v[2]);
    require(
        finite && norm(v) >= constant<T>(1e-6), "gaze", "got (", [&] { return text(v[0]); }, ", ",
        [&] { return text(v[1]); }, ", ", [&] { return text(v[2]); },
        "), expected a finite direction, longer than 1e-6");
    return normalized(v);
}

} // namespace detail

/// Returns true if the direction is further than gaze_range from straight ahead.
template <Scalar T>
RYE_HD bool beyond_gaze_range(const Vec3<T>& gaze) {
    return angular_error(gaze, Vec3<T>(T(0), T(0), T(1))) > constant<T>(gaze_range);
}

/// Angles between the line of sight and the optical axis of an eye, in the head's frame.
/// A typical left eye (subject's) looks 5 degrees nasally of its optical axis: yaw = +0.087.
template <Scalar T>
struct KappaAngles {
    T pitch = T(0), yaw = T(0);                                          ///< [rad]
};

/// Returns the optical axis (to which the eyeball rotates) of a visual axis: its angles plus kappa,
/// its length unchanged. Computed as a rotation, so that a kappa of 0 changes no bit. At a pole the
/// rotation starts from yaw 0.
template <Scalar T>
RYE_HD Vec3<T> apply_kappa(const Vec3<T>& visual, const KappaAngles<T>& kappa) {
    using std::cos, std::sin, std::sqrt;
    const T hh = visual[0] * visual[0] + visual[2] * visual[2];
    const auto pole = hh == T(0);
    const T h = sqrt(select(pole, T(1), hh));                            // distance from the axis
    const T cp = cos(kappa.pitch), sp = sin(kappa.pitch);
    const T out = select(pole, T(T(0) - visual[1] * sp), T(h * cp - visual[1] * sp));
    const T up = visual[1] * cp + select(pole, T(0), h) * sp;
    const T share = out / h;
    const T x = visual[0] * share, z = select(pole, out, T(visual[2] * share));
    const T cy = cos(kappa.yaw), sy = sin(kappa.yaw);
    return Vec3<T>(x * cy + z * sy, up, z * cy - x * sy);
}

/// Returns the visual axis of an optical axis: its angles minus kappa.
template <Scalar T>
RYE_HD Vec3<T> gaze_from_kappa(const Vec3<T>& optical, const KappaAngles<T>& kappa) {
    const Vec2<T> a = pitch_yaw(optical);
    return gaze_vector(T(a[0] - kappa.pitch), T(a[1] - kappa.yaw));
}

/// Returns a world direction in the head's frame, given the head's rotation.
template <Scalar T>
RYE_HD Vec3<T> gaze_in_head(const Mat3<T>& world_from_head, const Vec3<T>& gaze_world) {
    Vec3<T> r;
    for (int i = 0; i < 3; ++i) {
        const Vec3<T> column = world_from_head.col(i);
        r[i] = dot(column, gaze_world);
    }
    return r;
}

/// Returns a direction of the head's frame in the world, given the head's rotation.
template <Scalar T>
RYE_HD Vec3<T> gaze_in_world(const Mat3<T>& world_from_head, const Vec3<T>& gaze_head) {
    Vec3<T> r;
    for (int i = 0; i < 3; ++i)
        r[i] = world_from_head(i, 0) * gaze_head[0] + world_from_head(i, 1) * gaze_head[1] +
               world_from_head(i, 2) * gaze_head[2];
    return r;
}

/// Returns the input of networks that depend on the gaze: the positional encoding of (pitch, yaw).
template <Scalar T>
Columns<T> encode_gaze(const Vec3<T>& gaze, int frequencies = detail::default_frequencies) {
    return positional_encoding(pitch_yaw(gaze), frequencies);
}

} // namespace rye
