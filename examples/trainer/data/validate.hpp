// SPDX-License-Identifier: Apache-2.0
/// data/validate.hpp: is this capture what it claims to be?
/// Units, axes and left and right are inferred from the numbers themselves: a head is about 2 dm
/// from jaw to brow, its landmarks project into its masks, and its left eye is on its left.
#pragma once

#include <filesystem>
#include <vector>

#include "data/capture.hpp"

namespace rye::trainer {

/// Shares of the landmarks over a sample of the views.
struct LandmarkFit {
    int views = 0;            ///< how many were looked at
    double in_front = 0;      ///< of the camera
    double inside_image = 0;
    double inside_mask = 0;   ///< on pixels that are at least half subject
};

/// Diagonal of the box around the landmarks, median over the frames [world units].
double landmark_span(const Capture& capture);

/// How the landmarks of lmk_3d fall into the masks. Views that cannot be decoded are left out.
LandmarkFit fit_landmarks(const Capture& capture);

enum class ImagesToDecode { none, sample, all };

/// Everything found wrong with what was read; faults that recur are told once, with their number.
std::vector<Problem> validate(const Capture& capture,
                              ImagesToDecode images = ImagesToDecode::sample);

/// Reads and validates. An Error lists all that is wrong; warnings are added to the list.
Capture read_valid_capture(const std::filesystem::path& folder, const CaptureOptions& options = {},
                           std::vector<Problem>* warnings = nullptr);

/// The same of one frame, by its numbers alone: no picture is decoded.
Capture read_valid_frame(const CaptureContents& contents, const std::string& frame,
                         const std::vector<std::string>& cameras);

/// What a sound capture still lacks to be trained on, in whole sentences; drawing and measuring do
/// without it. Empty if training can begin.
std::vector<std::string> training_faults(const Capture& capture);

/// Error with the first of them.
void require_trainable(const Capture& capture);

} // namespace rye::trainer
