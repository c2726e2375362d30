// SPDX-License-Identifier: Apache-2.0
/// corrections/seen_gazes.hpp: gazes of a capture's frames from their photographs: the irises that
/// gaze_estimator.hpp finds in all views of a frame, joined.
#pragma once

#include <array>
#include <vector>

#include "corrections/gaze_estimator.hpp"
#include "data/capture.hpp"

namespace rye::trainer {

/// Gaze of an eye in a frame, as seen.
struct SeenGaze {
    int views = 0; ///< number that show its iris; 0: nothing is known
    Vec2<double> angles = Vec2<double>::Zero(); ///< (pitch, yaw) in the head's frame [rad]
    Vec2<double> sigma = Vec2<double>::Zero(); ///< standard deviation of each [rad]
};

/// Geometry of an eyeball in the head's frame, canonical units.
struct EyeballInHead {
    Vec3<double> centre;
    double radius, limbus_radius, iris_plane;
};

/// Iris in one view.
struct SeenIris {
    int camera;
    Vec2<double> angles; ///< (pitch, yaw) in the head's frame [rad]
    double sharpness;    ///< 1 for enough pixels, less for fewer
    Vec2<double> at;     ///< middle of the iris in the picture [px]
    double edge;         ///< radius of the sphere of its rim in the picture [px]
    double contrast;     ///< share of the variance in the picture that it explains, 0 to 1
};

/// Returns the irises of both eyes in each of these frames, by camera. balls: both eyes in each
/// frame. Needs eye masks, which are off by up to `area_error` radii (estimate_gaze); ignores eyes
/// without one in a view.
std::vector<std::array<std::vector<SeenIris>, 2>>
seen_irises(const Capture& capture, const std::vector<int>& frames,
            const std::vector<std::array<EyeballInHead, 2>>& balls, double area_error = 0);

/// Returns the gazes joined from the irises of each frame.
std::vector<std::array<SeenGaze, 2>>
seen_gazes(const Capture& capture, const std::vector<int>& frames,
           const std::vector<std::array<EyeballInHead, 2>>& balls, double area_error = 0);

} // namespace rye::trainer
