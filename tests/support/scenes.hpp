// SPDX-License-Identifier: Apache-2.0
/// tests/support/scenes.hpp: random and hard scenes for tests of splatting.
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include <rye/core/random.hpp>
#include <rye/gaussian/gaussians.hpp>
#include <rye/geometry/camera.hpp>

namespace rye::test {

template <class T>
struct Scenery {
    std::string name;
    Gaussians<T> gaussians;
    Pinhole<T> camera;
    VecX<T> background;
};

/// Numbers in (-1, 1).
template <class T>
Columns<T> noise(Index rows, Index cols, std::uint64_t seed) {
    const Random random{seed, 5};
    Columns<T> a(rows, cols);
    for (Index i = 0; i < a.size(); ++i)
        a.data()[i] = static_cast<T>(2 * random.uniform(static_cast<std::uint64_t>(i)) - 1);
    return a;
}

/// A tangent or a cotangent of Gaussians.
template <class T>
Gaussians<T> noise_like(const Gaussians<T>& g, std::uint64_t seed) {
    Gaussians<T> r;
    Gaussians<T>::fields(
        [&](const std::string&, Columns<T>& a, const Columns<T>& like) {
            a = noise<T>(like.rows(), like.cols(), seed++);
        },
        r, g);
    return r;
}

/// A cloud of unit size, 3 in front of a camera with an uneven image.
template <class T>
Scenery<T> random_scene(Index n, Index channels, std::uint64_t seed, double size = 0.08) {
    const Random random{seed, 1};
    std::uint64_t k = 0;
    Scenery<T> s{"random", Gaussians<T>(n, channels), Pinhole<T>(), VecX<T>(channels)};
    Gaussians<T>& g = s.gaussians;
    for (Index i = 0; i < n; ++i) {
        for (Index j = 0; j < 3; ++j) g.mean(j, i) = static_cast<T>(0.6 * random.normal(k++));
        for (Index j = 0; j < 4; ++j) g.rotation(j, i) = static_cast<T>(random.normal(k++));
        for (Index j = 0; j < 3; ++j)
            g.scale(j, i) = static_cast<T>(size * std::exp(0.7 * random.normal(k++)));
        g.opacity(0, i) = static_cast<T>(random.uniform(k++));
        for (Index c = 0; c < channels; ++c) g.feature(c, i) = static_cast<T>(random.uniform(k++));
    }
    s.camera.fx = T(50);
    s.camera.fy = T(55);
    s.camera.cx = T(20);
    s.camera.cy = T(11);
    s.camera.width = 37;
    s.camera.height = 29;
    s.camera.camera_from_world.translation = Vec3<T>(T(0.125), T(0.0625), T(3));
    for (Index c = 0; c < channels; ++c) s.background[c] = static_cast<T>(0.1 * double(c) + 0.3);
    return s;
}

template <class T>
std::vector<Scenery<T>> hard_scenes(Index channels) {
    std::vector<Scenery<T>> all;
    const auto base = [&](const char* name, Index n, double size = 0.08) {
        Scenery<T> s = random_scene<T>(n, channels, 7 + all.size(), size);
        s.name = name;
        return s;
    };
    {
        Scenery<T> s = base("needles of 300 px", 20);
        for (Index i = 0; i < 20; ++i) s.gaussians.scale.col(i) << T(18), T(1e-3), T(1e-3);
        all.push_back(s);
    }
    {
        Scenery<T> s = base("principal point outside the image", 60);
        s.camera.cx = T(-30);
        s.camera.cy = T(70);
        s.camera.camera_from_world.translation = Vec3<T>(T(2.6), T(-3), T(3));
        all.push_back(s);
    }
    {
        Scenery<T> s = base("camera inside the cloud", 80, 0.2);
        s.camera.camera_from_world.translation = Vec3<T>(T(0), T(0), T(0));
        s.camera.near_depth = T(0.05);
        all.push_back(s);
    }
    {
        Scenery<T> s = base("opaque wall", 60, 0.5);
        s.gaussians.opacity.setConstant(T(1));
        all.push_back(s);
    }
    {
        Scenery<T> s = base("ties in depth", 60, 0.3);
        s.gaussians.mean.row(2).setZero();
        all.push_back(s);
    }
    {
        Scenery<T> s = base("below a pixel", 60, 1e-4);
        s.gaussians.scale.row(1).setZero();
        all.push_back(s);
    }
    {
        Scenery<T> s = base("beside the image", 40, 0.5);
        for (Index i = 0; i < 40; ++i) s.gaussians.mean(0, i) += i % 2 == 0 ? T(3) : T(-3);
        all.push_back(s);
    }
    {
        Scenery<T> s = base("huge", 10, 30);
        all.push_back(s);
    }
    {
        Scenery<T> s = base("one pixel", 30);
        s.camera.width = s.camera.height = 1;
        s.camera.cx = s.camera.cy = T(0.5);
        all.push_back(s);
    }
    all.push_back(base("nothing", 0));
    {
        Scenery<T> s = base("all behind", 20);
        s.camera.camera_from_world.translation = Vec3<T>(T(0), T(0), T(-9));
        all.push_back(s);
    }
    return all;
}

// Compiled once, in scenes.cpp.
extern template Scenery<float> random_scene(Index, Index, std::uint64_t, double);
extern template Scenery<double> random_scene(Index, Index, std::uint64_t, double);
extern template std::vector<Scenery<float>> hard_scenes(Index);
extern template std::vector<Scenery<double>> hard_scenes(Index);
extern template Gaussians<float> noise_like(const Gaussians<float>&, std::uint64_t);
extern template Gaussians<double> noise_like(const Gaussians<double>&, std::uint64_t);

} // namespace rye::test
