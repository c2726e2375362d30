// SPDX-License-Identifier: Apache-2.0
/// data/validate.hpp: plausibility checks of a capture.
/// Infers units, axes and left and right from the data: a head is about 2 dm from jaw to brow, its
/// landmarks project into its masks, and its left eye is on its left.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "data/capture.hpp"

namespace rye::trainer {

/// Shares of the landmarks over a sample of the views.
struct LandmarkFit {
    int views = 0;            ///< number of views sampled
    double in_front = 0;      ///< of the camera
    double inside_image = 0;
    double inside_mask = 0;   ///< on pixels that are at least half subject
};

/// Diagonal of the box around the landmarks, median over the frames [world units].
double landmark_span(const Capture& capture);

/// Fit of the landmarks of lmk_3d to the masks. Skips views that cannot be decoded.
LandmarkFit fit_landmarks(const Capture& capture);

enum class ImagesToDecode { none, sample, all };

/// All faults of a capture; faults that recur are reported once, with their number.
std::vector<Problem> validate(const Capture& capture,
                              ImagesToDecode images = ImagesToDecode::sample);

/// Reads and validates. Throws Error with all errors; adds warnings to the list.
Capture read_valid_capture(const std::filesystem::path& folder, const CaptureOptions& options = {},
                           std::vector<Problem>* warnings = nullptr);

/// The same for one frame, from numbers alone: decodes no image.
Capture read_valid_frame(const CaptureContents& contents, const std::string& frame,
                         const std::vector<std::string>& cameras);

/// Missing data of a valid capture, in whole sentences, that training needs; rendering and
/// measuring work without. Each names the command that makes what is missing. Empty if it can be
/// trained on.
std::vector<std::string> training_faults(const Capture& capture);

/// Use of a capture; `rye info` prints it and `rye train` follows it.
struct Verdict {
    int errors = 0;                  ///< of reading and validation
    std::vector<std::string> lacks;  ///< training_faults, of a capture without errors
    std::vector<std::string> expect; ///< quality to expect of few cameras or frames
    bool trainable() const { return errors == 0 && lacks.empty(); }
    std::string text() const; ///< one line: "usable", or what is not
};

/// The verdict on a capture, given all problems that reading and validation found.
Verdict judge(const Capture& capture, const std::vector<Problem>& problems);

/// Reads, validates and judges; throws Error with the first fault unless it is trainable. Adds the
/// quality to expect to the list.
Capture read_trainable_capture(const std::filesystem::path& folder,
                               std::vector<std::string>* expect = nullptr);

} // namespace rye::trainer
