// SPDX-License-Identifier: Apache-2.0
/// commands/info_effects.hpp: report of the effects that a scene needs. A scene is a capture, with
/// or without a trained run; a PLY file of Gaussians; or a folder of photographs with a
/// transforms.json, which has no driven head.
#pragma once

#include <string>

#include <nlohmann/json.hpp>

namespace rye::trainer {

/// Inputs of the report; scene or run may be empty.
struct EffectsOptions {
    std::string scene;          ///< folder or PLY file
    std::string run;            ///< folder of a run
    std::string bound = "1/255";
    std::string variant;        ///< variant or effects to render with; empty: as the frames need
};

/// Returns the choice, one line per effect, and the difference of its renders from those of all
/// effects.
std::string explain_effects(const EffectsOptions& options);

/// Returns the report as JSON; docs/program.md has the schema.
nlohmann::ordered_json effects_json(const EffectsOptions& options);

} // namespace rye::trainer
