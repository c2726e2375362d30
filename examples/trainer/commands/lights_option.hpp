// SPDX-License-Identifier: Apache-2.0
/// commands/lights_option.hpp: --lights of commands that draw a run: other lights than those that
/// its eyes were trained under (corrections/lights.hpp).
#pragma once

#include "model/run.hpp"

namespace CLI {
class App;
}

namespace rye::trainer {

/// Adds --lights, a JSON file.
void add_lights(CLI::App& command, std::filesystem::path& lights);

/// Gives the run's avatar the lights of --lights; does nothing if it is empty. Throws an Error for
/// a file that cannot be used, and for an avatar without highlights.
void relight(TrainState& state, const std::filesystem::path& run,
             const std::filesystem::path& lights);

} // namespace rye::trainer
