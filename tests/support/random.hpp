// SPDX-License-Identifier: Apache-2.0
/// tests/support/random.hpp: random arrays and images, the same in every run.
#pragma once

#include <rye/core/columns.hpp>
#include <rye/core/random.hpp>

namespace rye {

/// Uniform in (-1, 1).
template <class T>
Columns<T> random_columns(Index rows, Index cols, std::uint64_t seed) {
    const Random r{seed, 3};
    Columns<T> a(rows, cols);
    for (Index i = 0; i < a.size(); ++i)
        a(i) = T(2.0 * r.uniform(static_cast<std::uint64_t>(i)) - 1.0);
    return a;
}

/// Uniform in (-1, 1).
template <class T>
Image<T> random_image(int width, int height, int channels, std::uint64_t seed) {
    Image<T> image(width, height, channels);
    image.pixels = random_columns<T>(channels, image.size(), seed);
    return image;
}

/// Brightnesses, uniform in [0, 1).
inline Columns<double> random_pixels(Index channels, Index pixels, std::uint64_t seed) {
    Columns<double> a(channels, pixels);
    for (Index i = 0; i < a.size(); ++i)
        a(i) = Random{seed, 0}.uniform(static_cast<std::uint64_t>(i));
    return a;
}
inline Image<double> random_photograph(int width, int height, int channels, std::uint64_t seed) {
    Image<double> image(width, height, channels);
    image.pixels = random_pixels(channels, image.size(), seed);
    return image;
}

} // namespace rye
