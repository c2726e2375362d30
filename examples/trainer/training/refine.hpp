// SPDX-License-Identifier: Apache-2.0
/// training/refine.hpp: refinement of the labels of a capture's frames by their photographs and a
/// trained avatar (rye/train/refine_labels.hpp).
#pragma once

#include <array>
#include <functional>
#include <string>
#include <vector>

#include <rye/avatar/playable.hpp>
#include <rye/train/refine_labels.hpp>

#include "data/capture.hpp"
#include "data/changed_labels.hpp"
#include "data/config.hpp"
#include "device/device.hpp"
#include "model/run.hpp"

namespace rye::trainer {

/// Coefficients of the expression that are refined.
enum class RefinedExpression { none, active, all };

struct RefineOptions {
    LabelUnknowns unknowns;   ///< without their expressions
    RefinedExpression expression = RefinedExpression::none;
    RefineSettings settings;
    int size = 256;           ///< largest side of the compared pictures [px]
    DeviceLabels* device = nullptr; ///< draws the pictures; null: the CPU
    bool keep_gaze_mean = false; ///< true: keeps the mean change of the gazes
    bool keep_pose_mean = false; ///< true: keeps the mean change of the head poses
};

/// Result of a frame.
struct RefinedFrame {
    int frame = 0;       ///< of the capture
    int views = 0;       ///< cameras that saw the frame
    RefinedLabels found; ///< its change is the one written, without the means
    bool outlier = false; ///< true if its residual is far from the other frames'
    std::array<bool, 2> closed{}; ///< eyes that no picture shows, so that none tells their gazes
};

/// Result of all frames.
struct RefinedCapture {
    LabelUnknowns unknowns;
    std::vector<RefinedFrame> frames;
    VecX<double> mean;  ///< change subtracted from every frame; 0 for parts that keep it
    int block = 1;      ///< side of the block of a photograph's pixels that are compared as one
};

/// Returns the avatar of a drawn run (run.hpp), with the labels' kind of gazes. Throws an Error for
/// a run with another gaze mechanism than rotation.
PlayableAvatar<float> refined_avatar(const TrainState& drawn, const Capture& capture);

/// Returns the coefficients that differ between frames of the capture, all, or none.
std::vector<Index> refined_coefficients(const Capture& capture, RefinedExpression which);

/// Refines these frames; calls `told` after each. Gazes of closed eyes get what all labels are off by
/// alone. Throws an Error that names the frame that cannot
/// be refined.
RefinedCapture refine_capture(const PlayableAvatar<float>& avatar, GazeAxis axis,
                              const Capture& capture, const std::vector<int>& frames,
                              const RefineOptions& options,
                              const std::function<void(const RefinedFrame&)>& told = {});

/// Returns the changes of the labels.
std::vector<LabelChange> label_changes(const RefinedCapture& refined, const Capture& capture);

/// Returns the fields of refine.json: docs/refine.md.
nlohmann::ordered_json refine_record(const RefinedCapture& refined, const Capture& capture,
                                     const RefineOptions& options);

} // namespace rye::trainer
