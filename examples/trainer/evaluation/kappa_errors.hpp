// SPDX-License-Identifier: Apache-2.0
/// evaluation/kappa_errors.hpp: a run's angles kappa beside those that its capture knows.
#pragma once

#include <array>
#include <optional>

#include <nlohmann/json.hpp>

#include "data/capture.hpp"
#include "model/run.hpp"

namespace rye::trainer {

/// Kappa of an eye, optical minus visual axis, (yaw, pitch) [deg].
struct KappaPair {
    Vec2<double> run, capture;

    /// Returns the distance of the two [deg].
    double off() const { return (run - capture).norm(); }
};

/// Pairs of the left and right eye; empty where the run or the capture has no kappa.
struct KappaErrors {
    std::array<std::optional<KappaPair>, 2> eyes;

    nlohmann::ordered_json json() const;
};

/// Returns the pairs; the capture's are the means over these frames.
KappaErrors kappa_errors(const TrainState& state, const Capture& capture,
                         const std::vector<int>& frames);

} // namespace rye::trainer
