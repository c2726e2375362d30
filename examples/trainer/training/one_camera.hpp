// SPDX-License-Identifier: Apache-2.0
/// training/one_camera.hpp: settings of stage 2 for a capture of one camera. Depth is hardly seen
/// there: round Gaussians stretch along the line of sight, and show it from the side. Thin discs on
/// the surface, opaque from the beginning, do not. Measured: docs/results/evaluation.md.
#pragma once

#include <string>

#include "data/capture.hpp"
#include "data/config.hpp"

namespace rye::trainer {

/// Sets gaussians.thickness and gaussians.opacity for a capture of one camera by the presets cpu and
/// gpu, unless the configuration names others. Returns a sentence, or an empty text.
inline std::string flatten_for_one_camera(const Capture& capture, TrainConfig& config) {
    AvatarTrainConfig& g = config.gaussians;
    const bool chosen = g.thickness != 1 || g.opacity != AvatarTrainConfig{}.opacity;
    const bool follows = config.preset == "cpu" || config.preset == "gpu";
    if (capture.camera_count() != 1 || chosen || !follows) return {};
    g.thickness = 0.1;
    g.opacity = 0.9;
    return "one camera: the face begins as thin, opaque discs on its surface";
}

} // namespace rye::trainer
