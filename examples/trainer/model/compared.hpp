// SPDX-License-Identifier: Apache-2.0
/// model/compared.hpp: the avatar of a run whose gaze mechanism is not explicit rotation
/// (TrainConfig::gaze_mechanism), shaded or not. All mechanisms are one type, so that another one
/// does not compile the whole avatar again; avatar_steps.cpp trains and drives it,
/// device/compared_*.cu train it on a device.
#pragma once

#include <rye/avatar/two_stream.hpp>
#include <rye/nn/adam.hpp>

#include "data/config.hpp"
#include "model/types.hpp"

namespace rye::trainer {

/// Parameters of such a run in stage 2, with their optimiser.
struct ComparedTraining {
    ComparedAvatar avatar;
    Adam<ComparedAvatar> adam;
};

/// Returns a compared avatar that is `avatar` except for the configuration's mechanism and shading,
/// whose parameters are initialised. Without points, it has only the shapes that do not depend on
/// their number. normals: of the face's Gaussians, 3 x N, or empty.
ComparedAvatar compared_avatar(const Avatar& avatar, const TrainConfig& config,
                               const Columns<float>& normals, const Random& random);

/// Returns a compared avatar without its mechanism and shading. Its eyes have no features, so it
/// cannot be driven.
Avatar without_mechanism(const ComparedAvatar& avatar);

/// Returns the driven Gaussians; the drivers' gazes are optical axes.
TwoStreamGaussians<float> driven_compared(const ComparedAvatar& avatar, const AvatarConfig& config,
                                          const LandmarkRoles& roles,
                                          const Drivers<float, TrainEffects>& drivers);

/// Throws an Error that begins with `who` unless the mechanism's parameters fit the eyes' points.
void require_mechanism_fits(const ComparedAvatar& avatar, int channels, const std::string& who);

} // namespace rye::trainer
