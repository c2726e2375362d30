// SPDX-License-Identifier: Apache-2.0
/// training/avatar_training.hpp: settings of stage 2 of a run beside its avatar, and the names of
/// its losses; the same for the CPU and for a device.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include <rye/train/avatar_trainer.hpp>

#include "training/run.hpp"
#include "training/steps.hpp"

namespace rye::trainer {

template <class Perceptual>
AvatarTraining<Balanced, Perceptual> avatar_training(const TrainState& state) {
    const TrainConfig& c = state.config;
    AvatarTraining<Balanced, Perceptual> t;
    t.config = c.avatar;
    t.roles = state.subject.roles;
    t.objective.weights = c.gaussians.weights;
    t.objective.rasterizer = train_rasterizer();
    t.rates = c.gaussians.rates;
    if (c.gaze_axis == GazeAxis::optical) t.rates.kappa = 0; // kappa, if any, stays 0
    t.centred_corrections = c.gaussians.centre_corrections;
    t.view_directions = state.view_directions;
    t.bounds = {c.gaussians.eyeball.max_growth, c.gaussians.eyeball.thickness};
    t.face_neighbours = first_neighbours(state);
    return t;
}

/// Returns the losses under their names in log.jsonl.
inline std::vector<std::pair<std::string, double>> names_of(const AvatarLosses<float>& l) {
    return {{"loss", l.total},
            {"high_resolution", l.high_resolution},
            {"low_resolution", l.low_resolution},
            {"perceptual", l.perceptual},
            {"dssim", l.dssim},
            {"eye_low", l.eye_low},
            {"eye_high", l.eye_high},
            {"blank", l.blank},
            {"face_alone", l.face_alone},
            {"eye_smooth", l.eye_smooth},
            {"face_smooth", l.face_smooth},
            {"face_mirror", l.face_mirror}};
}

} // namespace rye::trainer
