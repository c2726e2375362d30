// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/offload_cases.hpp: stage 1 with its networks on a device against the host's.
#pragma once

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <rye/avatar/cuda/offload.hpp>
#include <rye/train/cuda/fit_deformation.hpp>

#include "../support/tiny_mesh.hpp"
#include "device_render.hpp"

namespace rye::test {

/// A step's losses and gradient.
template <class T>
struct MeshStep {
    MeshLosses<T> losses;
    GuidanceMesh<T> gradient;
};

/// The tiny mesh, its numbers those of floats in any scalar.
template <class T>
GuidanceMesh<T> rounded_mesh() {
    return lifted<T>(lifted<float>(tiny_mesh()));
}

template <class T, Backend B>
MeshStep<T> mesh_step(const B& backend) {
    const AvatarConfig config = tiny_config();
    const LandmarkRoles roles = tiny_roles();
    MeshLossConfig weights;
    weights.laplacian_unit = LaplacianUnit::metre;
    const TetGrid<T> grid = grid_in<T>(tiny_grid());
    const MeshStage<T> stage{{{config, roles, true}, weights}, grid};
    const GuidanceMesh<T> mesh = rounded_mesh<T>();
    MeshTrace<T> trace;
    MeshStep<T> step{mesh_losses(backend, mesh, stage, tiny_sample<T>(), trace), zeros_like(mesh)};
    mesh_losses_vjp(backend, mesh, stage, trace, step.gradient);
    return step;
}

/// How far the losses and the gradient's arrays are from the truth, relative, by name.
template <class T, class U>
std::map<std::string, double> step_gaps(const MeshStep<T>& found, const MeshStep<U>& truth) {
    std::map<std::string, double> gaps;
    const auto loss = [&](const char* name, auto member) {
        const double x = double(found.losses.*member.first),
                     y = double(truth.losses.*member.second);
        gaps[name] = x == y ? 0 : std::abs(x - y) / std::abs(y);
    };
    using L = MeshLosses<T>;
    using K = MeshLosses<U>;
    loss("rgb", std::pair{&L::rgb, &K::rgb});
    loss("silhouette", std::pair{&L::silhouette, &K::silhouette});
    loss("deform", std::pair{&L::deform, &K::deform});
    loss("offset", std::pair{&L::offset, &K::offset});
    loss("landmark", std::pair{&L::landmark, &K::landmark});
    loss("laplacian", std::pair{&L::laplacian, &K::laplacian});
    loss("eye_offset", std::pair{&L::eye_offset, &K::eye_offset});
    loss("total", std::pair{&L::total, &K::total});
    GuidanceMesh<T>::fields(
        [&](const std::string& name, const auto& x, const auto& y) { gaps[name] = relative(x, y); },
        found.gradient, truth.gradient);
    return gaps;
}

/// Returns in words which of the names that begin with `of` are farther apart than `bound`.
inline std::string beyond(double bound, const std::map<std::string, double>& gaps,
                          const std::string& of = "") {
    std::string names;
    for (const auto& [name, gap] : gaps)
        if (name.starts_with(of) && !(gap <= bound))
            names += name + " by " + std::to_string(gap) + "\n";
    return names;
}

/// A step of the tiny mesh in float, by an offload of passes of `least` points and more.
template <class Tiles, class Device, DeviceMemory Staging>
MeshStep<float> offloaded_step(const Device& device, const CudaQueue& queue, Staging& staging,
                               Index least, OffloadCounts& counts) {
    NetworkOffload<Device, Tiles> networks(device, queue, staging);
    networks.least_points = least;
    const MeshStep<float> step = mesh_step<float>(OffloadBackend{ScalarBackend<>{}, networks});
    counts = networks.counts();
    return step;
}

/// A step with all networks on the device is the host's in double, to `bound`, or, where sums
/// cancel so that the host's floats are farther from it than that, to twice their distance.
template <class Tiles, class Device, DeviceMemory Staging>
MeshStep<float> mesh_step_against_host(const Device& device, const CudaQueue& queue,
                                       Staging& staging, double bound) {
    CAPTURE(Tiles::N);
    OffloadCounts counts;
    const ScalarBackend<> host;
    const MeshStep<double> truth = mesh_step<double>(host);
    const MeshStep<float> step = offloaded_step<Tiles>(device, queue, staging, 1, counts);
    CHECK(step.losses.vertices == truth.losses.vertices);
    const auto of_host = step_gaps(mesh_step<float>(host), truth);
    std::map<std::string, double> gaps = step_gaps(step, truth);
    for (auto& [name, gap] : gaps)
        if (gap <= 2 * of_host.at(name)) gap = 0;
    CHECK(beyond(bound, gaps) == "");
    // The lattice, its touched vertices, four colours, four deformations, the landmarks' geometry
    // and three deformations, the eyes' offset.
    CHECK(counts.forward == 15);
    CHECK(counts.vjp == 14);
    CHECK(counts.host_forward + counts.host_vjp == 0);
    CHECK(counts.sent > 0);
    CHECK(counts.fetched > 0);
    return step;
}

/// Again the same bits; with few points the host's in float, to the bit.
template <class Tiles, class Device, DeviceMemory Staging>
void mesh_step_by_size(const Device& device, const CudaQueue& queue, Staging& staging,
                       const MeshStep<float>& step) {
    OffloadCounts counts;
    const auto offloaded = [&](Index least) {
        return offloaded_step<Tiles>(device, queue, staging, least, counts);
    };
    CHECK(beyond(0, step_gaps(offloaded(1), step)) == "");
    const MeshStep<float> small = offloaded(Index(1) << 20);
    CHECK(counts.forward + counts.vjp + counts.sent + counts.fetched == 0);
    CHECK(counts.host_vjp == 14);
    CHECK(beyond(0, step_gaps(small, mesh_step<float>(ScalarBackend<>{}))) == "");
    // Landmarks, the eyes' offset and the four fields of the few vertices at the eyes stay.
    offloaded(67);
    CHECK(counts.host_vjp == 9);
    CHECK(counts.vjp == 5);
}

/// Training by an offload: the sphere and the landmarks' fit end near the host's.
template <class Tiles, class Device, DeviceMemory Staging>
void mesh_training_against_host(const Device& device, const CudaQueue& queue, Staging& staging,
                                double bound) {
    const AvatarConfig config = tiny_config();
    const ScalarBackend<> host;
    std::vector<MeshSample<float>> frames{tiny_sample<float>(), tiny_sample<float>()};
    frames[1].drivers.expression *= -0.5F;
    const auto trained = [&](const auto& backend, double& left) {
        GuidanceMesh<float> mesh = rounded_mesh<float>();
        pretrain_sphere(backend, mesh, config, {Vec3<float>::Zero(), 1.6F, 1, 1e-3}, Random{2});
        left = fit_deformation(backend, mesh, {config, tiny_roles(), true}, frames,
                               {2, 2, 2e-3, Random(5)});
        return mesh;
    };
    NetworkOffload<Device, Tiles> networks(device, queue, staging);
    networks.least_points = 1;
    double left_there = 0, left_here = 0;
    const GuidanceMesh<float> there = trained(OffloadBackend{host, networks}, left_there),
                              here = trained(host, left_here);
    CHECK(networks.counts().vjp > 0);
    CHECK(networks.counts().host_vjp == 0);
    CHECK(std::abs(left_there - left_here) < bound * left_here);
    GuidanceMesh<float>::fields(
        [&](const std::string& name, const auto& x, const auto& y) {
            CAPTURE(name);
            CHECK(relative(x, y) < bound);
        },
        there, here);
}

/// The landmarks' fit on a device ends near the host's, for steps that are sent in two parts, and
/// moves no other array.
template <class Tiles, class Device>
void fit_against_host(const Device& device, const CudaQueue& queue, double bound,
                      bool follow_gaze = true) {
    const AvatarConfig config = tiny_config();
    const ScalarBackend<> host;
    std::vector<MeshSample<float>> frames(5, tiny_sample<float>());
    Draw draw{{4, 0}};
    for (MeshSample<float>& f : frames) {
        f.drivers.expression = draw.columns(3, 1, 0.8).template cast<float>();
        f.landmarks.row(1).array() += 0.2F * f.drivers.expression[0];
    }
    const LandmarkStage stage{config, tiny_roles(), follow_gaze};
    DeformationFit fit{35, 2, 2e-3, Random(5)};
    fit.mixed = 0.4;
    const GuidanceMesh<float> before = rounded_mesh<float>();
    GuidanceMesh<float> there = before, here = before;
    using Fit = DeviceDeformationFit<PaperEffects, Device, Tiles>;
    REQUIRE(Fit::fits(there));
    CHECK(!DeviceDeformationFit<PaperEffects, Device, MlpTiles<2, 32, 0>>::fits(there));
    const double left_there =
                     fit_deformation_on<Tiles>(device, queue, host, there, stage, frames, fit),
                 left_here = fit_deformation(host, here, stage, frames, fit);
    CHECK(std::abs(left_there - left_here) < bound * left_here);
    GuidanceMesh<float>::fields(
        [&](const std::string& name, const auto& x, const auto& y, const auto& old) {
            CAPTURE(name);
            if (y == old)
                CHECK(x == old);
            else
                CHECK(double((x - y).norm()) < bound * double((y - old).norm()));
        },
        there, here, before);
    GuidanceMesh<float> again = before;
    CHECK(fit_deformation_on<Tiles>(device, queue, host, again, stage, frames, fit) == left_there);
    GuidanceMesh<float>::fields([](const std::string& name, const auto& x,
                                   const auto& y) { CHECK_MESSAGE(x == y, name); },
                                there, again);
    frames[1].landmarks(0, 0) = std::numeric_limits<float>::quiet_NaN();
    fit.mixed = 0;
    fit.steps = 4;
    again = before;
    fit_deformation_on<Tiles>(device, queue, host, again, stage, frames, fit);
    GuidanceMesh<float>::fields(
        [](const std::string& name, const auto& x) { CHECK_MESSAGE(x.allFinite(), name); }, again);
}

} // namespace rye::test
