// SPDX-License-Identifier: Apache-2.0
/// rye/rig/gaze_at.hpp: gazes of two eyes that meet at a point. Frame: the head's, x to the
/// subject's left, y up, z out of the face; lengths in canonical units; angles [rad].
///     visual = (p - w c) / |p - w c|,   optical = visual turned by kappa
/// p / w: the target in homogeneous coordinates; c: an eyeball's centre, about which it turns. The
/// visual axis passes through that centre, as labels of captures have it; that of a real eye passes
/// about 0.5 mm beside it, through the nodal points. The eyeball turns to its optical axis by the
/// smallest rotation from straight ahead (rig/eye_transform.hpp), which is Listing's law with that
/// primary direction. No driver has torsion, so the tilt of Listing's planes by vergence is left
/// out.
/// Source: kappa and the angles as rig/gaze.hpp; the law: Haslwanter, "Mathematics of
/// three-dimensional eye rotations", 1995.
#pragma once

#include <array>
#include <cmath>
#include <string>
#include <type_traits>

#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/rig/eye_transform.hpp>
#include <rye/rig/gaze.hpp>

namespace rye {

/// A point to look at: point / weight. With the weight 0 it is infinitely far in the direction
/// `point`, where both visual axes are parallel.
template <Scalar T>
struct GazeTarget {
    Vec3<T> point;
    T weight = T(1); ///< >= 0
};

/// Returns a target of the world's coordinates in the head's: weight 0 and 1 alike, without a
/// division.
template <Scalar T>
RYE_HD GazeTarget<T> target_in_head(const HeadPlacement<T>& head, const GazeTarget<T>& world) {
    const Vec3<T>& at = head.world_from_head.translation;
    Vec3<T> d;
    for (int i = 0; i < 3; ++i) d[i] = world.point[i] - world.weight * at[i];
    return {gaze_in_head(head.world_from_head.rotation, d), world.weight * head.scale};
}

/// Returns the vector from a point of the head's frame to a target, times the target's weight
/// unless that is 0.
template <Scalar T>
RYE_HD Vec3<T> toward(const Vec3<T>& from, const GazeTarget<T>& target) {
    Vec3<T> d;
    for (int i = 0; i < 3; ++i) d[i] = target.point[i] - target.weight * from[i];
    return d;
}

/// Returns the angle of a direction of any length from straight ahead [rad], 0 to pi.
template <Scalar T>
RYE_HD T angle_from_ahead(const Vec3<T>& d) {
    using std::atan2;
    return atan2(norm(Vec2<T>(d[0], d[1])), d[2]);
}

/// Returns the direction that is `range` [rad] from straight ahead on the great circle through a
/// direction of any length; straight ahead for a direction along +z or -z, where there is no such
/// circle.
template <Scalar T>
RYE_HD Vec3<T> at_range(const Vec3<T>& d, const T& range) {
    using std::cos, std::sin;
    const Vec2<T> aside = normalized(Vec2<T>(d[0], d[1]));
    const auto none = aside[0] * aside[0] + aside[1] * aside[1] == T(0);
    const T s = sin(range), c = cos(range);
    return Vec3<T>(s * aside[0], s * aside[1], select(none, T(1), c));
}

/// Gaze of one eye.
template <Scalar T>
struct AimedEye {
    Vec3<T> visual;  ///< unit vector, head frame
    Vec3<T> optical; ///< unit vector, head frame; to which the eyeball turns
    T missed;        ///< angle between the visual axis and the target [rad]; 0 if it is reached
};

/// Returns the gaze of an eye whose visual axis meets the target. An optical axis further than
/// `range` [rad] from straight ahead is stopped there (at_range), and `missed` says by how much the
/// visual axis is then beside the target. A target in the eyeball's centre has no direction: both
/// axes are 0. One formula for every scalar, with derivatives by centre, target and kappa.
template <Scalar T>
RYE_HD AimedEye<T> aim_eye(const Vec3<T>& centre, const GazeTarget<T>& target,
                           const KappaAngles<T>& kappa,
                           const std::type_identity_t<T>& range = constant<T>(gaze_range)) {
    const Vec3<T> visual = normalized(toward(centre, target));
    const Vec3<T> optical = apply_kappa(visual, kappa);
    const auto beyond = angle_from_ahead(optical) > range;
    const Vec3<T> stopped = at_range(optical, T(range));
    const Vec3<T> seen = select_all(beyond, gaze_from_kappa(stopped, kappa), visual);
    return {seen, select_all(beyond, stopped, optical),
            select(beyond, angular_error(seen, visual), T(0))};
}

namespace detail {

/// Returns the target itself, or, where its direction from `middle` is further than `range` [rad]
/// from straight ahead, the point at the same distance on the edge of the range: for a target
/// beside or behind the head, to which both eyes turn together rather than each to its own side.
template <Scalar T>
RYE_HD GazeTarget<T> target_in_range(const Vec3<T>& middle, const GazeTarget<T>& target,
                                     const std::type_identity_t<T>& range) {
    const Vec3<T> d = toward(middle, target);
    const auto beyond = angle_from_ahead(d) > range;
    const Vec3<T> edge = at_range(d, T(range));
    const T length = norm(d);
    GazeTarget<T> r = target;
    for (int i = 0; i < 3; ++i)
        r.point[i] = select(beyond, T(target.weight * middle[i] + length * edge[i]), r.point[i]);
    return r;
}

} // namespace detail

/// Gazes of both eyes, the subject's left first.
template <Scalar T>
using AimedEyes = std::array<AimedEye<T>, 2>;

/// Returns the gazes of both eyes whose visual axes meet at a target of the head's frame, with the
/// centres and kappas of the left and the right eye. What lies beyond `range` [rad] is replaced by
/// target_in_range of the point between the centres, and each eye is stopped as in aim_eye;
/// `missed` is the angle to the target that was asked for.
template <Scalar T>
AimedEyes<T> aim_eyes(const std::array<Vec3<T>, 2>& centre, const GazeTarget<T>& target,
                      const std::array<KappaAngles<T>, 2>& kappa,
                      const std::type_identity_t<T>& range = constant<T>(gaze_range)) {
    Vec3<T> middle;
    for (int i = 0; i < 3; ++i) middle[i] = constant<T>(0.5) * (centre[0][i] + centre[1][i]);
    const GazeTarget<T> near = detail::target_in_range(middle, target, range);
    const auto moved = angle_from_ahead(toward(middle, target)) > range;
    AimedEyes<T> eyes{aim_eye(centre[0], near, kappa[0], range),
                      aim_eye(centre[1], near, kappa[1], range)};
    for (std::size_t e = 0; e < 2; ++e)
        eyes[e].missed =
            select(moved, angular_error(eyes[e].visual, toward(centre[e], target)), eyes[e].missed);
    return eyes;
}

namespace detail {

/// Returns a target from external input, in the frame of the centres. Throws Error("who: ...") for
/// numbers that are not finite, a negative weight, a point at infinity without a direction, and a
/// point within `radius` of an eyeball's centre: inside an eye there is nothing to look at.
template <Real T>
GazeTarget<T> checked_target(const std::string& who, const GazeTarget<T>& target,
                             const std::array<Vec3<T>, 2>& centre, T radius) {
    const auto text = [&] {
        return "(" + number_text(target.point[0]) + ", " + number_text(target.point[1]) + ", " +
               number_text(target.point[2]) + ")";
    };
    const bool finite = std::isfinite(target.point[0]) && std::isfinite(target.point[1]) &&
                        std::isfinite(target.point[2]) && std::isfinite(target.weight);
    require(
        finite && target.weight >= T(0), who, "got the point ", text, " with the weight ",
        [&] { return number_text(target.weight); },
        ", expected finite numbers and a weight of 0 or more");
    require(target.weight > T(0) || norm(target.point) > T(0), who,
            "got a point at infinity without a direction");
    for (std::size_t e = 0; e < 2; ++e)
        require(
            target.weight == T(0) || norm(toward(centre[e], target)) > target.weight * radius, who,
            "got the point ", text, ", which lies inside the ", (e == 0 ? "left" : "right"),
            " eye, expected one further than ", [&] { return number_text(radius); },
            " from its centre");
    return target;
}

} // namespace detail

} // namespace rye
