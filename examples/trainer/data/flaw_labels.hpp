// SPDX-License-Identifier: Apache-2.0
/// data/flaw_labels.hpp: errors in the labels of a frame and in a camera's calibration, as arrays
/// of a capture's files. Arrays keep their types and shapes; other arrays are unchanged.
#pragma once

#include <array>
#include <filesystem>

#include <rye/io/npz.hpp>
#include <rye/core/columns.hpp>

#include "data/flaw_draws.hpp"

namespace rye::trainer {

/// Errors of one frame's labels.
struct LabelFlaws {
    FlawDraws draws;
    FlawSizes sizes;
    double expression_share = 1; ///< share of the coefficients that are wrong
    double unit_mm = 100;        ///< a world unit [mm]
    std::size_t frame = 0;       ///< index in the capture

    bool has(Flaw flaw) const { return sizes[flaw] > 0; }
    bool has_pose() const { return has(Flaw::pose_rotation) || has(Flaw::pose_position); }
    bool has_gaze() const { return has(Flaw::gaze_common) || has(Flaw::gaze_single); }
};

/// Puts errors into exp_coeff and pose of a params.npz; `who` begins messages. A rotation is about
/// the origin of the head's frame.
void flaw_params(NpzArrays& arrays, const LabelFlaws& flaws, const std::string& who,
                 FlawSums& sums);

/// Puts errors into yaw and pitch of gazes and visual axes, and into the centres of a gaze.npz;
/// directions in the world follow from the pose, axis-angle [rad].
void flaw_gaze(NpzArrays& arrays, const Vec3<double>& rotation, const LabelFlaws& flaws,
               const std::string& who, FlawSums& sums);

/// Moves points (N, 3); `list` distinguishes the lists of points of a frame.
void flaw_points(NpyArray& points, std::size_t list, const LabelFlaws& flaws,
                 const std::string& who, FlawSums& sums);

/// Errors of a camera's calibration, the same in all frames.
struct CalibrationFlaws {
    Vec3<double> rotation = Vec3<double>::Zero(); ///< about its centre, camera axes [rad]
    Vec3<double> position = Vec3<double>::Zero(); ///< motion of its centre [world units]
    double focal = 1;                             ///< factor of both focal lengths
};

/// Draws the errors of the camera with this index.
CalibrationFlaws calibration_flaws(const FlawDraws& draws, const FlawSizes& sizes, double unit_mm,
                                   std::size_t camera, FlawSums& sums);

/// Puts errors into intrinsic and extrinsic of a camera's npz.
void flaw_camera(NpzArrays& arrays, const CalibrationFlaws& flaws, const std::string& who);

} // namespace rye::trainer
