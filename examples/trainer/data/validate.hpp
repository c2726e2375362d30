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

/// Returns the diagonal of the box around the landmarks, median over the frames [world units].
double landmark_span(const Capture& capture);

/// Returns the fit of the landmarks of lmk_3d to the masks. Skips views that cannot be decoded.
LandmarkFit fit_landmarks(const Capture& capture);

enum class ImagesToDecode { none, sample, all };

/// Returns all faults of a capture; recurring faults are reported once, with their number.
std::vector<Problem> validate(const Capture& capture,
                              ImagesToDecode images = ImagesToDecode::sample);

/// Reads and validates. Throws an Error with all errors; adds warnings to the list.
Capture read_valid_capture(const std::filesystem::path& folder, const CaptureOptions& options = {},
                           std::vector<Problem>* warnings = nullptr);

/// Reads and validates one frame, from numbers alone: decodes no image.
Capture read_valid_frame(const CaptureContents& contents, const std::string& frame,
                         const std::vector<std::string>& cameras);

/// Returns the data that training needs and a valid capture lacks, in whole sentences; rendering
/// and measuring work without. Each sentence names the command that makes the data. Empty if the
/// capture can be trained on.
std::vector<std::string> training_faults(const Capture& capture);

/// Verdict on a capture; `rye info` prints it and `rye train` follows it.
struct Verdict {
    int errors = 0;                  ///< of reading and validation
    std::vector<std::string> lacks;  ///< training_faults of a capture without errors
    std::vector<std::string> expect; ///< quality to expect of few cameras or frames
    bool trainable() const { return errors == 0 && lacks.empty(); }
    std::string text() const; ///< one line: "usable", or the reasons why not
};

/// Returns the verdict on a capture, given all problems that reading and validation found.
Verdict judge(const Capture& capture, const std::vector<Problem>& problems);

/// Reads, validates and judges; throws an Error with the first fault unless it is trainable. Adds
/// the quality to expect to the list.
Capture read_trainable_capture(const std::filesystem::path& folder,
                               std::vector<std::string>* expect = nullptr);

} // namespace rye::trainer
