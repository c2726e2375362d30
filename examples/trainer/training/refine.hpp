// SPDX-License-Identifier: Apache-2.0
/// training/refine.hpp: labels of a capture's frames by their photographs and a trained avatar
/// (rye/train/refine_labels.hpp).
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <rye/avatar/playable.hpp>
#include <rye/train/refine_labels.hpp>

#include "data/capture.hpp"
#include "data/changed_labels.hpp"
#include "data/config.hpp"
#include "training/run.hpp"

namespace rye::trainer {

/// Which coefficients of the expression are refined.
enum class RefinedExpression { none, active, all };

struct RefineOptions {
    LabelUnknowns unknowns;   ///< but their expressions
    RefinedExpression expression = RefinedExpression::active;
    RefineSettings settings;
    int size = 256;           ///< largest side of the pictures that are compared [px]
    bool keep_gaze_mean = false; ///< the mean change of the gazes stays
    bool keep_pose_mean = false; ///< ... and that of the head poses
};

/// A frame and what was found of it.
struct RefinedFrame {
    int frame = 0;       ///< of the capture
    int views = 0;       ///< cameras that saw it
    RefinedLabels found; ///< its change is the one that is written, less the means
    bool outlier = false; ///< its residual is far from those of the other frames
};

/// What was found of all frames.
struct RefinedCapture {
    LabelUnknowns unknowns;
    std::vector<RefinedFrame> frames;
    VecX<double> mean;  ///< change that was taken off every frame; 0 where it is kept
    int block = 1;      ///< pixels of a photograph a pixel that is compared, squared
};

/// The avatar of a run that is drawn (run.hpp), by the gazes that its labels have. Throws Error for
/// a run by another gaze mechanism than rotation.
PlayableAvatar<float> refined_avatar(const TrainState& drawn, const Capture& capture);

/// Coefficients that differ between frames of the capture, all, or none.
std::vector<Index> refined_coefficients(const Capture& capture, RefinedExpression which);

/// Refines these frames; `told` is called after each. Throws Error naming the frame that cannot be
/// refined.
RefinedCapture refine_capture(const PlayableAvatar<float>& avatar, GazeAxis axis,
                              const Capture& capture, const std::vector<int>& frames,
                              const RefineOptions& options,
                              const std::function<void(const RefinedFrame&)>& told = {});

/// The changes of the labels.
std::vector<LabelChange> label_changes(const RefinedCapture& refined, const Capture& capture);

/// The fields of refine.json: docs/refine.md.
nlohmann::ordered_json refine_record(const RefinedCapture& refined, const Capture& capture,
                                     const RefineOptions& options);

} // namespace rye::trainer
