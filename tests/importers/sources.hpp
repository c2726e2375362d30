// SPDX-License-Identifier: Apache-2.0
/// tests/importers/sources.hpp: sources for `rye import`, written in the layout of each program
/// from a synthetic capture, whose gaze, landmarks, masks and eye masks are the truth that an
/// import is compared with; labels may have the errors of trackers.
#pragma once

#include <filesystem>
#include <string>

#include "data/capture.hpp"
#include "data/flaw_draws.hpp"
#include "synthetic_capture/scene.hpp"

namespace rye::trainer {

/// A head, its capture with right labels, and what a tracker says of the same pictures.
struct TrueScene {
    HeadModel model;
    Capture capture;
    Capture tracked; ///< the same frames and pictures; labels of training frames may be wrong
};

/// Renders a procedural head into `folder`, a new one; its tracker makes no error.
TrueScene true_scene(const std::filesystem::path& folder, const CaptureSettings& settings);

/// Reads a capture that `rye capture` wrote; model: the file of its head, none for rye's own.
/// Throws an Error if the model does not have the capture's landmarks.
TrueScene captured_scene(const std::filesystem::path& folder, const std::filesystem::path& model);

/// Errors of trackers, as `rye flaw` puts them into training frames: gazes 4 degrees (both eyes
/// alike) and 2 (each), centres of eyeballs 1.2 mm, half of the expression coefficients 0.06, head
/// poses 0.6 degrees and 1 mm, landmarks 1.5 mm; of stills, whose labels are cameras, rotations 0.5
/// degrees and focal lengths 1 %.
FlawSizes tracker_errors(bool stills);

/// Replaces `tracked` by a copy of the capture with these errors in `folder`, a new one.
void track(TrueScene& truth, const std::filesystem::path& folder, const FlawSizes& errors,
           std::uint64_t seed);

/// A folder as VHAP exports it twice, with parameters and with meshes: FLAME's topology (5143
/// vertices with teeth), filled by vertices of the head; metres; photographs over white. Meshes
/// follow expression, pose and centres of the tracker, as those of a face model do; its errors of
/// landmarks displace their vertices.
void write_vhap_source(const TrueScene& truth, const std::filesystem::path& out);

/// Writes a CSV of the tracker's gazes, for `rye import gha --gaze`.
void write_gazes(const TrueScene& truth, const std::filesystem::path& file);

/// A folder as Gaussian Head Avatar prepares it: JPEGs with halves, `visible`, no gaze, no eye
/// masks; lengths times `unit`.
void write_gha_source(const TrueScene& truth, const std::filesystem::path& out, double unit);

/// The first frame as a still scene: photographs with a lens (k1, k2, p1, p2) or none and a
/// transforms.json.
void write_transforms_source(const TrueScene& truth, const std::filesystem::path& out, bool lens);

/// The first frame as one of Blender's data sets: transforms_train.json, _val and _test, a camera
/// each, with camera_angle_x; RGBA pictures without background, all of one name, which the lists
/// have without ending. All of the first camera's focal length and a principal point in the middle.
void write_blender_source(const TrueScene& truth, const std::filesystem::path& out);

enum class ColmapFiles { binary, text };
/// The same as a COLMAP model (sparse/0) with pictures; the camera model is OPENCV with a lens,
/// PINHOLE without.
void write_colmap_source(const TrueScene& truth, const std::filesystem::path& out,
                         ColmapFiles files, bool lens);

enum class XgazeFields { normalization, gazenerf };
/// An HDF5 file of patches of all frames and cameras: of ETH-XGaze's normalisation, with the
/// calibration of the cameras in `calibration`; or with GazeNeRF's fields.
void write_xgaze_source(const TrueScene& truth, const std::filesystem::path& file,
                        const std::filesystem::path& calibration, XgazeFields fields);

/// All 68 landmarks of a frame, of which a Capture keeps 66; 3 x 68, world.
Columns<double> true_landmarks(const Capture& capture, const std::string& frame);

/// Gazes of test frames.
enum class TestGazes {
    imported, ///< as the source states them, without errors
    true_axes ///< optical axes, where the import estimated them
};

/// Copies an import with true eyeballs and eye masks in its test frames, which then measure avatars
/// that were trained on the import. Throws an Error if its test frames are not the true capture's.
void write_test_labels(const Capture& truth, const Capture& import, TestGazes gazes,
                       const std::filesystem::path& out);

/// The lens of the sources with one.
BrownConrady<double> source_lens();

} // namespace rye::trainer
