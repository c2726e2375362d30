// SPDX-License-Identifier: Apache-2.0
/// training/compared.hpp: the avatar of a run whose gaze mechanism is not explicit rotation
/// (TrainConfig::gaze_mechanism), shaded or not. All of them are one type, so that a mechanism more
/// costs no compilation of the whole avatar; avatar_steps.cpp trains and drives it, device_compared_*.cu
/// train it on a device.
#pragma once

#include <rye/avatar/two_stream.hpp>
#include <rye/nn/adam.hpp>

#include "data/config.hpp"
#include "training/types.hpp"

namespace rye::trainer {

/// Parameters of such a run in stage 2, and their optimiser.
struct ComparedTraining {
    ComparedAvatar avatar;
    Adam<ComparedAvatar> adam;
};

/// A compared avatar that is `avatar` but for the configuration's mechanism and shading, whose
/// parameters are initialised; without points they have the shapes that do not depend on the number
/// of points. The normals of the face's Gaussians are 3 x N, or of none.
ComparedAvatar compared_avatar(const Avatar& avatar, const TrainConfig& config,
                               const Columns<float>& normals, const Random& random);

/// All of a compared avatar but its mechanism and shading. Its eyes have no features, so it is not driven.
Avatar without_mechanism(const ComparedAvatar& avatar);

/// The driven Gaussians; the drivers' gazes are optical axes.
TwoStreamGaussians<float> driven_compared(const ComparedAvatar& avatar, const AvatarConfig& config,
                                          const LandmarkRoles& roles,
                                          const Drivers<float>& drivers);

/// Error, beginning with `who`, unless the mechanism's parameters fit the eyes' points.
void require_mechanism_fits(const ComparedAvatar& avatar, int channels, const std::string& who);

} // namespace rye::trainer
