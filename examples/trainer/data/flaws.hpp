// SPDX-License-Identifier: Apache-2.0
/// data/flaws.hpp: a copy of a capture with chosen errors put in, for measuring what they cost.
/// Files that no error touches are copied byte by byte; the copy appears whole or not at all, and
/// its flaws.json tells what was put in. Units: data/flaw_draws.hpp.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "data/flaw_draws.hpp"

namespace rye::trainer {

/// Frames that errors of a kind are put into.
enum class FlawedFrames { train, all };

/// Arguments of `rye flaw`.
struct FlawOptions {
    std::filesystem::path capture, out;
    std::uint64_t seed = 0;
    FlawSizes sizes;
    double expression_share = 1;               ///< of the coefficients that are off
    std::string one_camera;                    ///< the only one that stays; empty: all
    FlawedFrames labels = FlawedFrames::train; ///< gazes, poses, cameras, masks, missing views
    FlawedFrames pictures = FlawedFrames::all; ///< light, blur, noise, JPEG
};

/// What was put in.
struct FlawReport {
    FlawSums sums;
    int label_frames = 0, picture_frames = 0; ///< frames that such errors may be in
    int views = 0, views_left_out = 0;        ///< of the copy, and of the capture beyond it
    std::string verdict;                      ///< of `rye info`

    /// Returns a line for each kind that was put in.
    std::string text(const FlawOptions& options) const;
};

/// Writes the copy. Throws Error, with option and value or with the file, where --out is there, the
/// capture is not valid or lacks what an error is to be put into, or the copy would not be valid;
/// nothing is left in that case.
FlawReport write_flawed(const FlawOptions& options);

} // namespace rye::trainer
