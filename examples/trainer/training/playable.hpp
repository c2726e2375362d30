// SPDX-License-Identifier: Apache-2.0
/// training/playable.hpp: a trained run as an avatar that other programs show: without optimiser,
/// mesh and capture.
#pragma once

#include <rye/avatar/playable.hpp>

#include "data/capture.hpp"
#include "training/run.hpp"

namespace rye::trainer {

/// The avatar of a state that is drawn (run.hpp), with its light and driven eyes. Its neutral
/// drivers and its camera are those of this frame and camera of the capture; the ranges are those
/// of the capture's training frames, which the neutral drivers extend; the background is white.
/// Throws Error for a run by another gaze mechanism than rotation.
PlayableAvatar<float> playable_avatar(const TrainState& state, const Capture& capture, int frame,
                                      int camera);

} // namespace rye::trainer
