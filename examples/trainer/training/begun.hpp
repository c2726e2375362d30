// SPDX-License-Identifier: Apache-2.0
/// training/begun.hpp: stage 2 from the stage 1 of another run.
#pragma once

#include <filesystem>

#include "training/run.hpp"

namespace rye::trainer {

/// True if the folder holds a run whose stage 1 is complete. Reads the checkpoint's words alone;
/// false for a file that cannot be read.
bool has_stage_one(const std::filesystem::path& run);

/// Takes the guidance mesh that the stage 1 of `run` has ended with. Configuration, frames' mark
/// and training frames of `state` are set. Error that names the run and the field in which the two
/// differ, if stage 1 reads it; the same for another capture and for a run in stage 1.
void take_stage_one(const std::filesystem::path& run, TrainState& state);

} // namespace rye::trainer
