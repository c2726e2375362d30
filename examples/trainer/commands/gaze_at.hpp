// SPDX-License-Identifier: Apache-2.0
/// commands/gaze_at.hpp: a point that both eyes look at, as options: --gaze-at and --gaze-range.
#pragma once

#include <array>
#include <string>
#include <vector>

#include <rye/rig/gaze_at.hpp>

#include "drawing/scene_facts.hpp"
#include "model/run.hpp"

namespace CLI {
class App;
}

namespace rye::trainer {

struct GazeAtOptions {
    std::string target;    ///< "camera", "X,Y,Z" or "head:X,Y,Z"; empty: not given
    double range_deg = 45; ///< where an eye stops, from straight ahead; people reach about 50

    bool given() const { return !target.empty(); }
};

/// Adds --gaze-at and --gaze-range.
void add_gaze_at_options(CLI::App& command, GazeAtOptions& options);

/// A value of --gaze-at.
struct GazePoint {
    enum class Frame { camera, world, head };
    Frame frame = Frame::camera;
    Vec3<double> point = Vec3<double>::Zero(); ///< world units, or canonical ones in the head
};

/// Parses "camera", "X,Y,Z" or "head:X,Y,Z"; throws an Error with the option for anything else.
GazePoint parsed_gaze_point(const std::string& text, const std::string& option);

/// The eyes of a run at some drivers: where they are drawn, head frame, canonical units.
struct PlacedEyes {
    HeadPlacement<double> head;
    std::array<Vec3<double>, 2> centre;
    std::array<KappaAngles<double>, 2> kappa; ///< 0 for a run of optical axes
};
PlacedEyes placed_eyes(const TrainState& state, const Drivers<float>& drivers);

/// Returns the target of a picture in the head's frame.
GazeTarget<double> gaze_target(const GazePoint& point, const HeadPlacement<double>& head,
                               const Pinhole<float>& camera);

/// Turns both eyes of each frame to the point: their visual axes, or the optical ones of a run
/// without kappa, meet there. Prints in how many pictures an eye stops at its range before. Throws
/// an Error that names the picture if the point lies inside an eye.
void aim_frames(const GazeAtOptions& options, const TrainState& state,
                std::vector<DrawnFrame>& frames);

} // namespace rye::trainer
