// SPDX-License-Identifier: Apache-2.0
#include "peak.hpp"

#include <algorithm>
#include <barrier>
#include <thread>
#include <vector>

#include "../roofline/machine.hpp"

namespace rye::bench {
namespace {

/// The least wall time of work(i) on n threads that begin at once [s], of five.
template <class F>
double least_together(int threads, F&& work) {
    double least = 1e30;
    for (int round = 0; round < 5; ++round) {
        std::barrier<> gate(threads + 1);
        std::vector<std::jthread> all;
        for (int i = 0; i < threads; ++i)
            all.emplace_back([&, i] {
                gate.arrive_and_wait();
                gate.arrive_and_wait();
                work(i);
                gate.arrive_and_wait();
            });
        gate.arrive_and_wait(); // all are there
        const double start = wall_seconds();
        gate.arrive_and_wait();
        gate.arrive_and_wait();
        least = std::min(least, wall_seconds() - start);
    }
    return least;
}

} // namespace

double measured_peak() { return peak().flops(); }

Together measured_together(int threads) {
    const auto products = [](int) { fused_products(8000000); };
    constexpr std::size_t n = std::size_t(1) << 22U; // a thread's arrays: 48 MiB
    const auto many = static_cast<std::size_t>(threads);
    std::vector<float> a(n * many, 0.F), b(n * many, 1.F), c(n * many, 2.F);
    const auto bytes = [&](int thread) {
        float* const x = a.data() + n * static_cast<std::size_t>(thread);
        const float* const y = b.data() + n * static_cast<std::size_t>(thread);
        const float* const z = c.data() + n * static_cast<std::size_t>(thread);
        for (int round = 0; round < 4; ++round) {
            for (std::size_t i = 0; i < n; ++i) x[i] = y[i] + 3.F * z[i];
            opaque(x[0]);
        }
    };
    return {threads * least_together(1, products) / least_together(threads, products),
            threads * least_together(1, bytes) / least_together(threads, bytes)};
}

} // namespace rye::bench
