// SPDX-License-Identifier: Apache-2.0
/// rye/train/view_gauge.hpp: what corrections of cameras share, as their pictures show it, which is
/// none of a camera but of the avatar: a motion of the head, and a stretch of it, which rotations
/// of cameras around it imitate.
#pragma once

#include <cmath>

#include <rye/core/columns.hpp>
#include <rye/core/error.hpp>

namespace rye::detail {

/// Number of cameras from which on view_gauge() takes stretches for shared: fewer cameras have
/// hardly any other rotations.
constexpr Index least_stretch_cameras = 6;

/// Returns what centre_views sums with and subtracts, 6 cameras x 2 modes: the weights of each
/// mode, a column over the corrections of all cameras, and then what a unit of each mode adds to
/// them. directions: unit vectors from the pivot to each camera, 3 x cameras. Modes are three
/// rotations, three translations and, of six cameras or more, five stretches that keep the volume.
/// The shared one is that which is closest to the cameras' own, in squares of displacements across
/// the lines of sight, of points all around the pivot: a camera tells little of motions along its
/// own. If all look the same way, nothing is shared along it.
template <class T>
Columns<T> view_gauge(const Columns<T>& directions) {
    const Index cameras = directions.cols(), all = 6 * cameras;
    const Index stretches = cameras >= least_stretch_cameras ? 5 : 0, modes = 6 + stretches;
    // Points x around the pivot have the second moments of a sphere, so rotations r and
    // translations t of a camera in the direction d displace them independently: its picture shows
    // (1 - d d^T)(r x x + t).
    Columns<T> weights = Columns<T>::Zero(all, modes), motions = weights;
    for (Index c = 0; c < cameras; ++c) {
        const Vec3<T> d = directions.col(c);
        const Mat3<T> along = d * d.transpose();
        weights.template block<3, 3>(6 * c, 0) = Mat3<T>::Identity() + along;
        weights.template block<3, 3>(6 * c + 3, 3) = Mat3<T>::Identity() - along;
        motions.template block<3, 3>(6 * c, 0).setIdentity();
        motions.template block<3, 3>(6 * c + 3, 3).setIdentity();
        for (Index k = 0; k < stretches; ++k) {
            Mat3<T> s = Mat3<T>::Zero(); // symmetric and without a trace
            if (k < 2)
                s(k, k) = T(1), s(2, 2) = T(-1);
            else
                s((k - 2) / 2, (k - 1) / 2 + 1) = s((k - 1) / 2 + 1, (k - 2) / 2) = T(1);
            const Vec3<T> to = s * d;
            const Vec3<T> turn(d.y() * to.z() - d.z() * to.y(), d.z() * to.x() - d.x() * to.z(),
                               d.x() * to.y() - d.y() * to.x());
            weights.template block<3, 1>(6 * c, 6 + k) = turn;
            motions.template block<3, 1>(6 * c, 6 + k) = turn;
        }
    }
    Columns<T> mixed = weights.transpose() * motions;
    // Symmetric. Cameras in a plane or in one direction show fewer modes: the others have no share.
    mixed.diagonal().tail(modes - 3).array() += T(1e-6);
    // weights / mixed, by Gauss and Jordan: Eigen's solvers are no host functions to nvcc.
    for (Index k = 0; k < modes; ++k)
        for (Index i = 0; i < modes; ++i) {
            if (i == k) continue;
            const T factor = mixed(k, i) / mixed(k, k);
            mixed.col(i) -= factor * mixed.col(k);
            weights.col(i) -= factor * weights.col(k);
        }
    for (Index k = 0; k < modes; ++k) weights.col(k) /= mixed(k, k);
    Columns<T> gauge(all, 2 * modes);
    gauge.leftCols(modes) = weights;
    gauge.rightCols(modes) = motions;
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

} // namespace rye::detail
