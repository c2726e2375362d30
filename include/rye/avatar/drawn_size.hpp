// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/drawn_size.hpp: how wide to draw Gaussians of a head that is larger or smaller in the
/// picture than in those it was trained by. A dilation is a number of pixels; with training's in
/// every picture a larger one has thin Gaussians with gaps between them, and a smaller one wide
/// edges. So the dilation is kept as wide on the head as training had it.
#pragma once

#include <algorithm>
#include <cmath>

#include <rye/avatar/head_pose.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/math/linalg.hpp>

namespace rye {

/// Returns the middle of the box around points, 3 x N.
template <class T>
Vec3<T> box_middle(const Columns<T>& points) {
    return T(0.5) * (points.rowwise().minCoeff() + points.rowwise().maxCoeff());
}

/// Returns how many pixels a unit of the head frame spans across the line of sight at `middle`, a
/// point of that frame; for a point nearer than the camera's near depth, as many as there.
template <Real T, EffectSet E>
T pixels_of_unit(const Vec3<T>& middle, const Drivers<T, E>& drivers, const Pinhole<T>& camera) {
    const HeadTransform<T> head = head_transform(drivers);
    const Vec3<T> at = camera.camera_from_world.apply(
        Vec3<T>(head.scale * (head.rotation * middle) + head.translation));
    return std::sqrt(camera.fx * camera.fy) * head.scale / std::max(at[2], camera.near_depth);
}

/// Returns the dilation of a picture [px^2], for that of training, where the head is `share` times
/// as large. Not below 0.02: pixels of a picture that is much smaller would miss Gaussians that lie
/// between them.
inline double resized_dilation(double of_training, double share) {
    constexpr double least = 0.02;
    return std::max(of_training * share * share, std::min(of_training, least));
}

/// Size of a head in the pictures that it was trained by.
template <Real T>
struct TrainedSize {
    Vec3<T> middle; ///< of the head, in its frame
    T pixels;       ///< that a unit of it spans

    /// The size of a head with this middle by a frame and a camera of training.
    TrainedSize(const Vec3<T>& of, const Drivers<T>& drivers, const Pinhole<T>& camera)
        : middle(of),
          pixels(pixels_of_unit(middle, drivers, camera)) {}

    /// Returns the dilation of a picture [px^2], for that of training.
    double dilation(double of_training, const Drivers<T>& drivers, const Pinhole<T>& camera) const {
        return resized_dilation(
            of_training, static_cast<double>(pixels_of_unit(middle, drivers, camera) / pixels));
    }
};

} // namespace rye
