// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/upsampler_cases.hpp: the super-resolution network on a device against the host's in
/// double, for the emulated device and a real one.
#pragma once

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/nn/cuda/upsampler.hpp>

#include "convolution_cases.hpp"

namespace rye::test {

struct UpsamplerCase {
    UpsamplerShape shape;
    int width, height;
    double picture, gradients; ///< relative errors; with few planes, signs before ReLU differ
};

template <class T>
Upsampler<T> upsampler_as(const Upsampler<float>& from) {
    Upsampler<T> to(from.shape);
    Upsampler<float>::fields([](const std::string&, const Columns<float>& a,
                                Columns<T>& b) { b = a.template cast<T>(); },
                             from, to);
    return to;
}

template <int N, class Device>
void upsampler_against_host(const Device& device, const CudaQueue& queue, const UpsamplerCase& c) {
    CAPTURE(N);
    CAPTURE(c.shape.doublings);
    CAPTURE(c.shape.skip);
    CAPTURE(c.shape.norm == Normalization::none);
    const UpsamplerShape& s = c.shape;
    Upsampler<float> u = Upsampler<float>::init(s, Random{4});
    if (s.skip) u.out_weight = noise<float>(3, s.capacity, 9); // else it begins as zero
    const Image<float> in = float_picture(c.width, c.height, s.in_channels, 1);
    const int times = 1 << s.doublings;
    const Image<float> cotangent = noise_image(times * c.width, times * c.height, 3, 2);

    const ScalarBackend<Serial> host;
    const Upsampler<double> exact = upsampler_as<double>(u);
    Upsampler<double> g_exact(s);
    UpsamplerTrace<double> host_trace;
    const Image<double> x = in_double(in), picture = upsampler_forward(host, exact, x, &host_trace);
    Columns<double> g_in;
    upsampler_vjp(host, exact, x, host_trace, cotangent.pixels.cast<double>(), g_exact, &g_in);

    const ResidentLayout<Upsampler<float>> layout(u);
    Resident<Upsampler<float>, Device> parameters(device, queue, layout),
        gradient(device, queue, layout);
    parameters.send(queue, u);
    const DeviceFloats<Device> dx(device, queue, in), dg(device, queue, cotangent),
        out(device, queue, cotangent);
    const DeviceArray<Device> to_in(device, queue, s.in_channels, in.size());
    DeviceUpsampler<Device, N> network(device, s);
    DeviceUpsamplerTrace trace;
    CHECK_FAULT(network.forward_into(queue, dx.read(), out.view(), trace), "weights were not set");
    network.set(queue, device_upsampler(parameters, u));
    network.forward_into(queue, dx.read(), out.view(), trace);
    CHECK(relative(out.array.get(), picture.pixels) <= c.picture);
    const auto reverse = [&] {
        gradient.clear(queue);
        network.vjp_into(queue, trace, dg.read().pixels,
                         {device_upsampler(gradient, u), to_in.view()});
        Upsampler<float> g(s);
        gradient.fetch(queue, g);
        return g;
    };
    const Upsampler<float> g = reverse();
    CHECK(relative(to_in.get(), g_in) <= c.gradients);
    Upsampler<double>::fields(
        [&](const std::string& name, const Columns<float>& own, const Columns<double>& want) {
            CAPTURE(name);
            CHECK(want.norm() > 0);
            CHECK(relative(own, want) <= c.gradients);
        },
        g, g_exact);
    // Again: the same bits, added to what is there if it is not cleared.
    const Columns<float> before = to_in.get(), shown = out.array.get();
    network.keep_planes = true;
    network.forward_into(queue, dx.read(), out.view(), trace);
    CHECK(out.array.get() == shown);
    CHECK(reverse().conv[0] == g.conv[0]);
    CHECK(to_in.get() == before);
    network.vjp_into(queue, trace, dg.read().pixels, {device_upsampler(gradient, u)});
    Upsampler<float> twice(s);
    gradient.fetch(queue, twice);
    CHECK(relative(twice.out_weight, Columns<float>(2.0F * g.out_weight)) <= 1e-6);
    CHECK(relative(twice.conv[0], Columns<float>(2.0F * g.conv[0])) <= 1e-6);
}

template <class Device>
void upsampler_faults(const Device& device, const CudaQueue& queue) {
    const UpsamplerShape shape{4, 3, 1};
    const Upsampler<float> u(shape), other({4, 5, 1});
    const ResidentLayout<Upsampler<float>> layout(other);
    Resident<Upsampler<float>, Device> parameters(device, queue, layout);
    DeviceUpsampler<Device, 1> network(device, shape);
    CHECK_FAULT(network.set(queue, device_upsampler(parameters, other)),
                "weight of layer 0 is 10 x 36, its shape has 6 x 36");
    const DeviceFloats<Device> in(device, queue, float_picture(6, 5, 4, 1)),
        out(device, queue, float_picture(12, 11, 3, 1));
    DeviceUpsamplerTrace trace;
    CHECK_FAULT(network.forward_into(queue, in.read(), out.view(), trace),
                "output has 3 channels of 12 x 11 pixels in 132 columns, expected 3 channels of "
                "12 x 10");
}

} // namespace rye::test
