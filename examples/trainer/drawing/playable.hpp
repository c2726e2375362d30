// SPDX-License-Identifier: Apache-2.0
/// drawing/playable.hpp: a trained run as an avatar for other programs: without optimiser, mesh
/// and capture.
#pragma once

#include <rye/avatar/playable.hpp>

#include "data/capture.hpp"
#include "model/run.hpp"

namespace rye::trainer {

/// Returns the ranges of the drivers in the capture's training frames, extended by those at rest.
DriverRanges<float> driver_ranges(const Capture& capture, GazeAxis axis,
                                  const Drivers<float>& rest);

/// Returns the avatar of a drawn state (run.hpp), with its light and driven eyes. Its neutral
/// drivers and its camera are those of this frame and camera of the capture; the ranges are those
/// of the capture's training frames, extended by the neutral drivers; the background is white.
/// Throws an Error for a run with another gaze mechanism than rotation.
PlayableAvatar<float> playable_avatar(const TrainState& state, const Capture& capture, int frame,
                                      int camera);

} // namespace rye::trainer
