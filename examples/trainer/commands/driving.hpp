// SPDX-License-Identifier: Apache-2.0
/// commands/driving.hpp: drivers for a video: of another capture, another run, or a CSV file.
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
    std::filesystem::path path;   ///< value of --driving; empty: not given
    std::string pose = "driving"; ///< driving, relative or own
    std::string range;            ///< FIRST:LAST, both included, from 0; empty: all
};

/// Adds --driving, --pose and --range.
void add_driving_options(CLI::App& command, DrivingOptions& options);

/// Returns the drivers of each picture. `own` are the run's drivers at the frame drawn otherwise:
/// they fill the columns that a CSV file lacks, and --pose may keep their head pose. Throws an
/// Error for a path that is none of the three, and unless the drivers fit the avatar.
std::vector<Drivers<float>> driving_frames(const DrivingOptions& options, const TrainState& state,
                                           const Capture& capture, const Drivers<float>& own);

/// Returns the middle of the head, world units.
Vec3<float> head_middle(const TrainState& state, const Drivers<float>& drivers);

} // namespace rye::trainer
