// SPDX-License-Identifier: Apache-2.0
/// rye/train/fit_deformation.hpp: the deformations by expression and gaze, fitted to the landmarks
/// of all frames at the end of stage 1. A step costs little beside one with pictures, so the frames
/// that are rare (a blink) get as near as the common ones. Not in the paper: docs/deviations.md.
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include <rye/core/random.hpp>
#include <rye/nn/adam.hpp>
#include <rye/train/landmark_losses.hpp>
#include <rye/train/landmark_regression.hpp>

namespace rye {

/// Settings of the fit of deformations to landmarks.
struct DeformationFit {
    int steps = 0;
    int batch = 4;        ///< frames a step
    double rate = 2e-3;   ///< first learning rate; the last is a twentieth
    Random random = {};   ///< draws the frames
    /// Share of the frames that are mixed_frame, with the landmarks of a regression; 0: none.
    double mixed = 0;
    RegressionConfig regression = {};
};

/// `frames` need drivers and landmarks only. Returns the root mean square distance of a landmark's
/// coordinate of a frame in the last steps (as many as there are frames), canonical units; mixed
/// frames do not count.
template <Real T, EffectSet E, Backend B>
double fit_deformation(const B& backend, GuidanceMesh<T, E>& mesh, const LandmarkStage& stage,
                       const std::vector<MeshSample<T, E>>& frames, const DeformationFit& fit) {
    MeshLossConfig weights;
    weights.landmark = weights.eye_offset = 0;
    weights.deform = 1.0 / fit.batch;
    Adam<GuidanceMesh<T, E>> adam(mesh);
    GuidanceMesh<T, E> grad = zeros_like(mesh);
    LandmarkTrace<T, E> trace;
    const Columns<T> neutral = mesh.landmarks;
    LandmarkRegression regression;
    if (fit.mixed > 0)
        regression = landmark_regression<T, E>(backend, {stage.config, neutral, neutral},
                                               stage.roles, frames, fit.regression);
    const Random mixes = fit.random.fork(1);
    double squares = 0, count = 0;
    for (int step = 0; step < fit.steps; ++step) {
        GuidanceMesh<T, E>::fields([](const std::string&, auto& a) { a.setZero(); }, grad);
        for (int i = 0; i < fit.batch; ++i) {
            const auto draw = static_cast<std::uint64_t>(step * fit.batch + i);
            const bool mixed = fit.mixed > 0 && mixes.uniform(draw) < fit.mixed;
            const MeshSample<T, E> made =
                mixed ? mixed_frame(frames, regression, neutral, mixes.fork(draw))
                      : MeshSample<T, E>{};
            const MeshSample<T, E>& frame =
                mixed ? made
                      : frames[static_cast<std::size_t>(
                            fit.random.below(draw, static_cast<Index>(frames.size())))];
            const MeshLosses<T> l = landmark_losses(backend, mesh, {stage, weights}, frame, trace);
            landmark_losses_vjp(backend, mesh, stage, trace, grad);
            if (mixed || step < fit.steps - static_cast<int>(frames.size())) continue;
            squares += static_cast<double>(l.deform);
            ++count;
        }
        const double rate = fit.rate * std::pow(0.05, static_cast<double>(step) / fit.steps);
        adam_step(backend, mesh, grad, adam, [&](const std::string& name) {
            return name.find("exp_deform") == 0 || name.find("gaze_deform") != std::string::npos
                       ? rate : 0.0;
        });
    }
    return count > 0 ? std::sqrt(squares / count) : 0.0;
}

} // namespace rye
