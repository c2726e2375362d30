// SPDX-License-Identifier: Apache-2.0
/// benchmarks/roofline/machine.hpp: peak rates of this machine, measured in the run that uses them:
/// fused products, bytes, sorted keys; and lower bounds on the time of a piece of work.
#pragma once

#include <cstdint>
#include <vector>

#include <rye/core/random.hpp>
#include <rye/splat/tile_lists.hpp>

#include "products.hpp"

namespace rye::bench {

/// Peak rates of one thread.
struct Machine {
    double flops;            ///< float, a fused product counting as two [1/s]
    double bytes;            ///< a = b + s c from memory, three arrays counted [1/s]
    double keys;             ///< 32-bit keys sorted with 32-bit values, 100000 of them [1/s]
};

inline double memory_bytes() {
    const std::size_t n = std::size_t(1) << 24U;
    std::vector<float> a(n, 0.F), b(n, 1.F), c(n, 2.F);
    const double s = least_time(5, [&] {
        for (std::size_t i = 0; i < n; ++i) a[i] = b[i] + 3.F * c[i];
        opaque(a[0]);
    });
    return 12.0 * static_cast<double>(n) / s;
}

inline double sorted_keys() {
    constexpr std::size_t n = 100000;
    std::vector<Keyed<std::uint32_t>> unsorted(n), x(n), buffer(n);
    const Random random{1, 1};
    for (std::size_t i = 0; i < n; ++i)
        unsorted[i] = {static_cast<std::uint32_t>(random.bits(i) >> 32U),
                       static_cast<std::uint32_t>(i)};
    double least = 1e30;
    for (int i = 0; i < 15; ++i) {
        x = unsorted;
        least = std::min(least,
                         least_time(1, [&] { sort_by_key(x.data(), buffer.data(), Index(n)); }));
    }
    return static_cast<double>(n) / least;
}

/// The peak rate of products, measured once a process.
inline const PeakTurns& peak() {
    static const PeakTurns best = [] {
        PeakTurns t;
        for (int i = 0; i < 100; ++i) t.turn();
        return t;
    }();
    return best;
}

/// All of it, measured once a process.
inline const Machine& machine() {
    static const Machine m{peak().flops, memory_bytes(), sorted_keys()};
    return m;
}

/// The work of a render, independent of the implementation.
struct SplatWork {
    double gaussians, channels, pixels;
    double pairs;            ///< pixel-Gaussian pairs that are blended

    /// Products and sums of a blended pair: exponent, 2^x of degree 5, transmittance, and two for
    /// each channel; backward as often again and the moments.
    double forward_flops() const { return pairs * 2 * (8 + channels); }
    double backward_flops() const { return pairs * 2 * (21 + 2 * channels); }
    /// Reads every input and writes every output once.
    double forward_bytes() const {
        return 4 * (gaussians * (11 + channels) + pixels * (channels + 2));
    }
    double backward_bytes() const {
        return 4 * (2 * gaussians * (11 + channels) + pixels * channels);
    }
    /// Lower bound on the time of one thread [s].
    double forward_floor(const Machine& m) const {
        return forward_flops() / m.flops + forward_bytes() / m.bytes + gaussians / m.keys;
    }
    double floor(const Machine& m) const {
        return forward_floor(m) + backward_flops() / m.flops + backward_bytes() / m.bytes;
    }
};

} // namespace rye::bench
