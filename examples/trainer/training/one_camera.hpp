// SPDX-License-Identifier: Apache-2.0
/// training/one_camera.hpp: settings of stage 2 for a capture of one camera. Depth is hardly seen
/// there: round Gaussians stretch along the line of sight, and show it from the side. Thin discs on
/// the surface, opaque from the beginning, do not. Measured: docs/results/evaluation.md.
#pragma once

#include <string>

#include "data/capture.hpp"
#include "data/config.hpp"

namespace rye::trainer {

/// Weights for what one camera does not see, the back and the sides of the head
/// (rye/train/face_smoothness.hpp). Neighbours alike cure its colours and cost nothing elsewhere;
/// alike sides gave nothing beyond them.
inline constexpr double one_camera_smooth = 1, one_camera_mirror = 0;

/// Sets gaussians.thickness and gaussians.opacity for a capture of one camera by the presets cpu and
/// gpu, unless the configuration names others, and with them the weights above, unless it names
/// some or splits Gaussians. Returns a sentence, or an empty text.
inline std::string flatten_for_one_camera(const Capture& capture, TrainConfig& config) {
    AvatarTrainConfig& g = config.gaussians;
    const bool chosen = g.thickness != 1 || g.opacity != AvatarTrainConfig{}.opacity;
    const bool follows = config.preset == "cpu" || config.preset == "gpu";
    if (capture.camera_count() != 1 || chosen || !follows) return {};
    g.thickness = 0.1;
    g.opacity = 0.9;
    AvatarLossConfig& w = g.weights;
    if (w.face_smooth == 0 && w.face_mirror == 0 && g.density.every == 0) {
        w.face_smooth = one_camera_smooth;
        w.face_mirror = one_camera_mirror;
    }
    return "one camera: the face begins as thin, opaque discs on its surface";
}

} // namespace rye::trainer
