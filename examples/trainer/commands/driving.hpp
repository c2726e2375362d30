// SPDX-License-Identifier: Apache-2.0
/// commands/driving.hpp: drivers of a video: of another capture, of another run, or of a CSV file.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "training/run.hpp"

namespace CLI {
class App;
}

namespace rye::trainer {

struct DrivingOptions {
    std::filesystem::path path;   ///< of --driving; empty: not given
    std::string pose = "driving"; ///< driving, relative or own
    std::string range;            ///< FIRST:LAST, both included, from 0; empty: all
};

/// --driving, --pose and --range.
void add_driving_options(CLI::App& command, DrivingOptions& options);

/// The drivers of each picture. `own` are those of the frame that the run's head is drawn at
/// otherwise: a CSV file takes from them what it has no column for, and --pose the head's pose.
/// Throws Error for a path that is none of the three, and unless the drivers fit the avatar.
std::vector<Drivers<float>> driving_frames(const DrivingOptions& options, const TrainState& state,
                                           const Capture& capture, const Drivers<float>& own);

/// The middle of the head, world units.
Vec3<float> head_middle(const TrainState& state, const Drivers<float>& drivers);

} // namespace rye::trainer
