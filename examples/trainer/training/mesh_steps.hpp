// SPDX-License-Identifier: Apache-2.0
/// training/mesh_steps.hpp: the steps of stage 1 on any backend: the host's in steps.cpp, one with
/// networks on a device in device_mesh_steps.cpp.
#pragma once

#include <rye/train/initialize.hpp>
#include <rye/train/stage_mesh.hpp>

#include "device/mesh_networks.hpp"
#include "training/steps.hpp"

namespace rye::trainer {

inline Random seed_of(const TrainState& state) { return {state.config.seed, 0}; }

/// Memory shared by steps.
struct MeshMemory {
    Mesh grad;
    MeshTrace<float> trace;
};

/// Inputs of a step beside the state; see MeshStepper::step.
struct MeshStepInput {
    const TetGrid<float>& grid;
    const MeshSample<float>& sample;
    double rate;
    const Probe& probe;
};

template <Backend B>
void pretrain_mesh_by(const B& backend, TrainState& state) {
    const TrainConfig& c = state.config;
    const SphereFit<float> fit{state.subject.head_centre.cast<float>(),
                               static_cast<float>(c.grid.half_side), c.mesh.pretrain_steps, 1e-3};
    pretrain_sphere(backend, state.mesh, c.avatar, fit, seed_of(state).fork(3));
}

template <Backend B>
StepReport mesh_step_by(const B& backend, MeshMemory& memory, TrainState& state,
                        const MeshStepInput& in) {
    const TrainConfig& c = state.config;
    const MeshStage<float, const Probe&> stage{
        {{c.avatar, state.subject.roles, c.mesh.landmarks_follow_gaze}, c.mesh.weights},
        in.grid,
        in.probe};
    const MeshLosses<float> l = mesh_losses(backend, state.mesh, stage, in.sample, memory.trace);
    Mesh::fields([](const std::string&, auto& a) { a.setZero(); }, memory.grad);
    mesh_losses_vjp(backend, state.mesh, stage, memory.trace, memory.grad);
    const AdamReport report =
        adam_step(backend, state.mesh, memory.grad, state.mesh_adam,
                  [&](const std::string& name) { return in.rate * c.mesh.rates(name); });
    in.probe("optimiser");
    ++state.step;
    return {{{"loss", l.total},
             {"rgb", l.rgb},
             {"silhouette", l.silhouette},
             {"deform", l.deform},
             {"offset", l.offset},
             {"landmark", l.landmark},
             {"laplacian", l.laplacian},
             {"eye_offset", l.eye_offset}},
            l.vertices,
            report.first_bad_field};
}

void pretrain_mesh_on(MeshNetworks& networks, TrainState& state);
StepReport mesh_step_on(MeshNetworks& networks, MeshMemory& memory, TrainState& state,
                        const MeshStepInput& in);

} // namespace rye::trainer
