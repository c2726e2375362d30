// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/picture.hpp: a picture in device memory, of floats, or of the bytes that
/// pictures have on disk.
#pragma once

#include <cstdint>
#include <string>

#include <rye/backend/cuda.hpp>

namespace rye {

namespace detail {

/// Returns a number of a picture in 0..1: a float as it is, a byte as a share of 255.
RYE_HD inline float unit_value(float x) { return x; }
/// Returns the same of a byte.
RYE_HD inline float unit_value(std::uint8_t x) { return static_cast<float>(x) / 255.0F; }

} // namespace detail

/// A picture in device memory, channels x (width height), pixel (x, y) in column y width + x.
/// P: const float, const std::uint8_t (shares of 255), or float for one that is written.
template <class P>
struct DevicePicture {
    DeviceColumns<P> pixels;
    int width = 0, height = 0; ///< [px]

    template <class Q>
        requires(std::same_as<Q, const P> && !std::is_const_v<P>)
    operator DevicePicture<Q>() const { return {pixels, width, height}; }
};

namespace detail {

/// Throws an Error unless a picture has that many channels of width x height pixels.
template <class P>
void require_picture(const char* who, const char* what, const DevicePicture<P>& p, Index channels,
                     int width, int height) {
    const auto text = [](Index c, Index w, Index h) {
        return std::to_string(c) + " channels of " + std::to_string(w) + " x " + std::to_string(h);
    };
    require(
        p.pixels.rows == channels && p.width == width && p.height == height &&
            p.pixels.cols == Index(width) * height,
        who, what, " has ", [&] { return text(p.pixels.rows, p.width, p.height); }, " pixels in ",
        p.pixels.cols, " columns, expected ", [&] { return text(channels, width, height); });
}

} // namespace detail

} // namespace rye
