// SPDX-License-Identifier: Apache-2.0
#include "training/appearance.hpp"

#include <rye/avatar/hold.hpp>

namespace rye::trainer {

AppearanceAvatar appearance_avatar(const Avatar& avatar, const TrainConfig& config,
                                   const Columns<float>& normals, const Random& random) {
    AppearanceAvatar a = restricted<AppearanceEffects>(avatar);
    a.eyes.kappa = Columns<float>::Zero(2, 2);
    const AppearanceSizes sizes =
        appearance_sizes<AppearanceEffects>(config.avatar, avatar.eyes.position.cols());
    if (config.eye_appearance == EyeAppearanceName::driven)
        a.eyes.networks = init_eye_appearance<DrivenFeatures, float>(sizes, random).networks;
    if (config.shading == ShadingName::head_pose) a.shading = initial_shading<float>(normals);
    return a;
}

Avatar without_appearance(const AppearanceAvatar& avatar) {
    return restricted<TrainEffects>(avatar);
}

TwoStreamGaussians<float> driven_appearance(const AppearanceAvatar& avatar,
                                            const AvatarConfig& config, const LandmarkRoles& roles,
                                            const Drivers<float>& drivers) {
    TwoStreamTrace<float, AppearanceEffects> trace;
    drive(train_backend(), avatar, {config, roles, restricted<AppearanceEffects>(drivers)}, trace);
    return trace;
}

void require_kappa_fits(const AppearanceAvatar& avatar, const TrainConfig& config,
                        const std::string& who) {
    const Columns<float>& kappa = avatar.eyes.kappa;
    require(kappa.rows() == 2 && kappa.cols() == 2, who,
            "tensor 'avatar.eyes.kappa': got shape (" + std::to_string(kappa.cols()) + ", " +
                std::to_string(kappa.rows()) + "), expected (2, 2)");
    if (config.gaze_axis == GazeAxis::optical)
        require((kappa.array() == 0).all(), who,
                "tensor 'avatar.eyes.kappa': got an angle that is not 0, expected none: the run's "
                "gaze_axis is 'optical'");
}

} // namespace rye::trainer
