// SPDX-License-Identifier: Apache-2.0
// Powers of two: nanoseconds per number, and the worst error in units of the last place.
#include <benchmark/benchmark.h>

#include <cmath>

#include <rye/backend/lanes.hpp>
#include <rye/core/random.hpp>
#include <rye/math/exponential.hpp>

#include "../roofline/clock.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

/// On the exponents of blending: [-8, 0].
template <class F>
void measure(benchmark::State& state, const F& each) {
    constexpr int n = 4096, rounds = 200;
    alignas(64) static float x[n], y[n];
    const Random random{3, 1};
    for (int i = 0; i < n; ++i) x[i] = static_cast<float>(-8 * random.uniform(std::uint64_t(i)));
    double s = 1e30;
    for (auto _ : state)
        s = std::min(s, least_time(15, [&] {
            for (int r = 0; r < rounds; ++r) {
                each(x, y, n);
                opaque(y[0]);
            }
        }));
    double worst = 0;
    for (int i = 0; i < n; ++i) {
        const double exact = std::exp2(double(x[i]));
        const double last = std::ldexp(1.0, std::ilogb(exact) - 23);
        worst = std::max(worst, std::abs(double(y[i]) - exact) / last);
    }
    state.counters["ns"] = 1e9 * s / (double(n) * rounds);
    state.counters["ulp"] = worst;
}

template <class E>
void exp2_lanes(benchmark::State& state) {
    using V = XsimdBackend<>::batch<float>;
    measure(state, [](const float* x, float* y, int n) {
        for (int i = 0; i < n; i += static_cast<int>(V::size))
            E()(V::load_aligned(x + i)).store_aligned(y + i);
    });
}
void exp2_scalar(benchmark::State& state) {
    measure(state, [](const float* x, float* y, int n) {
        for (int i = 0; i < n; ++i) y[i] = std::exp2(x[i]);
    });
}
BENCHMARK(exp2_lanes<Exp2Poly<4>>)->Iterations(1);
BENCHMARK(exp2_lanes<Exp2Poly<5>>)->Iterations(1);
BENCHMARK(exp2_lanes<Exp2Poly<6>>)->Iterations(1);
BENCHMARK(exp2_lanes<Exp2Library>)->Iterations(1);
BENCHMARK(exp2_scalar)->Iterations(1);

} // namespace

BENCHMARK_MAIN();
