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

/// About as many dense landmarks as Gaussian Head Avatar keeps (every 100th of 35,709 vertices).
inline constexpr int dense_landmarks = 358;

/// Properties of the subject from the whole capture.
struct Subject {
    LandmarkRoles roles;
    Columns<double> neutral;              ///< landmarks of the first training frame, canonical, 3 x L
    Vec3<double> head_centre;             ///< middle of the lattice, canonical
    std::array<Vec3<double>, 2> eye_centre;  ///< neutral, canonical
    std::array<double, 2> eye_radius, limbus_radius, iris_plane;  ///< canonical units
    bool measured_eyes = false;           ///< eye centres come from gaze.npz
};

/// Throws Error if the capture lacks what training needs (gaze of every frame, training frames).
Subject describe_subject(const Capture& capture, const TrainConfig& config);

/// An eye's gaze along the run's axis: unit, head frame.
Vec3<double> gaze_of(const CaptureEye& eye, GazeAxis axis);

/// Throws Error with the first frame that has no such gazes.
void require_gazes(const Capture& capture, GazeAxis axis);

Drivers<float> frame_drivers(const Capture& capture, int frame, GazeAxis axis);

/// The sparse landmarks and a selection of the dense vertices, in the order of Subject::neutral.
Columns<double> chosen_landmarks(const Columns<double>& landmarks, const Columns<double>& vertices);

/// Landmarks of a frame in the world, in the order of Subject::neutral.
Columns<double> frame_landmarks(const Capture& capture, int frame);
/// Replaces them, 3 x L in the world; vertices that are not chosen stay as they are.
void set_frame_landmarks(CaptureFrame& frame, const Columns<double>& landmarks);

/// Centres of both eyeballs of a frame relative to the neutral ones, canonical, 3 x 2: the target
/// of the eye offset; from gaze.npz, or from the centres of the landmarks around the eyes.
Columns<double> eye_displacement(const Capture& capture, const Subject& subject, int frame);

/// world -> canonical head frame of a frame: R^T (x - T) / S.
Columns<double> to_canonical(const CaptureFrame& frame, const Columns<double>& world);

/// image + (1 - mask) * background; both at full size.
Image<float> on_background(const Image<float>& image, const Image<float>& mask, float background);

/// Values of the columns and rows that extend an image.
enum class Border { repeated, zero };

/// The image with columns on the right and rows below until `factor` divides both sides: the last
/// ones repeated, or zeros. Original pixels are unchanged.
Image<float> extended(const Image<float>& image, int factor, Border border = Border::repeated);

/// Averages factor x factor blocks of the extended image.
Image<float> shrunk(const Image<float>& image, int factor, Border border = Border::repeated);

/// The camera of the extended image, `factor` times smaller: the same view, of whole blocks.
Pinhole<float> reduced(const Pinhole<float>& camera, int factor);

/// Images and drivers of one view for stage 2, on white.
AvatarSample<float> avatar_sample(const Capture& capture, const TrainConfig& config, int frame,
                                  int camera);

/// Images and drivers of one view for stage 1, over black.
MeshSample<float> mesh_sample(const Capture& capture, const Subject& subject,
                              const TrainConfig& config, int frame, const std::vector<int>& cameras);

} // namespace rye::trainer
