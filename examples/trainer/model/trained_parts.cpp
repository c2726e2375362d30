// SPDX-License-Identifier: Apache-2.0
#include "model/trained_parts.hpp"

namespace rye::trainer {

void begin_parts(Avatar& avatar, const TrainConfig& config, const Columns<float>& normals,
                 const Random& random) {
    if (config.gaze_mechanism != GazeMechanismName::rotation) return;
    const bool refined = config.gaussians.rates.delta_gaze > 0;
    if (config.gaze_axis == GazeAxis::visual || refined)
        avatar.eyes.kappa = Columns<float>::Zero(2, 2);
    if (refined) avatar.delta_gaze = Columns<float>::Zero(4, avatar.delta_pose.cols());
    const AppearanceSizes sizes =
        appearance_sizes<TrainEffects>(config.avatar, avatar.eyes.position.cols());
    if (config.eye_appearance == EyeAppearanceName::driven)
        avatar.eyes.networks = init_eye_appearance<DrivenFeatures, float>(sizes, random).networks;
    if (config.shading == ShadingName::head_pose) avatar.shading = initial_shading<float>(normals);
    if (config.view_color > 0)
        avatar.view_color = initial_view_colors<float>(
            config.view_color, avatar.face.position.cols(), avatar.eyes.position.cols());
}

void require_kappa_fits(const Avatar& avatar, const TrainConfig& config, const std::string& who) {
    const Columns<float>& kappa = avatar.eyes.kappa;
    if (config.gaze_axis == GazeAxis::optical && kappa.size() == 0) return;
    require(kappa.rows() == 2 && kappa.cols() == 2, who,
            "tensor 'avatar.eyes.kappa': got shape (" + std::to_string(kappa.cols()) + ", " +
                std::to_string(kappa.rows()) + "), expected (2, 2)");
    if (config.gaze_axis == GazeAxis::optical)
        require((kappa.array() == 0).all(), who,
                "tensor 'avatar.eyes.kappa': got an angle that is not 0, expected none: the run's "
                "gaze_axis is 'optical'");
}

} // namespace rye::trainer
