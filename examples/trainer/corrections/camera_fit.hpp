// SPDX-License-Identifier: Apache-2.0
/// corrections/camera_fit.hpp: fit of camera poses and focal lengths to the positions of the head's
/// points in the pictures, by robust least squares with priors. Points may be wrong as well, alike
/// in all pictures: each has an offset in the world, whose deviation says how far points can be
/// trusted, and so how much of what all cameras share, as a zoom, is theirs. Rotating a camera and
/// moving it sideways have a similar effect on the picture of the head, and the priors distribute
/// the difference between the two: the fit determines that picture, not each number.
#pragma once

#include <limits>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/geometry/camera.hpp>

namespace rye::trainer {

/// Position of a point in a camera's picture.
struct SeenPoint {
    int camera, point; ///< indices
    Vec2<double> at;   ///< in the picture [px]
    double sigma;      ///< standard deviation of a coordinate [px]
};

/// Change of a camera's numbers.
struct CameraChange {
    Vec3<double> turn = Vec3<double>::Zero();  ///< rotation about its centre, camera frame [rad]
    Vec3<double> shift = Vec3<double>::Zero(); ///< motion of its centre, camera frame [world unit]
    double log_focal = 0;                      ///< logarithm of the factor of both focal lengths
};

/// Returns the camera after the change.
Pinhole<double> changed(const Pinhole<double>& camera, const CameraChange& change);

/// Prior standard deviations of the unknowns.
struct CameraPriors {
    double turn = 0.5 * 0.017453292519943295; ///< about an axis [rad]
    double shift = 0.03;                      ///< along an axis [world unit]
    double focal = 0.01;                      ///< of the logarithm
    double point = 0.015;                     ///< coordinate of a point's offset [world unit]
    double loose = 0.015;                     ///< the same from first_loose on [world unit]
    /// Index of the first point that labels place badly, whatever their errors; none by default.
    Index first_loose = std::numeric_limits<Index>::max();
};

struct CameraFit {
    std::vector<CameraChange> changes; ///< of each camera
    /// Distance of each seen point from its expected position [px]: with the given cameras and the
    /// offsets that fit them, and with both changed.
    std::vector<double> before, after;
    Columns<double> offsets; ///< of the points, 3 x points [world unit]
};

/// Returns the fit. points: 3 x points, world. A camera that sees no point keeps its numbers.
CameraFit fit_cameras(const std::vector<Pinhole<double>>& cameras, const Columns<double>& points,
                      const std::vector<SeenPoint>& seen, const CameraPriors& priors = {});

} // namespace rye::trainer
