// SPDX-License-Identifier: Apache-2.0
/// benchmarks/cuda/scenes.hpp: the scenes that splatting on a device is timed on, the same bytes
/// everywhere: every number is a function of (seed, stream, index). `head`: an ellipsoidal shell,
/// 512 x 512 pixels; `scene`: a frustum full of Gaussians with harmonics of degree 3, 1920 x 1080;
/// `acc2k`: a small head, for accuracy. Sixteen cameras go around.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <rye/core/random.hpp>
#include <rye/gaussian/gaussians.hpp>
#include <rye/geometry/camera.hpp>

namespace rye::bench {

/// One seed's numbers.
struct Numbers {
    std::uint64_t seed;

    double uniform(std::uint64_t stream, std::uint64_t i) const {
        const std::uint64_t bits = mix64(mix64(seed ^ (stream * 0xD1B54A32D192ED03ULL)) + i);
        return (static_cast<double>(bits >> 40U) + 0.5) * 0x1p-24;
    }
    double normal(std::uint64_t stream, std::uint64_t i) const {
        return std::sqrt(-2 * std::log(uniform(stream, i))) *
               std::cos(2 * 3.14159265358979323846 * uniform(stream + 1, i));
    }
};

struct DeviceScenery {
    std::string name;
    Gaussians<float> gaussians;          ///< features are colours, or of harmonics not yet
    Columns<float> sh_constant, sh_rest; ///< of scenes with harmonics
    std::vector<Pinhole<float>> cameras;
    std::vector<Vec3<float>> eyes;
};

namespace detail {

inline float single(double x) { return static_cast<float>(x); }

/// Multiples of 2^-30, so that what cosines leave of 0 is 0.
inline double rounded(double x) { return std::round(x * 0x1p30) * 0x1p-30 + 0.0; }

inline void add_shapes(DeviceScenery& s, const Numbers& r, double size) {
    Gaussians<float>& g = s.gaussians;
    for (Index i = 0; i < g.count(); ++i) {
        const auto at = static_cast<std::uint64_t>(i);
        double q[4], norm = 0;
        for (std::uint64_t k = 0; k < 3; ++k)
            g.scale(Index(k), i) = single(size * std::exp(0.5 * r.normal(4 + 2 * k, at)));
        for (std::uint64_t k = 0; k < 4; ++k) q[k] = r.normal(10 + 2 * k, at), norm += q[k] * q[k];
        for (int k = 0; k < 4; ++k) g.rotation(k, i) = single(q[k] / std::sqrt(norm));
        g.opacity(0, i) = single(1 / (1 + std::exp(-1.5 * r.normal(18, at))));
    }
}

inline Pinhole<float> camera(const double (&rotation)[3][3], const double (&eye)[3], int width,
                             int height, double focal) {
    Pinhole<float> c;
    for (int i = 0; i < 3; ++i) {
        double t = 0;
        for (int k = 0; k < 3; ++k) {
            c.camera_from_world.rotation(i, k) = single(rounded(rotation[i][k]));
            t -= rotation[i][k] * eye[k];
        }
        c.camera_from_world.translation[i] = single(rounded(t));
    }
    c.fx = c.fy = single(focal);
    c.cx = single(width / 2.0);
    c.cy = single(height / 2.0);
    c.width = width;
    c.height = height;
    return c;
}

} // namespace detail

inline DeviceScenery head(Index count, int channels, int size = 512, double focal = 860,
                          std::uint64_t seed = 1001, double scale = 0.01) {
    using detail::single;
    DeviceScenery s;
    s.name = count == 2000 ? "acc2k" : "head" + std::to_string(count / 1000) + "k";
    s.name += "_c" + std::to_string(channels);
    s.gaussians = Gaussians<float>(count, channels);
    const Numbers r{seed};
    constexpr double pi = 3.14159265358979323846;
    for (Index i = 0; i < count; ++i) {
        const auto at = static_cast<std::uint64_t>(i);
        const double z = 1 - 2 * r.uniform(0, at), phi = 2 * pi * r.uniform(1, at);
        const double rho = std::sqrt(1 - z * z), shell = 1 + 0.03 * r.normal(2, at);
        s.gaussians.mean(0, i) = single(0.88 * rho * std::cos(phi) * shell);
        s.gaussians.mean(1, i) = single(1.0 * rho * std::sin(phi) * shell);
        s.gaussians.mean(2, i) = single(0.92 * z * shell);
        for (int c = 0; c < channels; ++c)
            s.gaussians.feature(c, i) = single(r.uniform(32 + static_cast<std::uint64_t>(c), at));
    }
    detail::add_shapes(s, r, scale);
    for (int k = 0; k < 16; ++k) {
        const double th = 2 * pi * k / 16, ph = 0.2 * std::sin(2 * th);
        const double eye[3] = {3.5 * std::sin(th) * std::cos(ph), 3.5 * std::sin(ph),
                               3.5 * std::cos(th) * std::cos(ph)};
        double f[3], right[3], down[3];
        for (int a = 0; a < 3; ++a) f[a] = -eye[a] / 3.5;
        right[0] = -f[2], right[1] = 0, right[2] = f[0]; // f x (0, 1, 0)
        const double n = std::sqrt(right[0] * right[0] + right[2] * right[2]);
        for (double& x : right) x /= n;
        down[0] = f[1] * right[2] - f[2] * right[1];
        down[1] = f[2] * right[0] - f[0] * right[2];
        down[2] = f[0] * right[1] - f[1] * right[0];
        const double rotation[3][3] = {
            {right[0], right[1], right[2]}, {down[0], down[1], down[2]}, {f[0], f[1], f[2]}};
        s.cameras.push_back(detail::camera(rotation, eye, size, size, focal));
        s.eyes.emplace_back(single(eye[0]), single(eye[1]), single(eye[2]));
    }
    return s;
}

inline DeviceScenery frustum(Index count) {
    using detail::single;
    DeviceScenery s;
    s.name = "scene" + std::to_string(count / 1000000) + "m_sh3";
    s.gaussians = Gaussians<float>(count, 3);
    s.gaussians.feature.setZero();
    s.sh_constant.resize(3, count);
    s.sh_rest.resize(45, count);
    const Numbers r{2002};
    for (Index i = 0; i < count; ++i) {
        const auto at = static_cast<std::uint64_t>(i);
        const double a = r.uniform(0, at), b = r.uniform(1, at), c = r.uniform(2, at);
        const double z = 1 + 3 * c;
        s.gaussians.mean(0, i) = single((2 * a - 1) * z * 960 / 1660);
        s.gaussians.mean(1, i) = single((2 * b - 1) * z * 540 / 1660);
        s.gaussians.mean(2, i) = single(z);
        for (std::uint64_t k = 0; k < 16; ++k)
            for (std::uint64_t ch = 0; ch < 3; ++ch) {
                const double v = r.uniform(64 + 3 * k + ch, at) - 0.5;
                if (k == 0)
                    s.sh_constant(Index(ch), i) = single(v / 0.28209479177387814);
                else
                    s.sh_rest(Index(15 * ch + k - 1), i) = single(0.3 * v);
            }
    }
    detail::add_shapes(s, r, 0.005);
    constexpr double pi = 3.14159265358979323846, degree = pi / 180;
    for (int k = 0; k < 16; ++k) {
        const double t = 2 * pi * k / 16;
        const double yaw = 4 * degree * std::sin(t), pitch = 2 * degree * std::sin(t + 1);
        const double eye[3] = {0.05 * std::sin(t), 0.05 * (1 - std::cos(t)), 0};
        const double cy = std::cos(yaw), sy = std::sin(yaw), cp = std::cos(pitch),
                     sp = std::sin(pitch);
        const double rotation[3][3] = {
            {cy, 0, sy}, {sp * sy, cp, -sp * cy}, {-cp * sy, sp, cp * cy}};
        s.cameras.push_back(detail::camera(rotation, eye, 1920, 1080, 1660));
        s.eyes.emplace_back(single(eye[0]), single(eye[1]), single(eye[2]));
    }
    return s;
}

/// FNV-1a over the arrays, so that runs can be told to be of the same scene.
inline std::uint64_t checksum(const DeviceScenery& s) {
    std::uint64_t h = 14695981039346656037ULL;
    const auto add = [&](const Columns<float>& a) {
        const auto* bytes = reinterpret_cast<const unsigned char*>(a.data());
        for (std::size_t i = 0; i < static_cast<std::size_t>(a.size()) * sizeof(float); ++i)
            h = (h ^ bytes[i]) * 0x100000001B3ULL;
    };
    const Gaussians<float>& g = s.gaussians;
    for (const auto* a :
         {&g.mean, &g.rotation, &g.scale, &g.opacity, &g.feature, &s.sh_constant, &s.sh_rest})
        add(*a);
    return h;
}

} // namespace rye::bench
