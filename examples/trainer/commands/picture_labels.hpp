// SPDX-License-Identifier: Apache-2.0
/// commands/picture_labels.hpp: what is known of drawn pictures, as JSON lines: gazes by both axes,
/// eyes, target, head and camera. docs/gaze.md has the fields.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "commands/gaze_at.hpp"

namespace rye::trainer {

/// Throws an Error that begins with `who` unless the name ends in .jsonl.
void check_labels_name(const std::string& path, const std::string& who);

/// Returns a JSON object a line, one for each frame in its order; `pictures` are their names, or
/// empty where they have none (a video). Of a run without kappa both axes are the optical one.
std::string text_of_labels(const TrainState& state, const std::vector<DrawnFrame>& frames,
                           const std::vector<std::string>& pictures, const GazeAtOptions& at);

} // namespace rye::trainer
