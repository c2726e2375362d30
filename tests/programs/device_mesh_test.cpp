// SPDX-License-Identifier: Apache-2.0
// Stage 1 of the trainer with its networks on a device, which is emulated here.
#include <rye/backend/cuda/emulation.hpp>

#include <cstdio>
#include <limits>

#include <doctest/doctest.h>

#include "../support/tiny_mesh.hpp"
#include "training/mesh_networks.hpp"
#include "training/steps.hpp"

using namespace rye;
using namespace rye::test;
using namespace rye::trainer;

namespace {

using Emulated = MeshNetworksOn<EmulatedDevice, HostMemory, HostMemory>;

TrainState tiny_state() {
    TrainState state;
    state.config = preset("tiny");
    state.config.avatar = tiny_config();
    state.config.mesh.weights.laplacian_unit = LaplacianUnit::metre;
    state.config.mesh.pretrain_steps = 1;
    state.config.grid.half_side = 1.6;
    state.subject.roles = tiny_roles();
    state.subject.head_centre = Vec3<double>(0, 0.1, 0.1);
    state.mesh = lifted<float>(tiny_mesh());
    state.mesh_adam = Adam<Mesh>(state.mesh);
    return state;
}

/// How far apart two runs' losses and parameters are at most, relative.
double apart(const StepReport& a, const StepReport& b, const TrainState& s, const TrainState& t) {
    double gap = 0;
    for (std::size_t i = 0; i < a.losses.size(); ++i)
        gap = std::max(
            gap, std::abs(a.losses[i].second - b.losses[i].second) / std::abs(b.losses[i].second));
    Mesh::fields([&](const std::string&, const auto& x,
                     const auto& y) { gap = std::max(gap, double((x - y).norm() / y.norm())); },
                 s.mesh, t.mesh);
    return gap;
}

} // namespace

TEST_CASE("stage 1 with networks on a device trains as without") {
    const TetGrid<float> grid = grid_in<float>(tiny_grid());
    const MeshSample<float> sample = tiny_sample<float>();
    Emulated networks(EmulatedDevice{}, nullptr);
    TrainState here = tiny_state(), there = here;
    pretrain_mesh(here);
    pretrain_mesh(there, &networks);
    CHECK(networks.counts().vjp == 1);
    CHECK(networks.counts().host_forward == 0);
    MeshStepper stepper(here), on_device(there, &networks);
    std::vector<std::string> parts;
    StepReport a, b;
    for (int i = 0; i < 2; ++i) {
        a = stepper.step(here, grid, sample, 1, [](const char*) {});
        b = on_device.step(there, grid, sample, 1,
                           [&](const char* part) { parts.push_back(part); });
    }
    CHECK(b.vertices == a.vertices);
    CHECK(b.bad_field.empty());
    CHECK(there.step == 2);
    CHECK(parts.size() == 18);
    CHECK(apart(b, a, there, here) < 1e-3);
    CHECK(apart(b, a, there, here) > 0);
    // The lattice, and the touched vertices of it. All else is of fewer points here than 512.
    CHECK(networks.counts().forward >= 3);
    CHECK(networks.counts().host_vjp > 0);
}

TEST_CASE("stage 1 on the device of this machine trains as on the host") {
    const TetGrid<float> grid = grid_in<float>(tiny_grid());
    const MeshSample<float> sample = tiny_sample<float>();
    std::unique_ptr<MeshNetworks> networks;
    try {
        networks = mesh_networks();
    } catch (const Error& e) { // no device, or no kernels
        CHECK(std::string(e.what()).find("stage 1") != std::string::npos);
        std::printf("not run: stage 1 on a device (%s)\n", e.what());
        return;
    }
    TrainState here = tiny_state(), there = here, again = here;
    const auto trained = [&](TrainState& state, MeshNetworks* on) {
        pretrain_mesh(state, on);
        MeshStepper stepper(state, on);
        stepper.step(state, grid, sample, 1, [](const char*) {});
        return stepper.step(state, grid, sample, 1, [](const char*) {});
    };
    const StepReport a = trained(here, nullptr), b = trained(there, networks.get()),
                     c = trained(again, networks.get());
    CHECK(networks->counts().vjp > 0);
    CHECK(apart(b, a, there, here) < 1e-3);
    CHECK(apart(c, b, again, there) == 0);
}

TEST_CASE("stage 1: a gradient that is not finite is not applied, on a device either") {
    const TetGrid<float> grid = grid_in<float>(tiny_grid());
    MeshSample<float> sample = tiny_sample<float>();
    sample.landmarks(0, 0) = std::numeric_limits<float>::quiet_NaN();
    Emulated networks(EmulatedDevice{}, nullptr);
    TrainState state = tiny_state();
    const TrainState before = state;
    MeshStepper stepper(state, &networks);
    const StepReport report = stepper.step(state, grid, sample, 1, [](const char*) {});
    CHECK(!report.bad_field.empty());
    Mesh::fields([](const std::string&, const auto& x, const auto& y) { CHECK(x == y); },
                 state.mesh, before.mesh);
}
