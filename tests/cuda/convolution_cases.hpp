// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/convolution_cases.hpp: layers of images on a device against the host's in double, for
/// the emulated device and a real one.
#pragma once

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/nn/convolution.hpp>
#include <rye/nn/cuda/convolution.hpp>

#include "../support/hostile.hpp"
#include "pictures.hpp"

namespace rye::test {

inline Image<float> noise_image(int width, int height, int channels, std::uint64_t seed) {
    Image<float> p(width, height, channels);
    p.pixels = noise<float>(channels, p.size(), seed);
    return p;
}

/// Planes in device memory.
template <class Device, int N>
struct DevicePlanesOf {
    DeviceBuffer<std::uint16_t> buffer;
    DeviceImagePlanes view;

    template <class Source>
    DevicePlanesOf(const Device& device, const CudaQueue& queue, const Source& source,
                   const DeviceImagePlanes& shape)
        : view(shape) {
        buffer.reserve(queue, shape.halves(N) + 8);
        device.fill(queue, buffer.data(), 0xFF, buffer.bytes());
        view.data = buffer.data();
        image_planes_into<N>(device, queue, source, view);
    }
};

struct ConvolutionCase {
    int width, height, inputs, outputs;
    double bound;
    int weight_blocks = 132;
};

template <int N, class Device>
void convolution_against_host(const Device& device, const CudaQueue& queue,
                              const ConvolutionCase& c) {
    CAPTURE(N);
    CAPTURE(c.width);
    CAPTURE(c.inputs);
    CAPTURE(c.outputs);
    const ScalarBackend<Serial> host;
    const Image<float> image = noise_image(c.width, c.height, c.inputs, 1),
                       cotangent = noise_image(c.width, c.height, c.outputs, 2);
    const Columns<float> weight = noise<float>(c.outputs, 9 * c.inputs, 3),
                         before = noise<float>(c.outputs, 9 * c.inputs, 4);
    const Padded<double> in = padded(host, in_double(image)),
                         g = padded(host, in_double(cotangent));
    const Columns<double> w = weight.cast<double>();
    const Image<double> out = convolve3x3(host, w, in), g_in = convolve3x3_vjp_input(host, w, g);
    Columns<double> g_weight = Columns<double>::Zero(c.outputs, 9 * c.inputs);
    convolve3x3_vjp_weight(host, in, g, g_weight);

    const DeviceFloats<Device> x(device, queue, image), y(device, queue, cotangent);
    const DevicePlanesOf<Device, N> x_planes(
        device, queue, detail::PlainPixels{x.array.buffer.data(), c.width, c.inputs},
        {nullptr, c.width, c.height, c.inputs}),
        y_planes(device, queue, detail::PlainPixels{y.array.buffer.data(), c.width, c.outputs},
                 {nullptr, c.width, c.height, c.outputs});
    const DeviceArray<Device> weights(device, queue, weight),
        to(device, queue, c.outputs, x.width * x.height),
        to_in(device, queue, c.inputs, x.width * x.height), to_weight(device, queue, before),
        again(device, queue, before), bias(device, queue, noise<float>(c.outputs, 1, 5));
    DeviceConvolution<Device, N> layer(device, c.inputs, c.outputs);
    layer.weight_blocks = c.weight_blocks;
    CHECK_FAULT(layer.forward_into(queue, x_planes.view, to.buffer.data()), "weights were not set");
    layer.set(queue, weights.read());
    layer.forward_into(queue, x_planes.view, to.buffer.data());
    layer.vjp_input_into(queue, y_planes.view, to_in.buffer.data());
    DeviceBuffer<float> partial;
    for (const auto* const g_to : {&to_weight, &again})
        layer.vjp_weight_into(queue, x_planes.view, y_planes.view, g_to->buffer.data(), partial);
    CHECK(relative(to.get(), out.pixels) <= c.bound);
    CHECK(relative(to_in.get(), g_in.pixels) <= c.bound);
    const Columns<double> own = to_weight.get().template cast<double>() - before.cast<double>();
    CHECK(relative(own, g_weight) <= c.bound + 2e-7);
    CHECK(again.get() == to_weight.get());

    Image<double> activated = out;
    const Columns<double> b = noise<float>(c.outputs, 1, 5).template cast<double>();
    activated.pixels.colwise() += b.col(0);
    activated.pixels = activated.pixels.cwiseMax(0.0);
    layer.forward_into(queue, x_planes.view, to.buffer.data(), bias.buffer.data());
    CHECK(relative(to.get(), activated.pixels) <= c.bound);
}

template <class Device>
void convolution_faults(const Device& device, const CudaQueue& queue) {
    DeviceConvolution<Device, 1> layer(device, 3, 4);
    const DeviceArray<Device> wrong(device, queue, noise<float>(4, 26, 1));
    CHECK_FAULT(layer.set(queue, wrong.read()), "weights are 4 x 26, expected 4 x 27");
    CHECK_FAULT(layer.forward_into(queue, {nullptr, 5, 5, 4}, nullptr),
                "image has 4 channels, expected 3");
    using Layer = DeviceConvolution<Device, 1>;
    CHECK_FAULT(Layer(device, 0, 4), "got 0 inputs and 4 outputs, expected at least 1");
}

} // namespace rye::test
