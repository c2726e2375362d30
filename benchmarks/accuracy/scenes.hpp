// SPDX-License-Identifier: Apache-2.0
/// benchmarks/accuracy/scenes.hpp: scenes for measuring accuracy: a head, and hard cases.
/// World: x right, y down, z forward, unless a camera differs. 128 x 128 pixels, 3 channels.
#pragma once

#include <array>
#include <cmath>
#include <string>
#include <vector>

#include <rye/core/random.hpp>
#include <rye/gaussian/gaussians.hpp>
#include <rye/geometry/camera.hpp>

namespace rye::bench {

struct Scenery {
    std::string name;
    Gaussians<float> gaussians;
    Pinhole<float> camera;
    VecX<float> background = VecX<float>::Zero(3);
};

/// Random numbers of one Gaussian: by stream, at its index.
struct Draw {
    std::uint64_t seed, index;
    double u(std::uint64_t stream) const { return Random{seed, stream}.uniform(index); }
    double n(std::uint64_t stream) const { return Random{seed, stream}.normal(index); }
};

/// Shape, opacity and colour, the same in all scenes: scales median * exp(0.5 n).
inline void paint(Gaussians<float>& g, Index i, const Draw& d, double median) {
    const auto f = [](double x) { return static_cast<float>(x); };
    for (int a = 0; a < 3; ++a)
        g.scale(a, i) = f(median * std::exp(0.5 * d.n(4 + 2 * std::uint64_t(a))));
    double q[4], n = 0;
    for (int k = 0; k < 4; ++k) q[k] = d.n(10 + 2 * std::uint64_t(k)), n += q[k] * q[k];
    for (int k = 0; k < 4; ++k) g.rotation(k, i) = f(q[k] / std::sqrt(n));
    g.opacity(0, i) = f(1 / (1 + std::exp(-1.5 * d.n(18))));
    for (int c = 0; c < 3; ++c) g.feature(c, i) = f(d.u(32 + std::uint64_t(c)));
}

/// A point on the shell of the unit ellipsoid.
inline Vec3<double> on_shell(const Draw& d, double jitter) {
    const double z = 1 - 2 * d.u(0), phi = 6.283185307179586 * d.u(1), rho = std::sqrt(1 - z * z);
    return Vec3<double>(0.88 * rho * std::cos(phi), rho * std::sin(phi), 0.92 * z) *
           (1 + jitter * d.n(2));
}

inline Pinhole<float> front_camera(double focal, double distance) {
    Pinhole<float> c;
    c.fx = c.fy = static_cast<float>(focal);
    c.cx = c.cy = 64;
    c.width = c.height = 128;
    c.camera_from_world.translation = Vec3<float>(0, 0, static_cast<float>(distance));
    return c;
}

/// The accuracy scene: 2000 Gaussians, camera 1 of 16 around the head.
inline Scenery accuracy_head(Index count = 2000, std::uint64_t seed = 3003, double median = 0.05) {
    Scenery s{"head", Gaussians<float>(count, 3), front_camera(215, 0)};
    for (Index i = 0; i < count; ++i) {
        const Draw d{seed, static_cast<std::uint64_t>(i)};
        s.gaussians.mean.col(i) = on_shell(d, 0.03).cast<float>();
        paint(s.gaussians, i, d, median);
    }
    const double th = 6.283185307179586 / 16, ph = 0.2 * std::sin(2 * th);
    const Vec3<double> eye(3.5 * std::sin(th) * std::cos(ph), 3.5 * std::sin(ph),
                           3.5 * std::cos(th) * std::cos(ph));
    const Vec3<double> z = -eye / eye.norm();
    const Vec3<double> x = normalized(cross(z, Vec3<double>(0, 1, 0))), y = cross(z, x);
    Mat3<double> r;
    r << x.transpose(), y.transpose(), z.transpose();
    const Vec3<double> t = -(r * eye);
    const auto round = [](double v) {
        return static_cast<float>(std::round(v * 0x1p30) * 0x1p-30);
    };
    for (int k = 0; k < 9; ++k) s.camera.camera_from_world.rotation.data()[k] = round(r.data()[k]);
    for (int k = 0; k < 3; ++k) s.camera.camera_from_world.translation[k] = round(t[k]);
    return s;
}

/// Two eyeballs of small Gaussians with lids in front of them, close to the camera.
inline Scenery eyes_close() {
    const Index n = 3000;
    Scenery s{"eyes close up", Gaussians<float>(n, 3), front_camera(400, 0.9)};
    for (Index i = 0; i < n; ++i) {
        const Draw d{11, static_cast<std::uint64_t>(i)};
        const double side = i % 2 == 0 ? 0.1 : -0.1;
        const bool lid = i % 10 == 0;
        Vec3<double> p = 0.08 * on_shell(d, 0.01);
        if (lid) p = Vec3<double>(0.12 * (2 * d.u(20) - 1), 0.06 + 0.02 * d.n(22), -0.1);
        p[0] += side;
        s.gaussians.mean.col(i) = p.cast<float>();
        paint(s.gaussians, i, d, lid ? 0.02 : 0.006);
        if (!lid) s.gaussians.scale.row(2)[i] *= 0.1F;
    }
    return s;
}

/// Extent of a cloud and its distance from the camera.
struct CloudPlace {
    double spread = 0.6, distance = 3;
};

inline Scenery random_cloud(const std::string& name, Index n, std::uint64_t seed, double median,
                            const CloudPlace& place = {}) {
    Scenery s{name, Gaussians<float>(n, 3), front_camera(180, place.distance)};
    for (Index i = 0; i < n; ++i) {
        const Draw d{seed, static_cast<std::uint64_t>(i)};
        for (int k = 0; k < 3; ++k)
            s.gaussians.mean(k, i) =
                static_cast<float>(place.spread * d.n(40 + 2 * std::uint64_t(k)));
        paint(s.gaussians, i, d, median);
    }
    s.background << 0.3F, 0.5F, 0.7F;
    return s;
}

/// All scenes but the PLY file's, which the caller appends.
inline std::vector<Scenery> accuracy_scenes() {
    std::vector<Scenery> all{accuracy_head(), eyes_close()};
    {
        auto s = random_cloud("needles", 600, 21, 0.01); // up to some 100 px long
        for (Index i = 0; i < 600; ++i) s.gaussians.scale(0, i) *= i % 3 == 0 ? 100.0F : 20.0F;
        all.push_back(s);
    }
    all.push_back(random_cloud("sub-pixel", 4000, 22, 0.001));
    all.push_back(random_cloud("huge", 60, 23, 5));
    {
        auto s = random_cloud("camera inside", 1500, 24, 0.06, {1, 0});
        s.camera.near_depth = 0.05F;
        all.push_back(s);
    }
    {
        auto s = random_cloud("opaque wall", 600, 25, 0.4);
        s.gaussians.opacity.setOnes();
        all.push_back(s);
    }
    {
        auto s = random_cloud("faint fog", 1500, 26, 0.3); // many layers of little opacity
        s.gaussians.opacity.array() = 0.05F * s.gaussians.opacity.array();
        all.push_back(s);
    }
    {
        auto s = random_cloud("thin sheet", 800, 27, 0.08); // depths that float barely resolves
        s.gaussians.mean.row(2) *= 1e-4F;
        all.push_back(s);
    }
    return all;
}

} // namespace rye::bench
