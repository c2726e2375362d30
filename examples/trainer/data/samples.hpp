// SPDX-License-Identifier: Apache-2.0
/// data/samples.hpp: inputs of both stages from a capture: drivers, landmarks and their roles,
/// eyeballs, and samples of one view.
#pragma once

#include <array>

#include <rye/avatar/weights.hpp>
#include <rye/train/samples.hpp>

#include "data/capture.hpp"
#include "data/config.hpp"
#include "data/eye_shapes.hpp"

namespace rye::trainer {

/// Number of dense landmarks, about as many as Gaussian Head Avatar keeps (every 100th of 35,709
/// vertices).
inline constexpr int dense_landmarks = 358;

/// Properties of the subject from the whole capture.
struct Subject {
    LandmarkRoles roles;
    Columns<double> neutral;              ///< landmarks of the first training frame, canonical, 3 x L
    Vec3<double> head_centre;             ///< middle of the lattice, canonical
    std::array<Vec3<double>, 2> eye_centre;  ///< neutral, canonical
    std::array<double, 2> eye_radius, limbus_radius, iris_plane;  ///< canonical units
    bool measured_eyes = false;           ///< true if eye centres come from gaze.npz
};

/// Returns the subject; throws an Error if the capture lacks what training needs (gaze of every
/// frame, training frames).
Subject describe_subject(const Capture& capture, const TrainConfig& config);

/// Returns an eye's gaze along the run's axis: unit, head frame.
Vec3<double> gaze_of(const CaptureEye& eye, GazeAxis axis);

/// Throws an Error with the first frame that has no such gazes.
void require_gazes(const Capture& capture, GazeAxis axis);

Drivers<float> frame_drivers(const Capture& capture, int frame, GazeAxis axis);

/// Returns the sparse landmarks and a selection of the dense vertices, in the order of
/// Subject::neutral.
Columns<double> chosen_landmarks(const Columns<double>& landmarks, const Columns<double>& vertices);

/// Returns the landmarks of a frame in the world, in the order of Subject::neutral.
Columns<double> frame_landmarks(const Capture& capture, int frame);
/// Replaces the landmarks of a frame, 3 x L in the world; other vertices are unchanged.
void set_frame_landmarks(CaptureFrame& frame, const Columns<double>& landmarks);

/// Returns the centres of both eyeballs of a frame relative to the neutral ones, canonical, 3 x 2:
/// the target of the eye offset; from gaze.npz, or from the centres of the landmarks around the
/// eyes.
Columns<double> eye_displacement(const Capture& capture, const Subject& subject, int frame);

/// Returns world points in a frame's canonical head frame: R^T (x - T) / S.
Columns<double> to_canonical(const CaptureFrame& frame, const Columns<double>& world);

/// Returns image + (1 - mask) * background; both at full size.
Image<float> on_background(const Image<float>& image, const Image<float>& mask, float background);

/// Values of the columns and rows that extend an image.
enum class Border { repeated, zero };

/// Returns the image with columns on the right and rows below added until `factor` divides both
/// sides: repetitions of the last ones, or zeros. Original pixels are unchanged.
Image<float> extended(const Image<float>& image, int factor, Border border = Border::repeated);

/// Returns the averages of the extended image's factor x factor blocks.
Image<float> shrunk(const Image<float>& image, int factor, Border border = Border::repeated);

/// Returns the camera of the extended image, `factor` times smaller: the same view, of whole
/// blocks.
Pinhole<float> reduced(const Pinhole<float>& camera, int factor);

/// Returns the images and drivers of one view for stage 2, on white.
AvatarSample<float> avatar_sample(const Capture& capture, const TrainConfig& config, int frame,
                                  int camera);

/// Returns the images and drivers of some views of a frame for stage 1, over black.
MeshSample<float> mesh_sample(const Capture& capture, const Subject& subject,
                              const TrainConfig& config, int frame, const std::vector<int>& cameras);

} // namespace rye::trainer
