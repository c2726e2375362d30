// SPDX-License-Identifier: Apache-2.0
/// training/seen_gazes.hpp: where the eyes of a capture's frames look by their photographs: the
/// irises that gaze_estimator.hpp finds in all views of a frame, joined.
#pragma once

#include <array>
#include <vector>

#include "data/capture.hpp"
#include "training/gaze_estimator.hpp"

namespace rye::trainer {

/// Where an eye looks in a frame.
struct SeenGaze {
    int views = 0; ///< that show its iris; 0: nothing is known
    Vec2<double> angles = Vec2<double>::Zero(); ///< (pitch, yaw) in the head's frame [rad]
    Vec2<double> sigma = Vec2<double>::Zero(); ///< deviation of each [rad]
};

/// Geometry of an eyeball in the head's frame, canonical units.
struct EyeballInHead {
    Vec3<double> centre;
    double radius, limbus_radius, iris_plane;
};

/// Both eyes of each of these frames. balls: of both eyes in each. Needs eye masks; eyes without
/// one in a view are not seen by it.
std::vector<std::array<SeenGaze, 2>>
seen_gazes(const Capture& capture, const std::vector<int>& frames,
           const std::vector<std::array<EyeballInHead, 2>>& balls);

} // namespace rye::trainer
