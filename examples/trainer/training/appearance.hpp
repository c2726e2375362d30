// SPDX-License-Identifier: Apache-2.0
/// training/appearance.hpp: the avatar of a run whose eyes' features are driven or whose head is
/// shaded (TrainConfig::eye_appearance, shading). Both and kappa are one type, compiled once: what
/// the configuration leaves off has no parameters, but for kappa, which stays 0 with optical axes.
#pragma once

#include <rye/avatar/two_stream.hpp>
#include <rye/nn/adam.hpp>

#include "data/config.hpp"
#include "training/types.hpp"

namespace rye::trainer {

/// Parameters of such a run in stage 2, and their optimiser.
struct AppearanceTraining {
    AppearanceAvatar avatar;
    Adam<AppearanceAvatar> adam;
};

/// True if a run of this configuration trains an AppearanceAvatar.
inline bool has_appearance(const TrainConfig& config) {
    return config.gaze_mechanism == GazeMechanismName::rotation &&
           (config.eye_appearance != EyeAppearanceName::free ||
            config.shading != ShadingName::none);
}

/// `avatar` with what the configuration has on, as a run begins: it looks as `avatar` does. The
/// normals of the face's Gaussians are 3 x N; of none for shapes alone, which do not depend on the
/// number of points.
AppearanceAvatar appearance_avatar(const Avatar& avatar, const TrainConfig& config,
                                   const Columns<float>& normals, const Random& random);

/// All of it but what paper effects cannot hold: eyes have their constants, nothing is shaded.
Avatar without_appearance(const AppearanceAvatar& avatar);

/// The driven Gaussians; gazes are of the axis that the avatar's kappa leads from.
TwoStreamGaussians<float> driven_appearance(const AppearanceAvatar& avatar,
                                            const AvatarConfig& config, const LandmarkRoles& roles,
                                            const Drivers<float>& drivers);

/// Error, beginning with `who`, unless the kappa fits the configuration.
void require_kappa_fits(const AppearanceAvatar& avatar, const TrainConfig& config,
                        const std::string& who);

} // namespace rye::trainer
