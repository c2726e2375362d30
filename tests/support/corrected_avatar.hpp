// SPDX-License-Identifier: Apache-2.0
// An avatar with corrections of labels, for the tests of their training.
#pragma once

#include <rye/avatar/hold.hpp>
#include <rye/avatar/trained.hpp>
#include <rye/train/avatar_trainer.hpp>

#include "tiny_sample.hpp"

namespace rye::test {

constexpr Index corrected_cameras = 3;

/// The tiny avatar with driven eyes, kappa, and a correction for each of its frames and of three
/// cameras.
inline TrainedAvatar<double> corrected_avatar() {
    Draw draw{{3, 3}};
    TrainedAvatar<double> a = restricted<TrainedEffects>(tiny_avatar(tiny_config(), draw));
    a.eyes.kappa = Columns<double>::Constant(2, 2, 0.03);
    a.delta_gaze = draw.columns(4, a.delta_pose.cols(), 0.05);
    const AppearanceSizes sizes =
        appearance_sizes<TrainedEffects>(tiny_config(), a.eyes.position.cols());
    for (Mlp<double>& mlp : a.eyes.networks)
        mlp = Mlp<double>::init(DrivenFeatures::shape(sizes), Random{9, draw.next++});
    a.delta_view = draw.columns(6, corrected_cameras, 0.05);
    return a;
}

inline AvatarTraining<> training_of_corrections() {
    AvatarTraining<> t;
    t.config = tiny_config();
    t.roles = tiny_roles();
    t.objective.weights.eye_smooth = 0;
    t.view_directions.resize(3, corrected_cameras);
    t.view_directions << -0.6, 0, 0.8, 0, 0.6, 0, 0.8, 0.8, 0.6;
    return t;
}

/// The same that trains nothing, by terms that the true labels make smallest; those of the blank and
/// of the eyes alone ask the face and the eyes for more, where all of the picture counts as eyes.
inline AvatarTraining<> training_of_nothing() {
    AvatarTraining<> t = training_of_corrections();
    AvatarLossConfig& w = t.objective.weights;
    w.dssim = w.blank = w.eye_low = w.eye_high = 0;
    for (double* r : {&t.rates.upsampler, &t.rates.networks, &t.rates.opacity, &t.rates.scale,
                      &t.rates.position, &t.rates.feature, &t.rates.rotation, &t.rates.delta_pose,
                      &t.rates.eye_feature, &t.rates.eye_offset, &t.rates.kappa, &t.rates.shading,
                      &t.rates.deform})
        *r = 0;
    return t;
}

/// Draws the sample's pictures by the avatar, driven by the sample's labels.
inline void draw_truth(const TrainedAvatar<double>& avatar,
                       AvatarSample<double, TrainedEffects>& s) {
    const ScalarBackend<Serial> backend;
    TwoStreamTrace<double, TrainedEffects> trace;
    drive(backend, avatar, {tiny_config(), tiny_roles(), s.drivers}, trace);
    const VecX<double> white = s.background;
    const auto small = Rasterizer<FeaturesOnly<Balanced>>{}
                           .forward(backend, trace.gaussians, s.camera, white)
                           .feature;
    s.truth_small = Image<double>(small.width, small.height, 3);
    s.truth_small.pixels = small.pixels.topRows(3);
    s.visible_small = s.mask_small = s.eyes_small = Columns<double>::Ones(1, s.truth_small.size());
    s.truth = upsampler_forward(backend, avatar.upsampler, small, nullptr);
    s.visible = s.eyes = Columns<double>::Ones(1, s.truth.size());
    s.scale = {};
}

} // namespace rye::test
