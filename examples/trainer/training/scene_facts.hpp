// SPDX-License-Identifier: Apache-2.0
/// training/scene_facts.hpp: what scene_profile.hpp judges, counted of frames that a
/// trained run is to draw, and of its avatar.
#pragma once

#include <vector>

#include "training/run.hpp"
#include "training/scene_profile.hpp"

namespace rye::trainer {

/// A picture to be drawn: its drivers, whose gazes are of the run's gaze_axis, and the camera of the full-size image.
struct DrawnFrame {
    Drivers<float> drivers;
    Pinhole<float> camera;
};

/// Drivers' needs of an avatar that is held at the first frame: eyes that look the same in all of
/// them need not turn. Gazes are optical axes. An eye counts as seen where its centre lies in the
/// picture.
DriverFacts driver_facts(const TrainState& state, const std::vector<DrawnFrame>& frames);

/// What the avatar says of frames; centres of eyes move from where they are without its network, or,
/// if it is held at the first frame, from where they are there.
AvatarFacts avatar_facts(const TrainState& state, const std::vector<Drivers<float>>& frames,
                         bool held_at_first);

} // namespace rye::trainer
