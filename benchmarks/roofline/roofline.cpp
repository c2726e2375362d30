// SPDX-License-Identifier: Apache-2.0
// Peak rates of one thread of this machine, the measure of all other benchmarks.
#include <benchmark/benchmark.h>

#include "machine.hpp"

namespace {

void roofline(benchmark::State& state) {
    for (auto _ : state) {
        const auto* measured = &rye::bench::machine();
        benchmark::DoNotOptimize(measured);
    }
    const auto& m = rye::bench::machine();
    state.counters["gflop_s"] = m.flops * 1e-9;
    state.counters["gbyte_s"] = m.bytes * 1e-9;
    state.counters["mkey_s"] = m.keys * 1e-6;
    state.counters["lanes"] = static_cast<double>(rye::XsimdBackend<>::batch<float>::size);
}
BENCHMARK(roofline)->Iterations(1)->Unit(benchmark::kMillisecond);

} // namespace

BENCHMARK_MAIN();
