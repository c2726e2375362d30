// SPDX-License-Identifier: Apache-2.0
/// commands/info_effects.hpp: which effects a scene calls for, in words. A scene is a
/// capture, with a trained run or without; a PLY file of Gaussians; or a folder of photographs with
/// a transforms.json, which holds no head that is driven.
#pragma once

#include <string>

namespace rye::trainer {

/// Where the facts are looked for; either may be empty.
struct EffectsOptions {
    std::string scene;          ///< folder or PLY file
    std::string run;            ///< of a training
    std::string bound = "1/255";
    std::string variant;        ///< that a run is drawn by, or effects; empty: as its frames call for
};

/// The choice, a line an effect, and a picture by the choice against one by all effects.
std::string explain_effects(const EffectsOptions& options);

} // namespace rye::trainer
