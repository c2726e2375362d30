// SPDX-License-Identifier: Apache-2.0
/// data/corrected_cameras.hpp: cameras of a capture whose numbers were found wrong: applied where a
/// capture has exactly these numbers, and kept in the folder of a run as cameras.json, so that
/// frames of the same calibration are measured, too, by the cameras that were trained with.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "data/capture.hpp"

namespace rye::trainer {

/// Returns whether two cameras have the same numbers, to the bit; sizes of pictures do not count.
bool same_numbers(const Pinhole<double>& a, const Pinhole<double>& b);

/// Corrects the cameras of a capture that have exactly the wrong numbers of these, in all frames in
/// which they have them, and notes them as corrected_cameras. Returns how many cameras these are.
int take_corrected(Capture& capture, const std::vector<CorrectedCamera>& corrected);

inline std::filesystem::path corrected_cameras_path(const std::filesystem::path& run) {
    return run / "cameras.json";
}

/// Replaces cameras.json of a run atomically; removes it where no camera is corrected.
void save_corrected_cameras(const std::filesystem::path& run,
                            const std::vector<CorrectedCamera>& corrected);

/// Those of a run; none without the file. Throws Error naming file, camera and field for anything
/// missing, of another type or out of range, and for a wrong checksum.
std::vector<CorrectedCamera> load_corrected_cameras(const std::filesystem::path& run);

/// The same from the text of a file; errors begin with `who`.
std::vector<CorrectedCamera> parse_corrected_cameras(std::string_view text, const std::string& who);

} // namespace rye::trainer
