// SPDX-License-Identifier: Apache-2.0
/// tests/programs/tiny_run.hpp: a run of random numbers in stage 2, in which every network affects
/// the image.
#pragma once

#include "../support/tiny_avatar.hpp"
#include "model/run.hpp"

namespace rye::trainer {

TrainState tiny_state();

/// Returns a picture of a grey and a white half, all of it eyes, to train such a state on.
AvatarSample<float> small_sample(const TrainState& state);

} // namespace rye::trainer
