// SPDX-License-Identifier: Apache-2.0
/// training/density.hpp: rye/train/density.hpp for whichever avatar a run trains, and the most
/// Gaussians that its face can have.
#pragma once

#include <rye/train/density.hpp>

#include "training/run.hpp"

namespace rye::trainer {

/// The change of the state's face and its moments by gaussians.density, whether it is due or not.
/// Trainers that were made of the state must be made again.
DensityChange change_face(TrainState& state);

} // namespace rye::trainer
