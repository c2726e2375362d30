// SPDX-License-Identifier: Apache-2.0
/// rye/train/view_gauge.hpp: the motion that corrections of cameras share, as their pictures show
/// it, which is none of a camera but of the avatar.
#pragma once

#include <cmath>

#include <Eigen/LU>

#include <rye/core/columns.hpp>
#include <rye/core/error.hpp>

namespace rye {

/// Returns the matrices that centre_views sums with, 3 x 6 cameras: of rotations, then of
/// translations. directions: unit vectors from the pivot to each camera, 3 x cameras. The motion
/// that cameras share is that which is closest to theirs, in squares of displacements across the
/// lines of sight, of points around the pivot: a camera tells little of motions along its own. If
/// all look the same way, nothing is shared along it.
template <class T>
Columns<T> view_gauge(const Columns<T>& directions) {
    const Index cameras = directions.cols();
    Columns<T> gauge(3, 6 * cameras);
    Mat3<T> rotations = Mat3<T>::Zero(), translations = Mat3<T>::Zero();
    for (Index c = 0; c < cameras; ++c) {
        const Mat3<T> along = directions.col(c) * directions.col(c).transpose();
        gauge.template middleCols<3>(3 * c) = Mat3<T>::Identity() + along;
        gauge.template middleCols<3>(3 * (cameras + c)) = Mat3<T>::Identity() - along;
        rotations += gauge.template middleCols<3>(3 * c);
        translations += gauge.template middleCols<3>(3 * (cameras + c));
    }
    translations += T(1e-6) * Mat3<T>::Identity();
    const Mat3<T> of_rotations = rotations.inverse(), of_translations = translations.inverse();
    for (Index c = 0; c < cameras; ++c) {
        gauge.template middleCols<3>(3 * c) =
            (of_rotations * gauge.template middleCols<3>(3 * c)).eval();
        gauge.template middleCols<3>(3 * (cameras + c)) =
            (of_translations * gauge.template middleCols<3>(3 * (cameras + c))).eval();
    }
    return gauge;
}

/// Throws an Error unless there is a unit vector for each camera that is corrected.
template <class T>
void check_directions(const Columns<T>& directions, Index cameras, const char* who) {
    require(directions.rows() == 3 && directions.cols() == cameras, who, "view_directions is ",
            directions.rows(), " x ", directions.cols(), ", expected 3 x ", cameras);
    for (Index c = 0; c < cameras; ++c)
        require(std::abs(directions.col(c).norm() - 1) < 1e-3, who, "column ", c,
                " of view_directions has length ", directions.col(c).norm(), ", expected 1");
}

} // namespace rye
