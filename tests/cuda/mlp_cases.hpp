// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/mlp_cases.hpp: networks on a device against the host's in double, for the emulated
/// device and a real one.
#pragma once

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>

#include "../support/hostile.hpp"
#include "mlp_arrays.hpp"

namespace rye::test {

struct MlpCase {
    MlpShape shape;
    Index points;
    double outputs;   ///< relative error
    double gradients; ///< with one plane, signs of activations near 0 differ
    /// Points with a hidden sum this near to 0, whose sign rounding decides, have no cotangent: one
    /// sign that differs turns a whole cotangent, and a share p of signs turns gradients by
    /// sqrt(p). Sums of order 1 err by the planes' 4e-6 (N = 2) and by what units of matrices cut
    /// off, 1e-7 of a sum for each of its 3 K / 16 products, here 9e-6; layers add theirs up: 4e-5.
    /// With N = 3, whose parts of 16 are added as floats, 1e-5 is ample.
    double undecided = 0;
};

/// Takes the cotangents of undecided points away; a few of many: of a point's 512 hidden sums of
/// order 0.2, one within 4e-5 of 0 takes a point in 12 away, one within 1e-5 a point in 50.
inline void leave_undecided(const MlpTrace<double>& trace, double bound, Columns<float>& g_out) {
    Index left_out = 0;
    for (Index i = 0; i < g_out.cols(); ++i) {
        bool decided = true;
        for (const Columns<double>& h : trace.hidden)
            for (Index k = 0; k < h.rows(); ++k) // a negative sum was multiplied by the slope
                decided = decided && !(h(k, i) < bound && h(k, i) > leaky_relu(-bound));
        if (decided) continue;
        g_out.col(i).setZero();
        ++left_out;
    }
    CHECK(left_out <= g_out.cols() / 10);
}

template <class Tiles, class Device>
void mlp_against_host(const Device& device, const CudaQueue& queue, const MlpCase& c) {
    CAPTURE(Tiles::N);
    CAPTURE(c.points);
    const MlpShape& s = c.shape;
    const Mlp<float> m = Mlp<float>::init(s, Random{3});
    const Columns<float> points = noise<float>(s.point_inputs(), c.points, 1),
                         frame = noise<float>(s.frame_inputs, 1, 3);
    Columns<float> g_out = noise<float>(s.outputs(), c.points, 2);
    Mlp<double> m64(s), g64(s);
    for (std::size_t l = 0; l < m.weight.size(); ++l) {
        m64.weight[l] = m.weight[l].cast<double>();
        m64.bias[l] = m.bias[l].cast<double>();
    }
    const Columns<double> x = points.cast<double>();
    const VecX<double> f = frame.cast<double>();
    MlpTrace<double> trace;
    const ScalarBackend<Serial> host;
    const Columns<double> y = mlp_forward<double>(host, m64, x, f, &trace);
    if (c.undecided > 0) leave_undecided(trace, c.undecided, g_out);
    const Columns<double> g = g_out.cast<double>();
    Columns<double> g_points;
    VecX<double> g_frame;
    mlp_vjp<double>(host, m64, {x, f, trace}, g, {g64, &g_points, &g_frame});

    const DeviceParameters<Device> parameters(device, queue, m),
        gradient(device, queue, Mlp<float>(s));
    const DeviceArray<Device> in(device, queue, points), cotangent(device, queue, g_out),
        of_frame(device, queue, frame), out(device, queue, s.outputs(), c.points),
        to_points(device, queue, s.point_inputs(), c.points),
        to_frame(device, queue, s.frame_inputs, 1);
    DeviceMlp<Device, Tiles> network(device, s);
    network.set(queue, parameters.view, of_frame.buffer.data());
    network.forward_into(queue, in.read(), out.view());
    network.vjp_into(queue, cotangent.read(),
                     {gradient.view, to_points.view(), to_frame.buffer.data()});
    CHECK(relative(out.get(), y) < c.outputs);
    CHECK(relative(to_points.get(), g_points) < c.gradients);
    if (s.frame_inputs > 0) CHECK(relative(to_frame.get(), Columns<double>(g_frame)) < c.gradients);
    const Mlp<float> found = gradient.get(s);
    for (std::size_t l = 0; l < m.weight.size(); ++l) {
        CAPTURE(l);
        CHECK(relative(found.weight[l], g64.weight[l]) < c.gradients);
        CHECK(relative(found.bias[l], g64.bias[l]) < c.gradients);
    }
    // Without what a vjp reads, and with the frame inputs given anew, outputs are the same bits.
    const DeviceArray<Device> alone(device, queue, s.outputs(), c.points);
    network.set_frame(queue, of_frame.buffer.data());
    network.forward_into(queue, in.read(), alone.view(), false);
    CHECK(alone.get() == out.get());
}

/// A network that does not fit says so.
template <class Device>
void mlp_too_wide(const Device& device) {
    using Small = DeviceMlp<Device, MlpTiles<1, 64, 32>>;
    CHECK_FAULT(Small(device, MlpShape{{8, 65, 3}}), "width of layer 0 is 65");
    CHECK_FAULT(Small(device, MlpShape{{40, 16, 3}}), "number of point inputs is 40");
    CHECK_FAULT(Small(device, MlpShape{{8, 8, 8, 8, 8, 8, 8, 8, 8, 8, 3}}),
                "number of layers is 10");
}

} // namespace rye::test
