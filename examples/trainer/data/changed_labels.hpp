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

/// Changes of the labels of one frame, which are added.
struct LabelChange {
    std::string frame;
    /// (pitch, yaw) of both eyes, for optical and visual axes alike, so that kappa is unchanged
    /// [rad].
    std::array<Vec2<double>, 2> gaze{Vec2<double>::Zero(), Vec2<double>::Zero()};
    Vec<double, 6> pose = Vec<double, 6>::Zero(); ///< axis-angle [rad], translation [world unit]
    std::vector<double> expression;               ///< for every coefficient; empty for no change
    std::array<std::optional<Vec3<double>>, 2> centre; ///< replaces the eyeball's [world unit]
    /// Radius, radius of the limbus and distance of the iris of both eyeballs, of a frame without a
    /// centre [world unit].
    std::optional<std::array<Vec3<double>, 2>> sizes;
    std::optional<Rigid<double>> points; ///< moves landmarks and vertices in the world, if kept
};

/// Treatment of the head's points in the world: landmarks, vertices and eyeball centres.
enum class HeadPoints {
    moved, ///< with the head's pose, like points from a face model
    kept,  ///< unchanged, like measured points
};

/// Throws an Error unless `out` can become a capture made of `from`: a new or an empty folder that
/// is not below `from`.
void check_new_capture(const std::filesystem::path& from, const std::filesystem::path& out);

/// Returns the change from the labels of a frame to those of another, without landmarks and
/// vertices.
LabelChange change_between(const CaptureFrame& before, const CaptureFrame& after);

/// Changes of a copy beside the labels of its frames.
struct BesideLabels {
    /// Further files, by name; each is an object that gets its checksum.
    std::vector<std::pair<std::string, nlohmann::ordered_json>> records = {};
    std::vector<CorrectedCamera> cameras = {}; ///< replaced in files that have the wrong numbers
};

/// Copies the capture and changes the labels of these frames. The folder appears complete or not at
/// all.
void write_changed_capture(const std::filesystem::path& from, const std::filesystem::path& out,
                           const std::vector<LabelChange>& changes, HeadPoints points,
                           const BesideLabels& beside = {});

} // namespace rye::trainer
