// SPDX-License-Identifier: Apache-2.0
/// benchmarks/roofline/machine.hpp: peak rates of this machine, measured in the run that uses them:
/// fused products, bytes, sorted keys; and lower bounds on the time of a piece of work.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <ctime>
#include <vector>

#include <rye/backend/lanes.hpp>
#include <rye/core/random.hpp>
#include <rye/splat/tile_lists.hpp>

namespace rye::bench {

/// CPU time of this thread [s], independent of other load.
inline double thread_seconds() {
    std::timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}
/// Wall-clock time [s].
inline double wall_seconds() {
    std::timespec t{};
    clock_gettime(CLOCK_MONOTONIC, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

/// The minimum of several times of f() [s].
template <class F>
double least_time(int times, F&& f) {
    double least = 1e30;
    for (int i = 0; i < times; ++i) {
        const double start = thread_seconds();
        f();
        least = std::min(least, thread_seconds() - start);
    }
    return least;
}

/// Prevents the compiler from assuming that x is unread or unchanged.
template <class X>
void opaque(X& x) {
    asm volatile("" : "+m"(x) : : "memory");
}

/// Peak rates of one thread.
struct Machine {
    double flops;            ///< float, a fused product counting as two [1/s]
    double bytes;            ///< a = b + s c from memory, three arrays counted [1/s]
    double keys;             ///< 32-bit keys sorted with 32-bit values, 100000 of them [1/s]
};

/// Ten chains of `rounds` fused products each, in lanes.
inline void fused_products(int rounds) {
    using V = XsimdBackend<>::batch<float>;
    V a0(1.F), a1(1.F), a2(1.F), a3(1.F), a4(1.F), a5(1.F), a6(1.F), a7(1.F), a8(1.F), a9(1.F);
    float numbers[2] = {0.999F, 1e-3F};
    opaque(numbers);
    const V x(numbers[0]), y(numbers[1]);
    for (int i = 0; i < rounds; ++i) {       // ten named chains: an array would go to memory
        a0 = fma(a0, x, y), a1 = fma(a1, x, y), a2 = fma(a2, x, y), a3 = fma(a3, x, y);
        a4 = fma(a4, x, y), a5 = fma(a5, x, y), a6 = fma(a6, x, y), a7 = fma(a7, x, y);
        a8 = fma(a8, x, y), a9 = fma(a9, x, y);
    }
    V sum = ((a0 + a1) + (a2 + a3)) + ((a4 + a5) + (a6 + a7)) + (a8 + a9);
    opaque(sum);
}

inline double peak_flops() {
    constexpr int rounds = 200000;
    const double s = least_time(15, [] { fused_products(rounds); });
    return rounds * 10.0 * 2.0 * static_cast<double>(XsimdBackend<>::batch<float>::size) / s;
}

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

/// Measured once a process.
inline const Machine& machine() {
    static const Machine m{peak_flops(), memory_bytes(), sorted_keys()};
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
