// SPDX-License-Identifier: Apache-2.0
/// data/flaws.hpp: a copy of a capture with chosen errors, to measure their effect. Files without
/// errors are copied byte by byte; the copy appears complete or not at all, and its flaws.json
/// lists the errors. Units: data/flaw_draws.hpp.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "data/flaw_draws.hpp"

namespace rye::trainer {

/// Frames that get errors of a kind.
enum class FlawedFrames { train, all };

/// Arguments of `rye flaw`.
struct FlawOptions {
    std::filesystem::path capture, out;
    std::uint64_t seed = 0;
    FlawSizes sizes;
    double expression_share = 1;               ///< share of the coefficients that are wrong
    std::string one_camera;                    ///< the only one kept; empty: all
    FlawedFrames labels = FlawedFrames::train; ///< gazes, poses, cameras, masks, missing views
    FlawedFrames pictures = FlawedFrames::all; ///< light, blur, noise, JPEG
};

/// Result of write_flawed.
struct FlawReport {
    FlawSums sums;
    int label_frames = 0, picture_frames = 0; ///< frames that may have such errors
    int views = 0, views_left_out = 0;        ///< kept in the copy, and dropped from the capture
    std::string verdict;                      ///< of `rye info`

    /// Returns a line for each kind of error.
    std::string text(const FlawOptions& options) const;
};

/// Writes the copy. Throws an Error, with option and value or with the file, if --out exists, if
/// the capture is not valid or lacks the data that an error is for, or if the copy would not be
/// valid; leaves nothing in that case.
FlawReport write_flawed(const FlawOptions& options);

} // namespace rye::trainer
