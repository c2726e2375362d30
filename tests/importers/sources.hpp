// SPDX-License-Identifier: Apache-2.0
/// tests/importers/sources.hpp: small sources for `rye import`, written in the layout of each
/// program from a synthetic capture, whose gaze, landmarks, masks and eye masks are the truth that
/// an import is compared with.
#pragma once

#include <filesystem>
#include <string>

#include "data/capture.hpp"
#include "synthetic_capture/scene.hpp"

namespace rye::trainer {

/// A synthetic scene and its capture.
struct TrueScene {
    HeadModel model;
    CaptureScene scene;
    Capture capture;
};

/// Renders a scene into `folder`, a new one.
TrueScene true_scene(const std::filesystem::path& folder, const CaptureSettings& settings);

/// A folder as VHAP exports it twice, with parameters and with meshes: FLAME's topology (5143
/// vertices with teeth), filled by vertices of the synthetic head; metres; photographs over white.
void write_vhap_source(const TrueScene& truth, const std::filesystem::path& out);

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

/// The lens of the sources with one.
BrownConrady<double> source_lens();

} // namespace rye::trainer
