// SPDX-License-Identifier: Apache-2.0
// The network of the face's colours, 128 numbers a point and 64 a frame, over 100000 points: its
// products as a share of the peak that the same run measures.
#include <benchmark/benchmark.h>

#include <rye/backend/xsimd.hpp>
#include <rye/nn/mlp.hpp>

#include "../roofline/machine.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

void mlp(benchmark::State& state) {
    using B = XsimdBackend<xsimd::default_arch, Serial>;
    const MlpShape shape{{192, 256, 256, 32}, 64};
    const Index n = state.range(0);
    const Mlp<float> m = Mlp<float>::init(shape, Random{1, 1});
    Mlp<float> g_params(shape);
    const auto noise = [](Index rows, Index cols) {
        Columns<float> a(rows, cols);
        const Random random{2, 1};
        for (Index i = 0; i < a.size(); ++i)
            a(i) = static_cast<float>(random.uniform(std::uint64_t(i))) - 0.5F;
        return a;
    };
    const Columns<float> points = noise(128, n), g_out = noise(32, n);
    const VecX<float> frame = VecX<float>::Constant(64, 0.1F);
    MlpTrace<float> trace;
    Columns<float> out, g_points;
    VecX<float> g_frame;
    double forward = 1e30, both = 1e30;
    for (auto _ : state)
        for (int round = 0; round < 12; ++round) {
            const double start = thread_seconds();
            out = mlp_forward<B>(m, points, frame, &trace);
            forward = std::min(forward, thread_seconds() - start);
            mlp_vjp<B>(m, points, frame, trace, g_out, g_params, &g_points, &g_frame);
            both = std::min(both, thread_seconds() - start);
        }
    // Per point: the frame's part is folded away; one layer reads the points again.
    double weights = 0;
    for (int l = 0; l < shape.layers(); ++l)
        weights += double(shape.layer_out(l)) *
                   (shape.hidden_in(l) + (shape.reads_input(l) ? shape.point_inputs() : 0));
    const double flops = 2 * weights * double(n);
    state.counters["fwd_ms"] = 1e3 * forward;
    state.counters["both_ms"] = 1e3 * both;
    state.counters["fwd_gflop"] = 1e-9 * flops;
    state.counters["both_gflop"] = 3e-9 * flops;
    state.counters["fwd_share"] = flops / forward / machine().flops;
    state.counters["both_share"] = 3 * flops / both / machine().flops;
}
BENCHMARK(mlp)->ArgName("points")->Arg(100000)->Iterations(1);

} // namespace

BENCHMARK_MAIN();
