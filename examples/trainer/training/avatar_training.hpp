// SPDX-License-Identifier: Apache-2.0
/// training/avatar_training.hpp: settings of stage 2 of a run beside its avatar, and the names of
/// its losses; the same for the CPU and for a device.
#pragma once

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include <rye/train/avatar_trainer.hpp>

#include "model/run.hpp"
#include "training/steps.hpp"

namespace rye::trainer {

/// Returns the settings of a state's training. neighbours: first_neighbours of the state.
template <class Perceptual>
AvatarTraining<Balanced, Perceptual> avatar_training(const TrainState& state,
                                                     FaceNeighbours neighbours) {
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
    t.face_neighbours = std::move(neighbours);
    return t;
}

/// Returns the losses under their names in log.jsonl, the weighted sum first.
inline std::vector<std::pair<std::string, double>> names_of(const AvatarLosses<float>& l) {
    std::vector<std::pair<std::string, double>> all;
    AvatarLosses<float>::fields(
        [&](const char* name, float value) { all.emplace_back(name, value); }, l);
    std::rotate(all.begin(), all.end() - 1, all.end());
    return all;
}

} // namespace rye::trainer
