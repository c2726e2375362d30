// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/rigid.hpp: rigid motions y = R x + t, named after their frames,
/// `target_from_source`, so that neighbours cancel: a_from_c = compose(a_from_b, b_from_c).
#pragma once

#include <rye/math/linalg.hpp>

namespace rye {

/// Rigid motion y = rotation x + translation.
template <Scalar T>
struct Rigid {
    Mat3<T> rotation = identity_rotation();                 ///< orthogonal, determinant 1
    Vec3<T> translation = Vec3<T>(T(0), T(0), T(0));        ///< [length of the target frame]

    /// Maps a point from the source frame to the target frame.
    RYE_HD Vec3<T> apply(const Vec3<T>& x) const {
        const Vec3<T> r = turn(x);
        return Vec3<T>(r[0] + translation[0], r[1] + translation[1], r[2] + translation[2]);
    }

    /// Rotates a direction.
    RYE_HD Vec3<T> turn(const Vec3<T>& v) const {
        Vec3<T> r;
        for (int i = 0; i < 3; ++i)
            r[i] = rotation(i, 0) * v[0] + rotation(i, 1) * v[1] + rotation(i, 2) * v[2];
        return r;
    }

    /// Rotates a direction by the inverse; also the cotangent of x for apply.
    RYE_HD Vec3<T> turn_back(const Vec3<T>& v) const {
        Vec3<T> r;
        for (int i = 0; i < 3; ++i)
            r[i] = rotation(0, i) * v[0] + rotation(1, i) * v[1] + rotation(2, i) * v[2];
        return r;
    }

    RYE_HD Rigid inverse() const {
        const Vec3<T> back = turn_back(translation);
        return {Mat3<T>(rotation.transpose()), Vec3<T>(-back[0], -back[1], -back[2])};
    }

    template <Scalar U>
    Rigid<U> cast() const {
        return {Mat3<U>(rotation.template cast<U>()), Vec3<U>(translation.template cast<U>())};
    }

    RYE_HD static Mat3<T> identity_rotation() {
        Mat3<T> r;
        for (int j = 0; j < 3; ++j)
            for (int i = 0; i < 3; ++i) r(i, j) = T(i == j ? 1 : 0);
        return r;
    }
};

/// Returns a_from_c = compose(a_from_b, b_from_c).
template <Scalar T>
RYE_HD Rigid<T> compose(const Rigid<T>& a_from_b, const Rigid<T>& b_from_c) {
    Mat3<T> r;
    for (int j = 0; j < 3; ++j) {
        const Vec3<T> column = b_from_c.rotation.col(j);
        r.col(j) = a_from_b.turn(column);
    }
    return {r, a_from_b.apply(b_from_c.translation)};
}

} // namespace rye
