// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/offload_network_cases.hpp: networks of an OffloadBackend against the host's in
/// double, for the emulated device and a real one. Stage 1 as a whole is in offload_cases.hpp,
/// which nvcc cannot compile: it stops at [[no_unique_address]] members.
#pragma once

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/nn/cuda/offload.hpp>

#include "../support/hostile.hpp"
#include "../support/scenes.hpp"
#include "device_render.hpp"

namespace rye::test {

/// The same network in double.
inline Mlp<double> in_double(const Mlp<float>& m) {
    Mlp<double> d(m.shape);
    for (std::size_t l = 0; l < m.weight.size(); ++l) {
        d.weight[l] = m.weight[l].cast<double>();
        d.bias[l] = m.bias[l].cast<double>();
    }
    return d;
}

/// Outputs and all gradients through arrays of the host, twice, with other parameters and frame
/// inputs in between; and the first output of coded points.
template <class Tiles, class Device, DeviceMemory Staging>
void offload_against_host(const Device& device, const CudaQueue& queue, Staging& staging,
                          double bound) {
    CAPTURE(Tiles::N);
    NetworkOffload<Device, Tiles> networks(device, queue, staging);
    networks.least_points = 1;
    const ScalarBackend<> host;
    const OffloadBackend backend{host, networks};
    const MlpShape shape{{21, 40, 33, 5}, 4};
    Mlp<float> m = Mlp<float>::init(shape, Random{3});
    const Columns<float> wide = noise<float>(20, 90, 1), g_out = noise<float>(5, 90, 2);
    const auto x = wide.middleRows(1, 17); // columns lie apart
    for (const int round : {0, 1}) {
        CAPTURE(round);
        const VecX<float> frame = noise<float>(4, 1, 3 + static_cast<std::uint64_t>(round));
        if (round == 1) m.weight[1](2, 3) += 0.5F;
        MlpTrace<float> trace;
        const Columns<float> y = mlp_forward<float>(backend, m, x, frame, &trace);
        Mlp<float> gradient = Mlp<float>::init(shape, Random{9}); // added to
        Columns<float> g_points;
        VecX<float> g_frame;
        mlp_vjp<float>(backend, m, {x, frame, trace}, g_out, {gradient, &g_points, &g_frame});

        const Mlp<double> m64 = in_double(m);
        Mlp<double> gradient64 = in_double(Mlp<float>::init(shape, Random{9}));
        const Columns<double> x64 = x.template cast<double>();
        const VecX<double> frame64 = frame.cast<double>();
        MlpTrace<double> trace64;
        Columns<double> g_points64;
        VecX<double> g_frame64;
        const Columns<double> y64 = mlp_forward<double>(host, m64, x64, frame64, &trace64);
        mlp_vjp<double>(host, m64, {x64, frame64, trace64}, g_out.cast<double>(),
                        {gradient64, &g_points64, &g_frame64});
        CHECK(relative(y, y64) < bound);
        CHECK(relative(g_points, g_points64) < bound);
        CHECK(relative(Columns<float>(g_frame), Columns<double>(g_frame64)) < bound);
        Mlp<float>::fields(
            [&](const std::string& name, const auto& a, const auto& b) {
                CAPTURE(name);
                CHECK(relative(a, b) < bound);
            },
            gradient, gradient64);
    }
    CHECK(networks.counts().vjp == 2);

    const Mlp<float> geometry = Mlp<float>::init({{27, 20, 20, 7}}, Random{5});
    const Columns<float> points = noise<float>(3, 131, 6);
    const Columns<double> code = positional_encoding(points.cast<double>(), 4);
    CHECK(relative(networks.first_output(Serial{}, geometry, points, 4),
                   Columns<double>(
                       mlp_forward<double>(host, in_double(geometry), code, VecX<double>(), nullptr)
                           .topRows(1))) < bound);
}

/// Checks what an offload refuses.
template <class Device, DeviceMemory Staging>
void offload_faults(const Device& device, const CudaQueue& queue, Staging& staging) {
    using Offload = NetworkOffload<Device, MlpTiles<2, 64, 32>>;
    Offload networks(device, queue, staging);
    networks.least_points = 4;
    const OffloadBackend backend{ScalarBackend<>{}, networks};
    const MlpShape shape{{8, 16, 3}, 2};
    Mlp<float> m = Mlp<float>::init(shape, Random{3});
    const Columns<float> x = noise<float>(6, 5, 1), g = noise<float>(3, 5, 2);
    const VecX<float> frame = noise<float>(2, 1, 3);
    MlpTrace<float> first, trace;
    Mlp<float> gradient(shape);
    const auto back = [&](const MlpTrace<float>& t) {
        mlp_vjp<float>(backend, m, {x, frame, t}, g, {gradient});
    };
    mlp_forward<float>(backend, m, x, frame, &first);
    for (int i = 0; i < 3; ++i) mlp_forward<float>(backend, m, x, frame, &trace); // one place
    back(first);
    back(trace);
    MlpTrace<float> copy = first;
    back(copy);
    MlpTrace<float> second, third;
    mlp_forward<float>(backend, m, x, frame, &second);
    mlp_forward<float>(backend, m, x, frame, &third);
    CHECK_FAULT(back(first), "mlp_vjp on a device: pass 1 is not kept");
    m.weight[0](0, 0) += 1;
    CHECK_FAULT(back(third), "parameters are others than in the pass");

    // Networks that do not fit are the host's, as are passes of fewer points.
    CHECK(networks.takes(shape, 4));
    CHECK(!networks.takes(shape, 3));
    CHECK(!networks.takes({{8, 65, 3}}, 100));
    CHECK(!networks.takes({{40, 16, 3}}, 100));
    CHECK(!networks.takes({{8, 8, 8, 8, 8, 8, 8, 8, 8, 8, 3}}, 100));
    const Mlp<float> wide = Mlp<float>::init({{6, 65, 3}}, Random{4});
    MlpTrace<float> of_host;
    const Columns<float> y = mlp_forward<float>(backend, wide, x, VecX<float>(), &of_host);
    CHECK(y == mlp_forward<float>(ScalarBackend<>{}, wide, x, VecX<float>(), nullptr));
    CHECK(offloaded_pass(of_host) == 0);
    CHECK(networks.counts().host_forward == 1);
}

} // namespace rye::test
