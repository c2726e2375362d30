// SPDX-License-Identifier: Apache-2.0
/// drawing/scene_facts.hpp: facts for scene_profile.hpp, counted from the frames that a trained
/// run is to draw and from its avatar.
#pragma once

#include <vector>

#include "drawing/scene_profile.hpp"
#include "drawing/shown.hpp"
#include "model/run.hpp"

namespace rye::trainer {

/// Returns the facts about drivers for an avatar held at the first frame: eyes that look the same
/// in all frames need not turn. Gazes are optical axes. An eye counts as seen if its centre lies in
/// the picture.
DriverFacts driver_facts(const TrainState& state, const std::vector<DrawnFrame>& frames);

/// Returns the facts about the avatar in these frames. Motions of the eyes' centres are relative to
/// those without its network, or, if it is held at the first frame, to those of that frame.
AvatarFacts avatar_facts(const TrainState& state, const std::vector<Drivers<float>>& frames,
                         bool held_at_first);

} // namespace rye::trainer
