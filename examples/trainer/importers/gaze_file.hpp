// SPDX-License-Identifier: Apache-2.0
/// importers/gaze_file.hpp: gazes of all frames in one file.
///
/// CSV: a line `frame,left_pitch,left_yaw,right_pitch,right_yaw`, then one line per frame: its name
/// and the angles of both optical axes in the head frame [deg], pitch + up, yaw + towards the
/// subject's left. npz: gaze_left and gaze_right, N x 3 unit vectors in the head frame, one row per
/// frame in the order of the frames' names.
#pragma once

#include <array>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include <rye/math/linalg.hpp>

namespace rye::trainer {

using GazeRow = std::array<Vec3<double>, 2>; ///< unit, left and right eye, head frame

/// Returns the gazes in a CSV by the names of their frames; errors begin with `name`, and are as
/// below.
std::map<std::string, GazeRow> parse_gaze_csv(std::string_view text, const std::string& name);

/// Returns the gazes of these frames, sorted by name; ignores further ones of a CSV. Throws an
/// Error, with file, line and value, for anything else, for a missing frame, and beyond the range
/// of an eye.
std::map<std::string, GazeRow> read_gaze_file(const std::filesystem::path& path,
                                              const std::vector<std::string>& frames);

} // namespace rye::trainer
