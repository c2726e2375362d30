// SPDX-License-Identifier: Apache-2.0
/// training/begun.hpp: start of a run at stage 2, with the stage 1 of another run.
#pragma once

#include <filesystem>

#include "model/run.hpp"

namespace rye::trainer {

/// Returns true if the folder holds a run whose stage 1 is complete; false for a file that cannot
/// be read. Reads the checkpoint's metadata alone.
bool has_stage_one(const std::filesystem::path& run);

/// Copies the guidance mesh at the end of stage 1 of `run` into `state`, whose configuration,
/// frames' mark and training frames are set. Throws an Error that names the run and the field if
/// the two differ in a field that stage 1 reads; also for another capture, and for a run in
/// stage 1.
void take_stage_one(const std::filesystem::path& run, TrainState& state);

} // namespace rye::trainer
