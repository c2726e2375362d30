// SPDX-License-Identifier: Apache-2.0
/// importers/face_bundle.hpp: focal length, head poses and the shape of a head from landmarks that a
/// tracker saw in many pictures of one camera. A landmark i of picture f is at
///     rest_i + shapes_i (drivers_f - mean)     in the head,
/// moved by the head's pose and projected. Bundle adjustment of focal length, poses and a share of
/// the landmarks alternates with least squares of each landmark's place and shapes, and with the
/// size of each landmark's errors. Head frame and units: those of the guesses; cameras as in
/// rye/geometry/camera.hpp.
/// Source: Triggs et al., "Bundle adjustment - a modern synthesis", 2000; Huber, 1964.
#pragma once

#include <vector>

#include <rye/core/columns.hpp>
#include <rye/geometry/rigid.hpp>

namespace rye::trainer {

/// The landmarks seen in one picture, and a guess of the head's pose.
struct FaceView {
    Columns<double> seen;  ///< 3 x N: u, v and depth behind any plane of the picture [px]
    Rigid<double> head;    ///< head to camera
    VecX<double> drivers;  ///< K numbers that displace landmarks
};

struct BundleSettings {
    double cx = 0, cy = 0;         ///< principal point, known [px]
    double focal = 1000;           ///< likely focal length [px]
    double focal_sigma = 0.15;     ///< of its logarithm, known before
    double rest_sigma = 0.05;      ///< of a coordinate of a landmark at rest, known before
    double turn_sigma = 0;         ///< of each head's turn from its guess [rad]; 0: not known before
    double shape_sigma = 0.02;     ///< of a displacement by a driver of 1, known before
    double first_sigma = 1;        ///< of a tracked coordinate before it is estimated [px]
    /// Errors that are alike, in neighbouring landmarks and from picture to picture, counted as
    /// one.
    double alike = 400;
    int rounds = 4, stride = 4;    ///< the bundle has every stride-th landmark
};

struct FaceBundle {
    double focal = 0;                 ///< [px]
    double focal_deviation = 0;       ///< standard deviation of its logarithm
    std::vector<Rigid<double>> heads; ///< head to camera, of each view
    Columns<double> rest;             ///< 3 x N, at the mean drivers
    Columns<double> shapes;           ///< 3 N x K
    VecX<double> mean;                ///< of the drivers
    Columns<double> sigma;            ///< 3 x N: of each landmark's errors [px]
    std::vector<double> residual;     ///< of each view: root mean square, in sigmas

    /// Returns all landmarks in the head, 3 x N.
    Columns<double> landmarks(const VecX<double>& drivers) const;
};

/// Returns the head that explains the views best. `rest` is a guess, 3 x N. Throws an Error for
/// fewer than 3 views.
FaceBundle bundle_face(const std::vector<FaceView>& views, const Columns<double>& rest,
                       const BundleSettings& settings);

} // namespace rye::trainer
