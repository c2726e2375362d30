// SPDX-License-Identifier: Apache-2.0
/// data/corrected_cameras.hpp: corrections of a capture's wrong cameras: applied to cameras with
/// exactly the wrong numbers, and stored in a run's folder as cameras.json, so that frames of the
/// same calibration are also measured with the cameras of the training.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "data/capture.hpp"

namespace rye::trainer {

/// Returns true if two cameras have the same numbers, to the bit; sizes of pictures do not count.
bool same_numbers(const Pinhole<double>& a, const Pinhole<double>& b);

/// Corrects a capture's cameras that have exactly these wrong numbers, in all frames in which they
/// have them, and records them in corrected_cameras. Returns the number of these cameras.
int take_corrected(Capture& capture, const std::vector<CorrectedCamera>& corrected);

inline std::filesystem::path corrected_cameras_path(const std::filesystem::path& run) {
    return run / "cameras.json";
}

/// Replaces cameras.json of a run atomically; removes it if no camera is corrected.
void save_corrected_cameras(const std::filesystem::path& run,
                            const std::vector<CorrectedCamera>& corrected);

/// Returns the corrected cameras of a run; none without the file. Throws an Error that names file,
/// camera and field for anything missing, of another type or out of range, and for a wrong
/// checksum.
std::vector<CorrectedCamera> load_corrected_cameras(const std::filesystem::path& run);

/// Returns the corrected cameras in the text of a file; errors begin with `who`.
std::vector<CorrectedCamera> parse_corrected_cameras(std::string_view text, const std::string& who);

} // namespace rye::trainer
