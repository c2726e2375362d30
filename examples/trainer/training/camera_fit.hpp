// SPDX-License-Identifier: Apache-2.0
/// training/camera_fit.hpp: poses and focal lengths of cameras that agree with what their pictures
/// show of points of the head, by a robust least squares with priors. Points may be off, too, in
/// all pictures alike: each has an offset in the world. A camera that points elsewhere and one
/// that stands aside show the head alike, and priors share what is seen among the two: it is the
/// picture of the head that is determined, not each number.
#pragma once

#include <vector>

#include <rye/core/columns.hpp>
#include <rye/geometry/camera.hpp>

namespace rye::trainer {

/// Where a camera's picture shows a point.
struct SeenPoint {
    int camera, point;  ///< indices
    Vec2<double> at;    ///< in the picture [px]
    double sigma;       ///< deviation of a coordinate [px]
};

/// How a camera differs from its numbers.
struct CameraChange {
    Vec3<double> turn = Vec3<double>::Zero();  ///< about its centre, camera frame [rad]
    Vec3<double> shift = Vec3<double>::Zero(); ///< of its centre, camera frame [world unit]
    double log_focal = 0;                      ///< of the factor of both focal lengths
};

/// Returns the camera with the change made.
Pinhole<double> changed(const Pinhole<double>& camera, const CameraChange& change);

/// Deviations of what is not known before.
struct CameraPriors {
    double turn = 0.5 * 0.017453292519943295; ///< an axis [rad]
    double shift = 0.03;                      ///< an axis [world unit]
    double focal = 0.01;                      ///< of the logarithm
    double point = 0.015;  ///< a coordinate of a point's offset [world unit]
};

struct CameraFit {
    std::vector<CameraChange> changes; ///< of each camera
    /// Distance of each point from where it is seen [px]: with cameras as they are and the offsets
    /// that suit them, and with both changed.
    std::vector<double> before, after;
};

/// points: 3 x points, world. Every camera without points keeps its numbers.
CameraFit fit_cameras(const std::vector<Pinhole<double>>& cameras, const Columns<double>& points,
                      const std::vector<SeenPoint>& seen, const CameraPriors& priors = {});

} // namespace rye::trainer
