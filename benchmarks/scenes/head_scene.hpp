// SPDX-License-Identifier: Apache-2.0
/// benchmarks/scenes/head_scene.hpp: the timed head, the same bytes everywhere.
/// An ellipsoidal shell of Gaussians as large as a head, seen from 3.5 units away in 512 x 512
/// pixels. Everything is generated from the number of Gaussians and a seed by splitmix64; a channel
/// does not depend on the number of channels. Cotangents are uniform noise.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include <rye/core/random.hpp>
#include <rye/gaussian/gaussians.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/splat/accuracy.hpp>

namespace rye::bench {

/// One stream of splitmix64, read in order.
struct Stream {
    std::uint64_t state;

    std::uint64_t bits() {
        const std::uint64_t z = mix64(state);
        state += 0x9E3779B97F4A7C15ULL;
        return z;
    }
    double uniform() { return static_cast<double>(bits() >> 11U) * 0x1.0p-53; }
    double normal() {
        const double a = 1.0 - uniform(), b = uniform();
        return std::sqrt(-2.0 * std::log(a)) * std::cos(6.283185307179586 * b);
    }
};

/// Rules of the timed renders: contributions below 1/255 are skipped, and a pixel is full before
/// its transmittance would fall to 1e-4. The yardstick of benchmarks/naive has the same rules.
struct HeadRules : Balanced {
    constexpr HeadRules() {
        alpha_min = 1.0 / 255.0;
        stop = 1e-4;
    }
    static constexpr Stop stop_rule = Stop::exclusive;
    static constexpr Outputs outputs = features_only;
};

struct HeadScene {
    Gaussians<float> gaussians;
    Pinhole<float> camera;
    VecX<float> background;
    Columns<float> cotangent;    ///< d loss / d image: channels x pixels
};

inline HeadScene head_scene(Index count, int channels, int size = 512, std::uint64_t seed = 1) {
    HeadScene s{Gaussians<float>(count, channels), Pinhole<float>(),
                VecX<float>::Zero(channels),
                Columns<float>(channels, Index(size) * size)};
    const auto f = [](double x) { return static_cast<float>(x); };
    Stream g{0x5EED0000ULL + seed};
    for (Index i = 0; i < count; ++i) {
        double d[3], q[4];
        for (double& x : d) x = g.normal();
        const double along = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        const double jitter = 1 + 0.02 * (2 * g.uniform() - 1);
        constexpr double axes[3] = {0.78, 1.00, 0.88};
        for (int k = 0; k < 3; ++k)
            s.gaussians.mean(k, i) = f(axes[k] * jitter * (d[k] / along));
        for (int k = 0; k < 3; ++k)
            s.gaussians.scale(k, i) = f(std::exp(-4.605170185988091 + 0.5 * g.normal()));
        for (double& x : q) x = g.normal();
        const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
        for (int k = 0; k < 4; ++k) s.gaussians.rotation(k, i) = f(q[k] / norm);
        s.gaussians.opacity(0, i) = f(1 / (1 + std::exp(-1.5 * g.normal())));
    }
    for (int c = 0; c < channels; ++c) {
        const auto at = seed * 1000 + static_cast<std::uint64_t>(c);
        Stream colour{0xC0100000ULL + at}, upstream{0xD0000000ULL + at};
        for (Index i = 0; i < count; ++i) s.gaussians.feature(c, i) = f(colour.uniform());
        for (Index p = 0; p < s.cotangent.cols(); ++p)
            s.cotangent(c, p) = f(2 * upstream.uniform() - 1);
    }
    const float scale = static_cast<float>(size) / 512.0F;
    s.camera.fx = s.camera.fy = 607 * scale;
    s.camera.cx = s.camera.cy = 256 * scale;
    s.camera.width = s.camera.height = size;
    s.camera.near_depth = 0.2F;
    s.camera.camera_from_world.translation = Vec3<float>(0, 0, 3.5F);
    return s;
}

/// FNV-1a over the bytes of the Gaussians' arrays, from the basis of the recorded checksums.
inline std::uint64_t checksum(const Gaussians<float>& g) {
    std::uint64_t h = 1469598103934665603ULL;
    const auto add = [&](const Columns<float>& a) {
        const auto* bytes = static_cast<const unsigned char*>(static_cast<const void*>(a.data()));
        for (std::size_t i = 0; i < static_cast<std::size_t>(a.size()) * sizeof(float); ++i)
            h = (h ^ bytes[i]) * 0x100000001B3ULL;
    };
    add(g.mean);
    add(g.scale);
    add(g.rotation);
    add(g.opacity);
    add(g.feature);
    return h;
}

} // namespace rye::bench
