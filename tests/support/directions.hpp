// SPDX-License-Identifier: Apache-2.0
/// tests/support/directions.hpp: directions in the inputs of a render.
#pragma once

#include "scenes.hpp"

namespace rye::test {

/// A direction in the camera's parameters.
template <class T>
Pinhole<T> camera_direction(std::uint64_t seed) {
    const Random random{seed, 5};
    std::uint64_t k = 0;
    const auto any = [&] { return static_cast<T>(random.normal(k++)); };
    Pinhole<T> c;
    c.fx = any(), c.fy = any(), c.cx = any(), c.cy = any();
    for (int i = 0; i < 9; ++i) c.camera_from_world.rotation.data()[i] = T(0.1) * any();
    for (int i = 0; i < 3; ++i) c.camera_from_world.translation[i] = T(0.1) * any();
    return c;
}

/// A direction in the Gaussians of a scene.
template <class T>
Gaussians<T> direction(const Scenery<T>& s, std::uint64_t seed) {
    Gaussians<T> v = noise_like(s.gaussians, seed);
    v.scale = v.scale.cwiseProduct(s.gaussians.scale);
    return v;
}

} // namespace rye::test
