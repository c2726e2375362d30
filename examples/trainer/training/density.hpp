// SPDX-License-Identifier: Apache-2.0
/// training/density.hpp: rye/train/density.hpp for any avatar of a run.
#pragma once

#include <rye/train/density.hpp>

#include "model/run.hpp"

namespace rye::trainer {

/// Changes the state's face and its moments by gaussians.density, whether a change is due or not.
/// Trainers made of the state must be made again.
DensityChange change_face(TrainState& state);

} // namespace rye::trainer
