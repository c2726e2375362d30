// SPDX-License-Identifier: Apache-2.0
/// tests/hard_cases/screens.hpp: scenes of a few large, flat Gaussians in front of a small camera,
/// with blended values in closed form; and the backends to test renders on.
#pragma once

#include <rye/splat/lanes.hpp>

#include "../support/scenes.hpp"
#include "report.hpp"

namespace rye::hard {

using Plain = ScalarBackend<Serial>;
using Wide = XsimdBackend<DefaultArch, Serial>;
using Narrow = XsimdBackend<xsimd::sse4_2, Serial>;

template <class B>
const char* backend_name() {
    if constexpr (std::is_same_v<B, Plain>)
        return "scalar backend";
    else if constexpr (std::is_same_v<B, Narrow>)
        return "SSE backend";
    else
        return "lanes backend";
}
template <class B, class T>
std::string kind() {
    return kind_of<T>() + ", " + backend_name<B>();
}

template <class T>
struct Screen {
    Gaussians<T> gaussians;
    Pinhole<T> camera;
    VecX<T> background;
};

/// n Gaussians one behind the other on the axis, 25 px wide, in a 9 x 9 image of C channels.
template <class T>
Screen<T> layers(Index n, Index channels, T opacity) {
    Screen<T> s{Gaussians<T>(n, channels), {}, VecX<T>::Zero(channels)};
    s.gaussians.mean.setZero();
    s.gaussians.rotation.setZero();
    s.gaussians.rotation.row(0).setOnes();
    s.gaussians.scale.setConstant(T(50));
    s.gaussians.opacity.setConstant(opacity);
    s.gaussians.feature.setConstant(T(1));
    for (Index i = 0; i < n; ++i) s.gaussians.mean(2, i) = T(0.001) * static_cast<T>(i);
    s.camera.fx = s.camera.fy = T(50);
    s.camera.cx = s.camera.cy = T(4.5);
    s.camera.width = s.camera.height = 9;
    s.camera.camera_from_world.translation = Vec3<T>(T(0), T(0), T(100));
    return s;
}

/// A random cloud of unit size, 3 in front of an uneven image.
template <class T>
Screen<T> cloud(Index n, Index channels, std::uint64_t seed, double size = 0.08) {
    const test::Scenery<T> s = test::random_scene<T>(n, channels, seed, size);
    return {s.gaussians, s.camera, VecX<T>::Constant(channels, T(0.3))};
}

template <class B, class T>
Raster<T> draw(const Screen<T>& s, const Balanced& accuracy = {}) {
    return Rasterizer<>{accuracy}.forward(B{}, s.gaussians, s.camera, s.background);
}
/// Gradients for cotangents of 1 at every channel of every pixel.
template <class B, class T>
Gaussians<T> pull(const Screen<T>& s, const Raster<T>& r, const Balanced& accuracy = {}) {
    const Columns<T> ones = Columns<T>::Ones(s.gaussians.channels(), r.feature.size());
    return Rasterizer<>{accuracy}.vjp(B{}, s.gaussians, s.camera, s.background, r, ones);
}

/// f.template operator()<B, T>() for every backend and both widths.
template <class F>
void every_backend(F&& f) {
    f.template operator()<Plain, float>();
    f.template operator()<Plain, double>();
    f.template operator()<Wide, float>();
    f.template operator()<Wide, double>();
    f.template operator()<Narrow, float>();
}

} // namespace rye::hard
