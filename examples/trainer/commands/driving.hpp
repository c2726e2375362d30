// SPDX-License-Identifier: Apache-2.0
/// commands/driving.hpp: drivers for a video: of another capture, another run, a CSV file, or the
/// track of a face tracker.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "drawing/shown.hpp"

namespace CLI {
class App;
}

namespace rye::trainer {

struct DrivingOptions {
    std::filesystem::path path;   ///< value of --driving; empty: not given
    std::string pose = "driving"; ///< driving, relative or own
    std::string range;            ///< FIRST:LAST, both included, from 0; empty: all
    std::string flip;             ///< of a track: names of face_track.hpp's flips; empty: none
    int neutral = -1;             ///< of a track: picture of a neutral face; -1: none
};

/// Adds --driving, --pose, --range, --flip and --neutral.
void add_driving_options(CLI::App& command, DrivingOptions& options);

/// Returns the drivers of each picture. `own` are the run's drivers at the frame drawn otherwise:
/// they fill what a file lacks, and --pose may keep their head pose. A track with times is played
/// at `rate` pictures a second; what of it drives what is said on standard error. Throws an Error
/// for a path that is none of these, and unless the drivers fit the avatar. `pupils` receives those
/// of a CSV file that has them, a frame each, else nothing.
std::vector<Drivers<float>> driving_frames(const DrivingOptions& options, const TrainState& state,
                                           const Capture& capture, const Drivers<float>& own,
                                           double rate, std::vector<PupilRatios>* pupils = nullptr);

/// Returns the middle of the head, world units.
Vec3<float> head_middle(const TrainState& state, const Drivers<float>& drivers);

} // namespace rye::trainer
