// SPDX-License-Identifier: Apache-2.0
/// rye/train/fit_deformation.hpp: fit of the deformations by expression and gaze to the landmarks
/// of all frames at the end of stage 1. A step is cheap compared with one with pictures, so rare
/// frames (a blink) are fitted as well as common ones. Not in the paper: docs/deviations.md.
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
    int batch = 4;        ///< frames per step
    double rate = 2e-3;   ///< first learning rate; the last is a twentieth
    Random random = {};   ///< draw of the frames
    /// Share of the frames that are mixed_frame, with the landmarks of a regression; 0 for none.
    double mixed = 0;
    RegressionConfig regression = {};
};

namespace detail {

/// One frame of a step of the fit.
template <class T, EffectSet E>
struct DeformationTask {
    FaceNetworks<T, E> grad;
    DeformedLandmarks<T, E> landmarks;
    T squares = T(0); ///< mean square error of a landmark's coordinate
    bool mixed = false;
};

} // namespace detail

/// Fits the deformations. `frames` need drivers and landmarks only. Frames of a step run in
/// parallel, each on one thread, and are added in order. Returns the root mean square error of a
/// landmark's coordinate in the last steps (as many as there are frames), canonical units, without
/// mixed frames.
template <Real T, EffectSet E, Backend B>
double fit_deformation(const B& backend, GuidanceMesh<T, E>& mesh, const LandmarkStage& stage,
                       const std::vector<MeshSample<T, E>>& frames, const DeformationFit& fit) {
    using Networks = FaceNetworks<T, E>;
    const auto alone = one_thread(backend);
    const Columns<T>& neutral = mesh.landmarks;
    GeometryTrace<T> geometry;
    LandmarkPlaces<T, E> places; // lattice and landmarks are fixed, so these are too
    place_landmarks(backend, mesh, stage, geometry, places);
    LandmarkRegression regression;
    if (fit.mixed > 0)
        regression = landmark_regression<T, E>(backend, {stage.config, neutral, neutral},
                                               stage.roles, frames, fit.regression);
    const Random mixes = fit.random.fork(1);
    Networks& networks = mesh.networks;
    Adam<Networks> adam(networks);
    Networks grad = zeros_like(networks);
    std::vector<detail::DeformationTask<T, E>> tasks(static_cast<std::size_t>(fit.batch));
    for (auto& t : tasks) t.grad = grad;
    const auto run = [&](int step, Index i) {
        detail::DeformationTask<T, E>& t = tasks[static_cast<std::size_t>(i)];
        const auto draw = static_cast<std::uint64_t>(step * fit.batch + i);
        t.mixed = fit.mixed > 0 && mixes.uniform(draw) < fit.mixed;
        const MeshSample<T, E> made = t.mixed ? mixed_frame(frames, regression, neutral,
                                                            mixes.fork(draw))
                                              : MeshSample<T, E>{};
        const MeshSample<T, E>& frame =
            t.mixed ? made
                    : frames[static_cast<std::size_t>(
                          fit.random.below(draw, static_cast<Index>(frames.size())))];
        const FrameCode<T, E> code =
            frame_code(stage.config, OpticalDrivers<T, E>(frame.drivers));
        const LandmarkDeformation<T, E> at{networks, stage, places, code};
        deform_landmarks(alone, at, t.landmarks);
        const LossTerm<T> off = deformation_term<T>(t.landmarks.deformed, frame.landmarks);
        t.squares = off.value;
        Networks::fields([](const std::string&, auto& a) { a.setZero(); }, t.grad);
        const Columns<T> g = T(1.0 / fit.batch) * off.gradient;
        deform_landmarks_vjp<T, E>(alone, at, t.landmarks, g, {t.grad});
    };
    double squares = 0, count = 0;
    for (int step = 0; step < fit.steps; ++step) {
        backend.threads.run(fit.batch, [&](Index i) { run(step, i); });
        Networks::fields([](const std::string&, auto& a) { a.setZero(); }, grad);
        for (const auto& t : tasks) {
            add_fields(grad, t.grad);
            if (t.mixed || step < fit.steps - static_cast<int>(frames.size())) continue;
            squares += static_cast<double>(t.squares);
            ++count;
        }
        const double rate = fit.rate * std::pow(0.05, static_cast<double>(step) / fit.steps);
        adam_step(backend, networks, grad, adam, [&](const std::string& name) {
            return name.starts_with("exp_deform") || name.find("gaze_deform") != std::string::npos
                       ? rate : 0.0;
        });
    }
    return count > 0 ? std::sqrt(squares / count) : 0.0;
}

} // namespace rye
