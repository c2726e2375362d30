// SPDX-License-Identifier: Apache-2.0
/// data/samples.hpp: inputs of both stages from a capture, by the settings of a run. The work is
/// done in rye/train/capture_subject.hpp and rye/train/capture_samples.hpp.
#pragma once

#include <vector>

#include <rye/train/capture_samples.hpp>

#include "data/capture.hpp"
#include "data/config.hpp"

namespace rye::trainer {

using rye::frame_drivers;
using Subject = CaptureSubject;

/// Throws an Error if the capture lacks what training needs (gaze of every frame, training frames).
Subject describe_subject(const Capture& capture, const TrainConfig& config);

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
