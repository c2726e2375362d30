// SPDX-License-Identifier: Apache-2.0
#include "commands/lights_option.hpp"

#include <CLI/CLI.hpp>

#include "corrections/lights.hpp"

namespace rye::trainer {

void add_lights(CLI::App& command, std::filesystem::path& lights) {
    command.add_option(
        "--lights", lights,
        "JSON file of lights whose highlights the eyes show instead of their own: "
        "what `rye info --json` prints of another capture or run, or a list of "
        "{\"to\": [X, Y, Z], \"intensity\": [R, G, B], \"width\": RADIANS}, \"to\" a direction "
        "of the world, or \"position\" a point of it");
}

void relight(TrainState& state, const std::filesystem::path& run,
             const std::filesystem::path& lights) {
    if (lights.empty()) return;
    const FoundLights others = read_lights(lights);
    require(state.avatar.eyes.optics.lights() > 0, run.string(),
            "has no highlights, so --lights changes nothing; expected a run that was trained with "
            "{\"avatar\": {\"highlights\": true}} and found lights");
    replace_lights(state.avatar, others);
}

} // namespace rye::trainer
