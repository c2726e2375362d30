// SPDX-License-Identifier: Apache-2.0
/// data/driver_table.hpp: drivers of a head, frame by frame, as a CSV file that people and programs
/// write: a line of column names, then a line per frame. docs/formats.md has the columns.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <rye/avatar/drivers.hpp>

namespace rye::trainer {

/// Columns that a file may name: width of the expression, names of its coefficients (or none).
struct DriverNames {
    int expression = 0;
    std::vector<std::string> coefficients;
};

/// Returns the frames of a file: for each, the drivers of `otherwise` with the file's columns in
/// their place. Gazes are along the axis of the run. Throws an Error with file, line, column and
/// value. Columns of pupils are known only to a caller that takes them: `pupils` receives ratios of
/// each frame (rye/rig/pupil.hpp), left and right, or nothing if the file has none.
std::vector<Drivers<float>> read_drivers(const std::filesystem::path& path,
                                         const DriverNames& names, const Drivers<float>& otherwise,
                                         std::vector<std::array<float, 2>>* pupils = nullptr);
/// Returns the frames in the text of a file; errors begin with `name`.
std::vector<Drivers<float>> parse_drivers(std::string_view text, const std::string& name,
                                          const DriverNames& names,
                                          const Drivers<float>& otherwise,
                                          std::vector<std::array<float, 2>>* pupils = nullptr);

/// Returns all columns of these frames as read_drivers takes them, after the ids of the frames;
/// those of pupils if there are any.
std::string text_of_drivers(const std::vector<Drivers<float>>& frames,
                            const std::vector<std::string>& ids,
                            const std::vector<std::array<float, 2>>& pupils = {});

} // namespace rye::trainer
