// SPDX-License-Identifier: Apache-2.0
/// training/avatar_steps.hpp: a step of stage 2 for an avatar of any effects. Each list of
/// effects that is trained has a source of its own, since it compiles the whole step once more:
/// steps.cpp the paper's, steps_visual.cpp that of lines of sight.
#pragma once

#include <memory>
#include <variant>

#include <rye/capture/lpips_weights.hpp>
#include <rye/loss/perceptual.hpp>
#include <rye/loss/smoothness.hpp>
#include <rye/train/stage_avatar.hpp>

#include "training/steps.hpp"

namespace rye::trainer {

/// Memory that steps share.
template <EffectSet E>
class StepMemory {
  public:
    StepMemory(const TwoStream<float, E>& avatar, const TrainConfig& config,
               const std::filesystem::path& perceptual_weights)
        : grad_(zeros_like(avatar)) {
        if (config.gaussians.weights.eye_smooth > 0) {
            const EyeStream<float, E>& eyes = avatar.eyes;
            for (Index e = 0; e < 2; ++e) {
                const Index first = eyes.first_point(e);
                const Columns<float> points = eyes.position.middleCols(first, eyes.points_of(e));
                const NeighbourGraph of_eye = four_nearest(points, first);
                eye_neighbours_.insert(eye_neighbours_.end(), of_eye.begin(), of_eye.end());
            }
        }
        if (!perceptual_weights.empty())
            perceptual_ =
                LpipsVgg<float>{read_lpips_weights<float>(perceptual_weights)};
    }

    StepReport step(TwoStream<float, E>& avatar, Adam<TwoStream<float, E>>& adam,
                    const TrainState& state, const AvatarSample<float, E>& sample, double rate,
                    const Probe& probe) {
        const TrainConfig& c = state.config;
        AvatarLosses<float> l = std::visit(
            [&](const auto& perceptual) {
                return avatar_losses(train_backend(), avatar, c.avatar, state.subject.roles,
                                     c.gaussians.weights, rasterizer_, perceptual, sample, trace_,
                                     pictures_, probe);
            },
            perceptual_);
        TwoStream<float, E>::fields([](const std::string&, auto& a) { a.setZero(); }, grad_);
        avatar_losses_vjp(train_backend(), avatar, c.avatar, rasterizer_, sample, trace_, pictures_,
                          grad_, probe);
        float eye_smooth = 0;
        if (c.gaussians.weights.eye_smooth > 0) {
            const auto weight = static_cast<float>(c.gaussians.weights.eye_smooth);
            const LossGradient<float> term = smoothness(avatar.eyes.feature, eye_neighbours_);
            grad_.eyes.feature += weight * term.gradient;
            eye_smooth = term.value;
            l.total += weight * term.value;
        }
        const AdamReport report =
            adam_step(train_backend(), avatar, grad_, adam,
                      [&](const std::string& name) { return rate * c.gaussians.rates(name); });
        if (c.gaussians.eyeball.max_growth > 0)
            bound_scales(avatar.eyes, static_cast<float>(c.gaussians.eyeball.max_growth),
                         static_cast<float>(c.gaussians.eyeball.thickness));
        probe("optimiser");
        return {{{"loss", l.total}, {"high_resolution", l.high_resolution},
                 {"low_resolution", l.low_resolution}, {"perceptual", l.perceptual},
                 {"dssim", l.dssim}, {"eye_low", l.eye_low}, {"eye_high", l.eye_high},
                 {"blank", l.blank}, {"face_alone", l.face_alone}, {"eye_smooth", eye_smooth}},
                0, report.first_bad_field};
    }

  private:
    TwoStream<float, E> grad_;
    TwoStreamTrace<float, E> trace_;
    AvatarPictures<float> pictures_;
    TrainRasterizer rasterizer_;
    NeighbourGraph eye_neighbours_; ///< of both eyeballs' points, if their colours are smoothed
    std::variant<PyramidGradientLoss, LpipsVgg<float>> perceptual_;
};

/// The steps of a run by lines of sight.
std::unique_ptr<AvatarSteps> visual_steps(const TrainState& state,
                                          const std::filesystem::path& perceptual_weights);

} // namespace rye::trainer
