// SPDX-License-Identifier: Apache-2.0
// Peak rates of one thread of this machine, the measure of all other benchmarks.
#include <benchmark/benchmark.h>

#include "load.hpp"
#include "machine.hpp"

namespace {

using namespace rye::bench;

void roofline(benchmark::State& state) {
    LoadSeen load;
    for (auto _ : state) {
        load.look();
        const auto* measured = &machine();
        benchmark::DoNotOptimize(measured);
        load.look();
    }
    const Machine& m = machine();
    state.counters["gflop_s"] = m.flops * 1e-9;
    state.counters["gcycle_s"] = m.cycles * 1e-9;
    state.counters["products_a_cycle"] = peak().a_cycle();
    state.counters["mkey_s"] = m.keys * 1e-6;
    state.counters["mentry_s"] = m.entries * 1e-6;
    state.counters["lanes"] = m.lanes;
    state.counters["load"] = load.mean().average;
    state.counters["running"] = load.mean().running;
    state.SetLabel(processor_name());
}
BENCHMARK(roofline)->Iterations(1)->Unit(benchmark::kMillisecond);

/// Vectors of each width, of float and of double: a row of their own.
template <class V>
void products(benchmark::State& state) {
    ProductRates rates(1);
    for (auto _ : state) rates = ProductRates::measured<V>(100);
    state.counters["lanes"] = rates.lanes();
    state.counters["gflop_s"] = rates.flops() * 1e-9;
    state.counters["gcycle_s"] = rates.cycles() * 1e-9;
    state.counters["products_a_cycle"] = rates.a_cycle();
    state.counters["latency"] = rates.latency();
    const std::string wrong = rates.unmeasured() + rates.impossible();
    state.SetLabel(processor_name() + (wrong.empty() ? "" : "; not so: " + wrong));
}

/// Memory at each working set: a row of its own.
void memory_speed(benchmark::State& state, std::size_t at) {
    for (auto _ : state) benchmark::DoNotOptimize(at);
    const MemorySpeed& s = machine().memory.speeds[at];
    state.counters["kbyte"] = s.set.bytes * 1e-3;
    state.counters["read_gbyte_s"] = s.read * 1e-9;
    state.counters["copy_gbyte_s"] = s.copy * 1e-9;
}

} // namespace

int main(int argc, char** argv) {
    benchmark::Initialize(&argc, argv);
    if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 1;
    each_vector_kind([]<class V>(VectorKind<V>) {
        const std::string number = sizeof(typename V::value_type) == 4 ? "float" : "double";
        benchmark::RegisterBenchmark(
            ("products/" + number + "/lanes:" + std::to_string(V::size)).c_str(), products<V>)
            ->Iterations(1);
    });
    const auto& speeds = machine().memory.speeds;
    for (std::size_t i = 0; i < speeds.size(); ++i) {
        const auto kbyte = static_cast<long long>(speeds[i].set.bytes / 1024);
        benchmark::RegisterBenchmark(
            ("memory_speed/" + speeds[i].set.level + "/KiB:" + std::to_string(kbyte)).c_str(),
            [i](benchmark::State& state) { memory_speed(state, i); })
            ->Iterations(1);
    }
    benchmark::RunSpecifiedBenchmarks();
}
