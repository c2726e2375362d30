// SPDX-License-Identifier: Apache-2.0
// Stage 1 of the trainer with its networks on a device, which is emulated here.
#include <rye/backend/cuda/emulation.hpp>

#include <cstdio>
#include <limits>

#include <doctest/doctest.h>

#include "../support/tiny_mesh.hpp"
#include "device/mesh_networks.hpp"
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

/// Fits `mesh` to landmarks that expressions lift, on a device or the host; returns what is left.
double fitted(MeshNetworks* networks, int steps, Mesh& mesh) {
    const TrainState state = tiny_state();
    std::vector<MeshSample<float>> frames(3, tiny_sample<float>());
    for (std::size_t i = 0; i < frames.size(); ++i) {
        frames[i].drivers.expression[0] = 0.4F * static_cast<float>(i);
        frames[i].landmarks.row(1).array() += 0.1F * static_cast<float>(i);
    }
    const LandmarkStage stage{state.config.avatar, state.subject.roles, true};
    DeformationFit fit{steps, 2, 2e-3, Random(5)};
    fit.lids = 10;
    mesh = state.mesh;
    if (networks == nullptr) return fit_deformation(train_backend(), mesh, stage, frames, fit);
    return networks->fit(program_threads(), mesh, stage, frames, fit).value();
}

} // namespace

TEST_CASE("the fit to landmarks on a device ends as on the host, if its tiles have room") {
    Emulated networks(EmulatedDevice{}, nullptr);
    Mesh here, there;
    const double left_here = fitted(nullptr, 3, here), left_there = fitted(&networks, 3, there);
    CHECK(left_there == doctest::Approx(left_here).epsilon(1e-3));
    CHECK((there.networks.exp_deform.weight[0] - here.networks.exp_deform.weight[0]).norm() <
          1e-3F * here.networks.exp_deform.weight[0].norm());
    here.networks.exp_deform.shape.dims[1] = 257;
    CHECK(!networks.fit(program_threads(), here, {tiny_state().config.avatar, {}, true}, {}, {}));
}

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
    Mesh fitted_here, fitted_there, fitted_again;
    const double left_here = fitted(nullptr, 300, fitted_here),
                 left_there = fitted(networks.get(), 300, fitted_there);
    CHECK(left_there == doctest::Approx(left_here).epsilon(0.02));
    CHECK(left_here < 0.8 * fitted(nullptr, 3, fitted_again));
    CHECK(fitted(networks.get(), 300, fitted_again) == left_there);
    Mesh::fields([](const std::string& name, const auto& x,
                    const auto& y) { CHECK_MESSAGE(x == y, name); },
                 fitted_there, fitted_again);
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
