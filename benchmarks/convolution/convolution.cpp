// SPDX-License-Identifier: Apache-2.0
// The 3 x 3 convolution of the upsampler, forward and both vjps, as a fraction of the peak.
#include <benchmark/benchmark.h>

#include <rye/backend/lanes.hpp>
#include <rye/nn/convolution.hpp>

#include "../roofline/machine.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

void convolution(benchmark::State& state) {
    using B = XsimdBackend<DefaultArch, Serial>;
    const int size = static_cast<int>(state.range(0)), channels = static_cast<int>(state.range(1));
    const Image<float> in(size, size, channels, 0.5F), g(size, size, channels, 0.1F);
    const Columns<float> weight = Columns<float>::Constant(channels, 9 * channels, 0.01F);
    Columns<float> g_weight = Columns<float>::Zero(channels, 9 * channels);
    const Padded<float> wide = padded(B{}, in), wide_g = padded(B{}, g);
    double forward = 1e30, input = 1e30, weights = 1e30;
    for (auto _ : state)
        for (int round = 0; round < 5; ++round) {
            forward =
                std::min(forward, least_time(1, [&] {
                             benchmark::DoNotOptimize(convolve3x3(B{}, weight, wide).pixels.data());
                         }));
            input = std::min(input, least_time(1, [&] {
                                 benchmark::DoNotOptimize(
                                     convolve3x3_vjp_input(B{}, weight, wide_g).pixels.data());
                             }));
            weights = std::min(weights, least_time(1, [&] {
                                   convolve3x3_vjp_weight(B{}, wide, wide_g, g_weight);
                               }));
        }
    const double flops = 2.0 * 9 * channels * channels * size * size;
    state.counters["mflop"] = 1e-6 * flops;
    state.counters["fwd_share"] = flops / forward / peak().flops();
    state.counters["input_share"] = flops / input / peak().flops();
    state.counters["weight_share"] = flops / weights / peak().flops();
}
BENCHMARK(convolution)->ArgNames({"px", "c"})->Args({256, 32})->Args({512, 16})->Iterations(1);

} // namespace

BENCHMARK_MAIN();
