// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/noise.hpp: smooth random fields in 3D, from a seed.
/// Source: Perlin, "Improving noise", 2002; Worley, "A cellular texture basis function", 1996.
#pragma once

#include <algorithm>
#include <cmath>

#include <rye/core/columns.hpp>
#include <rye/core/random.hpp>

namespace rye::trainer {

/// 0 below a, 1 above b (or the reverse where b < a), smooth between.
inline double smooth_step(double a, double b, double x) {
    const double t = std::clamp((x - a) / (b - a), 0.0, 1.0);
    return t * t * (3 - 2 * t);
}

/// A random number per cell of the lattice.
inline std::uint64_t cell_key(std::uint64_t seed, const Vec3<double>& cell) {
    const auto k = [](double x) {
        return static_cast<std::uint64_t>(static_cast<std::int64_t>(x));
    };
    return mix64(seed + k(cell.x()) * 0x9E3779B97F4A7C15ULL + k(cell.y()) * 0xD1B54A32D192ED03ULL +
                 k(cell.z()) * 0x8CB92BA72F3D8DD7ULL);
}

/// Gradient noise, about -0.7 to 0.7, features of size 1.
inline double noise(std::uint64_t seed, const Vec3<double>& p) {
    const Vec3<double> cell(std::floor(p.x()), std::floor(p.y()), std::floor(p.z()));
    const Vec3<double> f = p - cell;
    const auto fade = [](double t) { return t * t * t * (t * (t * 6 - 15) + 10); };
    const Vec3<double> w(fade(f.x()), fade(f.y()), fade(f.z()));
    double sum = 0;
    for (int i = 0; i < 8; ++i) {
        const Vec3<double> corner(i & 1, (i >> 1) & 1, i >> 2);
        const std::uint64_t h = cell_key(seed, cell + corner);
        constexpr double step = 2.0 / 0xFFFFF;
        const Vec3<double> slope(step * static_cast<double>(h & 0xFFFFF) - 1,
                                 step * static_cast<double>((h >> 20) & 0xFFFFF) - 1,
                                 step * static_cast<double>((h >> 40) & 0xFFFFF) - 1);
        double weight = 1;
        for (int d = 0; d < 3; ++d) weight *= corner[d] > 0 ? w[d] : 1 - w[d];
        sum += weight * slope.dot(f - corner);
    }
    return sum;
}

/// Fractal noise: octaves of doubled frequency and half the amplitude.
inline double fractal(std::uint64_t seed, Vec3<double> p, int octaves) {
    double sum = 0, strength = 1;
    for (int i = 0; i < octaves; ++i) {
        sum += strength * noise(seed + static_cast<std::uint64_t>(i), p);
        p *= 2.03;
        strength *= 0.5;
    }
    return sum;
}

/// Round spots, at most one a cell of size 1: 1 at a spot's middle, 0 outside. `share` of the cells
/// have one, of radius `small` to twice that.
inline double spots(std::uint64_t seed, const Vec3<double>& p, double share, double small) {
    const Vec3<double> cell(std::floor(p.x()), std::floor(p.y()), std::floor(p.z()));
    double best = 0;
    for (int i = 0; i < 27; ++i) {
        const Vec3<double> c = cell + Vec3<double>(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1);
        const std::uint64_t key = cell_key(seed, c);
        if (static_cast<double>(key >> 40U) * 0x1.0p-24 > share) continue;
        const Random r{key};
        const Vec3<double> at = c + Vec3<double>(r.uniform(1), r.uniform(2), r.uniform(3));
        const double radius = small * (1 + r.uniform(4));
        best = std::max(best, 1 - smooth_step(0.5, 1.0, (p - at).norm() / radius));
    }
    return best;
}

} // namespace rye::trainer
