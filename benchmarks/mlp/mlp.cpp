// SPDX-License-Identifier: Apache-2.0
// The face's colour network, 128 inputs per point and 64 per frame, over 100000 points, by each
// policy of products: its fraction of the peak measured in the same run, and its error.
#include <benchmark/benchmark.h>

#ifdef _OPENMP
#include <omp.h>
#endif

#include <rye/backend/lanes.hpp>
#include <rye/backend/scalar.hpp>
#include <rye/nn/mlp.hpp>

#include "../roofline/machine.hpp"
#include "libraries.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

template <class T>
Columns<T> noise(Index rows, Index cols) {
    Columns<T> a(rows, cols);
    const Random random{2, 1};
    for (Index i = 0; i < a.size(); ++i)
        a(i) = T(random.uniform(std::uint64_t(i)) - 0.5);
    return a;
}

template <class T>
struct Case {
    MlpShape shape{{192, 256, 256, 32}, 64};
    Mlp<T> m = Mlp<T>::init(shape, Random{1, 1}), g_params{shape};
    Columns<T> points, g_out, out, g_points;
    VecX<T> frame = VecX<T>::Constant(64, T(0.1)), g_frame;
    MlpTrace<T> trace;

    explicit Case(Index n) : points(noise<T>(128, n)), g_out(noise<T>(32, n)) {}
    template <Backend B>
    void forward() {
        out = mlp_forward(B{}, m, points, frame, &trace);
    }
    template <Backend B>
    void vjp() {
        mlp_vjp(B{}, m, {points, frame, trace}, g_out, {g_params, &g_points, &g_frame});
    }
    /// Per point, forward: without the frame's part; one layer takes the points again.
    double flops() const {
        double weights = 0;
        for (int l = 0; l < shape.layers(); ++l)
            weights += double(shape.layer_out(l)) *
                       (shape.hidden_in(l) + (shape.reads_input(l) ? shape.point_inputs() : 0));
        return 2 * weights;
    }
};

/// Norm of the difference, relative to the norm of double's result.
template <class T>
double difference(const Columns<T>& a, const Columns<double>& b) {
    return (a.template cast<double>() - b).norm() / b.norm();
}

template <class Products>
struct Multiplied : XsimdBackend<DefaultArch, Serial> {
    using products = Products;
};

template <class Products>
void mlp(benchmark::State& state) {
    using B = Multiplied<Products>;
    const Index n = state.range(0);
#ifdef _OPENMP
    omp_set_num_threads(1);  // for oneDNN
#endif
    Case<float> c(n);
    double forward = 1e30, both = 1e30;
    for (auto _ : state)
        for (int round = 0; round < 12; ++round) {
            const double start = thread_seconds();
            c.template forward<B>();
            forward = std::min(forward, thread_seconds() - start);
            c.template vjp<B>();
            both = std::min(both, thread_seconds() - start);
        }
    Case<float> few(1000);
    Case<double> exact(1000);
    few.template forward<B>();
    few.template vjp<B>();
    exact.forward<ScalarBackend<Serial>>();
    exact.vjp<ScalarBackend<Serial>>();
    const double flops = c.flops() * double(n);
    state.counters["fwd_ms"] = 1e3 * forward;
    state.counters["both_ms"] = 1e3 * both;
    state.counters["fwd_gflop"] = 1e-9 * flops;
    state.counters["both_gflop"] = 3e-9 * flops;
    state.counters["fwd_share"] = flops / forward / peak().flops();
    state.counters["both_share"] = 3 * flops / both / peak().flops();
    state.counters["error"] = difference(few.out, exact.out);
    state.counters["g_error"] = std::max(difference(few.g_points, exact.g_points),
                                         difference(few.g_params.weight[0],
                                                    exact.g_params.weight[0]));
}

#define MLP(...) BENCHMARK(mlp<__VA_ARGS__>)->ArgName("points")->Arg(100000)->Iterations(1)
MLP(TileProducts);
MLP(EigenProducts);
#ifdef RYE_BENCH_CBLAS
MLP(GemmProducts<Cblas>);
#endif
#ifdef RYE_BENCH_ONEDNN
MLP(GemmProducts<OneDnn>);
#endif

} // namespace

BENCHMARK_MAIN();
