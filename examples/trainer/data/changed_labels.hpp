// SPDX-License-Identifier: Apache-2.0
/// data/changed_labels.hpp: a copy of a capture with other labels: gazes, head poses, expressions.
#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <rye/core/columns.hpp>

#include "data/capture.hpp"

namespace rye::trainer {

/// What is added to the labels of one frame.
struct LabelChange {
    std::string frame;
    /// (pitch, yaw) of both eyes, optical and visual axes alike, so that kappa stays [rad].
    std::array<Vec2<double>, 2> gaze{Vec2<double>::Zero(), Vec2<double>::Zero()};
    Vec<double, 6> pose = Vec<double, 6>::Zero(); ///< axis-angle [rad], translation [world unit]
    std::vector<double> expression;               ///< of every coefficient; empty: none changes
    std::array<std::optional<Vec3<double>>, 2> centre; ///< instead of the eyeball's [world unit]
};

/// What lies in the world and belongs to the head: landmarks, vertices and eyeball centres.
enum class HeadPoints {
    moved, ///< with the head's pose, as those that a face model gave
    kept,  ///< where they are, as those that were measured
};

/// Throws Error unless `out` can become a capture made of `from`: it is not there, or an empty
/// folder, and not below `from`.
void check_new_capture(const std::filesystem::path& from, const std::filesystem::path& out);

/// What turns the labels of a frame into those of another: all but landmarks and vertices.
LabelChange change_between(const CaptureFrame& before, const CaptureFrame& after);

/// What a copy has beside the labels of its frames.
struct BesideLabels {
    /// Further files, by name, each an object that gets its checksum.
    std::vector<std::pair<std::string, nlohmann::ordered_json>> records = {};
    std::vector<CorrectedCamera> cameras = {}; ///< replaced where files have the wrong numbers
};

/// Copies the capture and changes the labels of these frames. The folder appears whole or not at
/// all.
void write_changed_capture(const std::filesystem::path& from, const std::filesystem::path& out,
                           const std::vector<LabelChange>& changes, HeadPoints points,
                           const BesideLabels& beside = {});

} // namespace rye::trainer
