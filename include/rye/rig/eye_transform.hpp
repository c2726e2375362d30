// SPDX-License-Identifier: Apache-2.0
/// rye/rig/eye_transform.hpp: an eyeball's offset, gaze and head pose as one similarity per eye.
///     x_world = S R (c + o + R_g x) + T,   q_world = q_R (x) q_g (x) q
/// x: a template point relative to the eyeball's centre; c: the neutral centre; o: the eye offset
/// (both in canonical head units); R_g: the smallest rotation from +z to the gaze, so without
/// torsion; R, T, S: the head's pose. Points rotate about their own centre, so rounding does not
/// grow with the head's distance from the origin.
/// Source: "Roll Your Eyes", eq. 9-10, with the composition of docs/deviations.md.
#pragma once

#include <rye/geometry/rigid.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

namespace rye {

/// Pose of the head: x_world = S R x_head + T. R, T: world_from_head; S: scale.
template <Scalar T>
struct HeadPlacement {
    Rigid<T> world_from_head = {};
    T scale = T(1);

    /// Returns a point of the head's frame in the world.
    RYE_HD Vec3<T> apply(const Vec3<T>& head) const {
        return world_from_head.apply(Vec3<T>(scale * head));
    }
};

/// Inputs of one eye in one frame, in the head's canonical frame.
template <Scalar T>
struct EyeDrive {
    Vec3<T> centre;                                   ///< neutral centre [unit]
    Vec3<T> offset = Vec3<T>(T(0), T(0), T(0));       ///< offset of the centre [unit]
    Vec3<T> gaze = Vec3<T>(T(0), T(0), T(1));         ///< direction, any length
};

/// Transform from an eyeball's frame to the world.
template <Scalar T>
struct EyeTransform {
    Mat3<T> rotation;       ///< world from eye, without the scale
    Quat<T> quaternion;     ///< `rotation` as a unit quaternion
    Vec3<T> translation;    ///< the eyeball's centre in the world [world units]
    T scale;                ///< S, of the head
    Mat3<T> head_rotation;  ///< world from head, for the vjp
    bool beyond_range;      ///< true if the gaze is outside gaze_range; rendered all the same

    /// Maps a template point to the world.
    RYE_HD Vec3<T> apply(const Vec3<T>& x) const {
        const Rigid<T> turn{rotation, Vec3<T>(T(0), T(0), T(0))};
        const Vec3<T> y = turn.turn(x);
        return Vec3<T>(scale * y[0] + translation[0], scale * y[1] + translation[1],
                       scale * y[2] + translation[2]);
    }
};

namespace detail {

/// Returns an eye at its centre in the head's frame, looking ahead. An avatar applies the factors
/// of its effects to it: turn_eye_to or turn_eye, then carry_eye.
template <Scalar T>
RYE_HD EyeTransform<T> eye_at(const Vec3<T>& centre) {
    const Mat3<T> none = Rigid<T>::identity_rotation();
    return {none, Quat<T>(T(1), T(0), T(0), T(0)), centre, T(1), none, false};
}

} // namespace detail

/// Rotates an eye at rest to its gaze, the optical axis, a unit vector.
template <Scalar T>
RYE_HD void turn_eye_to(EyeTransform<T>& e, const Vec3<T>& gaze) {
    e.quaternion = shortest_arc(Vec3<T>(T(0), T(0), T(1)), gaze);
    e.rotation = quat_matrix(e.quaternion);
    e.beyond_range = beyond_gaze_range(gaze);
}
/// Rotates an eye at rest to a gaze of any length; throws an Error if it is not finite or near 0.
template <Scalar T>
void turn_eye(EyeTransform<T>& e, const Vec3<T>& optical) {
    turn_eye_to(e, detail::checked_gaze(optical));
}

namespace detail {

/// Applies the head's pose to an eye in the head's frame.
template <Scalar T>
RYE_HD void carry_eye(EyeTransform<T>& e, const HeadPlacement<T>& head) {
    const Mat3<T>& r = head.world_from_head.rotation;
    const Vec3<T> zero(T(0), T(0), T(0));
    e.rotation = compose(Rigid<T>{r, zero}, Rigid<T>{e.rotation, zero}).rotation;
    e.quaternion = quat_product(matrix_quat(r), e.quaternion);
    e.translation = head.world_from_head.apply(Vec3<T>(e.translation[0] * head.scale,
                                                       e.translation[1] * head.scale,
                                                       e.translation[2] * head.scale));
    e.scale = head.scale;
    e.head_rotation = r;
}

} // namespace detail

/// Returns the product of all factors; throws an Error for a gaze as turn_eye does.
template <Scalar T>
EyeTransform<T> eye_transform(const EyeDrive<T>& drive, const HeadPlacement<T>& head) {
    EyeTransform<T> e =
        detail::eye_at(Vec3<T>(drive.centre[0] + drive.offset[0], drive.centre[1] + drive.offset[1],
                               drive.centre[2] + drive.offset[2]));
    turn_eye(e, drive.gaze);
    detail::carry_eye(e, head);
    return e;
}

/// Returns a world point in an eye's frame.
template <Scalar T>
RYE_HD Vec3<T> into_eye(const EyeTransform<T>& eye, const Vec3<T>& world) {
    const Vec3<T> back = Rigid<T>{eye.rotation, world}.turn_back(
        Vec3<T>(world[0] - eye.translation[0], world[1] - eye.translation[1],
                world[2] - eye.translation[2]));
    return Vec3<T>(back[0] / eye.scale, back[1] / eye.scale, back[2] / eye.scale);
}

/// Maps template points, 3 x P, to the world.
template <Scalar T>
Columns<T> eye_points(const EyeTransform<T>& eye, const Columns<T>& points) {
    Columns<T> y(3, points.cols());
    for (Index i = 0; i < points.cols(); ++i)
        y.col(i).template head<3>() = eye.apply(points.col(i));
    return y;
}

namespace detail {

/// Returns the cotangent of the offset (and of the neutral centre), given the sum of the world
/// points' cotangents.
template <Scalar T>
RYE_HD Vec3<T> eye_offset_cotangent(const EyeTransform<T>& eye, const Vec3<T>& sum) {
    const Vec3<T> back = Rigid<T>{eye.head_rotation, sum}.turn_back(sum);
    return Vec3<T>(eye.scale * back[0], eye.scale * back[1], eye.scale * back[2]);
}
/// Returns the same, given the cotangents of all world points, 3 x P.
template <Scalar T>
Vec3<T> eye_offset_cotangent(const EyeTransform<T>& eye, const Columns<T>& g_points) {
    Vec3<T> sum(T(0), T(0), T(0));
    for (Index i = 0; i < g_points.cols(); ++i) sum += g_points.col(i);
    return eye_offset_cotangent(eye, sum);
}

} // namespace detail

/// Returns the quaternions of the eye's Gaussians in the world, 4 x P, without conversion to
/// matrices.
template <Scalar T>
Columns<T> eye_rotations(const EyeTransform<T>& eye, const Columns<T>& rotations) {
    Columns<T> q(4, rotations.cols());
    for (Index i = 0; i < rotations.cols(); ++i)
        q.col(i).template head<4>() = quat_product<T>(eye.quaternion, rotations.col(i));
    return q;
}

/// Returns the cotangent of the quaternions in the eye's frame, 4 x P.
template <Scalar T>
Columns<T> eye_rotations_vjp(const EyeTransform<T>& eye, const Columns<T>& g) {
    Columns<T> r(4, g.cols());
    for (Index i = 0; i < g.cols(); ++i)
        r.col(i).template head<4>() = quat_product_vjp_right<T>(eye.quaternion, g.col(i));
    return r;
}

} // namespace rye
