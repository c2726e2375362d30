// SPDX-License-Identifier: Apache-2.0
/// commands/options.hpp: options that commands share: threads, frames and cameras by name.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "training/run.hpp"

namespace CLI {
class App;
}

namespace rye::trainer {

/// Index of a frame by its id; empty: the first test frame, or else the first frame.
int frame_index(const Capture& capture, const std::string& id);

/// The same in a capture of which no frame is read yet.
std::string frame_id(const CaptureContents& contents, const std::string& id);

/// The cameras that camera_index chooses from: of an empty id all, else the one; Error if there is
/// none of that id.
std::vector<std::string> camera_choices(const CaptureContents& contents, const std::string& id);

/// Index of a camera by its id; empty: the one that sees the face of that frame most frontally.
int camera_index(const Capture& capture, const std::string& id, int frame);

/// PITCH,YAW in degrees as a unit vector of the head frame; Error beyond 70 degrees either way.
Vec3<float> gaze_option(const std::vector<double>& pitch_yaw_deg, const std::string& option);

/// A whole number below 2^64; Error naming the option for anything else.
std::uint64_t parsed_seed(const std::string& text, const std::string& option);

/// "0.004" or "1/255", between 0 and 1; Error naming the command and the option for anything else.
double parsed_error(const std::string& text, const std::string& who, const std::string& option);

/// More threads than this are a mistake: every one costs memory, and systems refuse them late.
inline constexpr int most_threads = 1024;

/// --threads, 0 (all) to most_threads.
void add_threads(CLI::App& command, int& threads, const std::string& help = "Threads (0: all)");

/// Error unless the capture's drivers fit the trained avatar.
void require_same_subject(const TrainState& state, const Capture& capture);

} // namespace rye::trainer
