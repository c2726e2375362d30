// SPDX-License-Identifier: Apache-2.0
/// tests/support/tiny_playable.hpp: the tiny avatar with all that showing it takes.
#pragma once

#include <rye/avatar/hold.hpp>
#include <rye/avatar/playable.hpp>

#include "effect_sets.hpp"

namespace rye::test {

/// Parts of the tiny avatar beside the paper's.
struct TinyParts {
    bool visual = false; ///< it has a kappa
    bool light = false, driven_eyes = false, highlights = false;
    bool irises = false; ///< its eyes have those, so that pupils move
    bool lid_shadow = false, refraction = false;
    int view_color = 0; ///< degree
};

inline PlayableAvatar<float> tiny_playable(const TinyParts& parts, int doublings = 1) {
    PlayableAvatar<float> p;
    p.name = "tiny \"one\"";
    p.config = tiny_config();
    p.config.gaze_near = 0.02;
    p.config.gaze_far = 0.06;
    p.roles = tiny_roles();
    Draw draw;
    TwoStream<double, TrainedEffects> avatar =
        restricted<TrainedEffects>(tiny_avatar(p.config, draw));
    UpsamplerShape shape;
    shape.in_channels = p.config.channels;
    shape.capacity = 2;
    shape.doublings = doublings;
    shape.norm = Normalization::none;
    shape.skip = true;
    avatar.upsampler = Upsampler<double>::init(shape, Random{6, 0});
    avatar.upsampler.out_weight = draw.columns(3, shape.capacity);
    if (parts.visual) avatar.eyes.kappa = Columns<double>::Constant(2, 2, 0.05);
    if (parts.light)
        avatar.shading = {draw.columns(8, 3, 0.5), draw.columns(3, avatar.face.position.cols()),
                          draw.columns(3, 2)};
    if (parts.driven_eyes) {
        const AppearanceSizes sizes =
            appearance_sizes<TrainedEffects>(p.config, avatar.eyes.position.cols());
        for (Mlp<double>& mlp : avatar.eyes.networks)
            mlp = Mlp<double>::init(DrivenFeatures::shape(sizes), Random{9, draw.next++});
    }
    if (parts.highlights || parts.refraction) set_tiny_lights(avatar.eyes.optics);
    if (!parts.highlights) resize_lights(avatar.eyes.optics, 0);
    if (!parts.refraction) avatar.eyes.optics.index = {};
    if (!parts.highlights && !parts.refraction) avatar.eyes.optics = {};
    if (parts.irises) set_tiny_irises(avatar.eyes);
    if (parts.lid_shadow) set_tiny_lids(avatar);
    if (parts.view_color > 0) set_tiny_view_colors(avatar, parts.view_color);
    p.avatar = lifted<float>(avatar);
    p.expression_names = {"jaw", "brow", "smile"};
    p.neutral = tiny_drivers<float>();
    p.ranges.expression_low = VecX<float>::Constant(3, -1);
    p.ranges.expression_high = VecX<float>::Constant(3, 1);
    p.ranges.gaze_low.setConstant(-0.4F);
    p.ranges.gaze_high.setConstant(0.4F);
    p.camera = tiny_camera(85, 69).cast<float>();
    p.background = VecX<float>::Constant(p.config.channels, 0.75F);
    return p;
}
inline PlayableAvatar<float> tiny_playable(bool visual = false, int doublings = 1) {
    return tiny_playable(TinyParts{.visual = visual}, doublings);
}

} // namespace rye::test
