// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/pictures.hpp: pictures in device memory, of floats and of bytes.
#pragma once

#include <cmath>

#include <rye/backend/cuda/picture.hpp>

#include "../support/scenes.hpp"
#include "device_render.hpp"

namespace rye::test {

/// A picture of numbers in 0..1, rounded to bytes.
inline Image<float> byte_picture(int width, int height, int channels, std::uint64_t seed) {
    Image<float> p(width, height, channels);
    p.pixels = noise<float>(channels, p.size(), seed).unaryExpr([](float x) {
        return std::round((0.5F * x + 0.5F) * 255.0F) / 255.0F;
    });
    return p;
}
/// A picture of any floats in 0..1.
inline Image<float> float_picture(int width, int height, int channels, std::uint64_t seed) {
    Image<float> p(width, height, channels);
    p.pixels =
        noise<float>(channels, p.size(), seed).unaryExpr([](float x) { return 0.5F * x + 0.5F; });
    return p;
}
inline Image<double> in_double(const Image<float>& p) {
    Image<double> r(p.width, p.height, p.channels());
    r.pixels = p.pixels.cast<double>();
    return r;
}

/// Floats of a picture in device memory.
template <class Device>
struct DeviceFloats {
    DeviceArray<Device> array;
    int width, height;

    DeviceFloats(const Device& d, const CudaQueue& q, const Image<float>& from)
        : array(d, q, from.pixels),
          width(from.width),
          height(from.height) {}
    DevicePicture<float> view() const { return {array.view(), width, height}; }
    DevicePicture<const float> read() const { return {array.read(), width, height}; }
};

/// Bytes of a picture of shares of 255 in device memory.
template <class Device>
struct DeviceBytes {
    DeviceBuffer<std::uint8_t> buffer;
    Index channels;
    int width, height;

    DeviceBytes(const Device& device, const CudaQueue& queue, const Image<float>& from)
        : channels(from.channels()),
          width(from.width),
          height(from.height) {
        std::vector<std::uint8_t> bytes(static_cast<std::size_t>(from.pixels.size()));
        for (std::size_t i = 0; i < bytes.size(); ++i)
            bytes[i] = static_cast<std::uint8_t>(std::lround(from.pixels.data()[i] * 255.0F));
        buffer.reserve(queue, bytes.size() + 1);
        device.send(queue, buffer.data(), bytes.data(), bytes.size());
    }
    DevicePicture<const std::uint8_t> read() const {
        return {{buffer.data(), channels, Index(width) * height}, width, height};
    }
};

} // namespace rye::test
