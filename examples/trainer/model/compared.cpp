// SPDX-License-Identifier: Apache-2.0
#include "model/compared.hpp"

#include <rye/avatar/hold.hpp>

namespace rye::trainer {
namespace {

template <class A>
void hold(ComparedAvatar& avatar, int channels, const Random& random) {
    using P = typename A::template Parameters<float>;
    avatar.eyes.appearance().held =
        A::template init<P>(channels, avatar.eyes.position.cols(), random);
}

} // namespace

ComparedAvatar compared_avatar(const Avatar& avatar, const TrainConfig& config,
                               const Columns<float>& normals, const Random& random) {
    ComparedAvatar c = restricted<ComparedEffects>(avatar);
    if (config.shading == ShadingName::head_pose) c.shading = initial_shading<float>(normals);
    const int channels = config.avatar.channels;
    using Name = GazeMechanismName;
    switch (config.gaze_mechanism) {
        case Name::learned_quaternion:
            c.eyes.mechanism().held =
                LearnedQuaternion::init<LearnedQuaternion::Parameters<float>>(channels, random);
            [[fallthrough]];
        case Name::none:
            hold<FreeFeatures>(c, channels, random);
            break;
        case Name::feature_rotation:
            hold<RotatedFeatures>(c, channels, random);
            break;
        case Name::condition:
            hold<ConditionedFeatures>(c, channels, random);
            break;
        case Name::latent_rotation:
            hold<RotatedCode>(c, channels, random);
            break;
        case Name::rotation:
            throw Error("compared_avatar: explicit rotation is the default avatar's");
    }
    return c;
}

Avatar without_mechanism(const ComparedAvatar& avatar) { return restricted<TrainEffects>(avatar); }

void require_mechanism_fits(const ComparedAvatar& avatar, int channels, const std::string& who) {
    const Index points = avatar.eyes.position.cols();
    const auto agree = [&](const char* name, const Columns<float>& a, Index rows, Index cols) {
        require(a.rows() == rows && a.cols() == cols, who,
                std::string("tensor 'avatar.eyes.") + name + "': got shape (" +
                    std::to_string(a.cols()) + ", " + std::to_string(a.rows()) + "), expected (" +
                    std::to_string(cols) + ", " + std::to_string(rows) + ")");
    };
    const auto& held = avatar.eyes.appearance().held;
    if (const auto* p = std::get_if<FreeFeatures::Parameters<float>>(&held))
        agree("feature", p->feature, channels, points);
    if (const auto* p = std::get_if<RotatedFeatures::Parameters<float>>(&held))
        agree("latent", p->latent, RotatedFeatures::latent_size, points);
    if (const auto* p = std::get_if<ConditionedFeatures::Parameters<float>>(&held))
        agree("latent", p->latent, ConditionedFeatures::latent_size, points);
    if (const auto* p = std::get_if<RotatedCode::Parameters<float>>(&held))
        agree("latent", p->latent, RotatedCode::latent_size, 2);
}

TwoStreamGaussians<float> driven_compared(const ComparedAvatar& avatar, const AvatarConfig& config,
                                          const LandmarkRoles& roles,
                                          const Drivers<float, TrainEffects>& drivers) {
    TwoStreamTrace<float, ComparedEffects> trace;
    drive(train_backend(), avatar, {config, roles, restricted<ComparedEffects>(drivers)}, trace);
    return trace;
}

} // namespace rye::trainer
