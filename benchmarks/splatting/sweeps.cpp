// SPDX-License-Identifier: Apache-2.0
// One thing at a time: stages, channels, Gaussians, resolution, accuracy, backend, threads.
#include "work.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

template <class B = OneThread, class A = HeadRules, class Clock = double (*)()>
void sweep(benchmark::State& state, Index count, int channels, int size,
           Clock clock = thread_seconds) {
    Work<B, A> work{head_scene(count, channels, size)};
    Times best;
    for (auto _ : state)
        for (int round = 0; round < (count > 200000 ? 3 : 9); ++round)
            time_round(work, clock, best);
    report(state, work.counted(), work.raster.trace.lists.entries(), best);
}

void stages(benchmark::State& state) {
    using V = OneThread::batch<float>;
    Work<OneThread, HeadRules> w{head_scene(state.range(0), 3)};
    const Index n = w.scene.gaussians.count();
    const HeadRules& rules = w.rasterizer.accuracy;
    Times best;
    double project = 1e30, lists = 1e30;
    for (auto _ : state)
        for (int round = 0; round < 9; ++round) {
            time_round(w, thread_seconds, best);
            project = std::min(project, least_time(1, [&] {
                project_range_lanes<V>(w.scene.gaussians, w.scene.camera, rules, 0, n, w.scratch);
            }));
            lists = std::min(lists, least_time(1, [&] {
                arrange<OneThread>(w.scene.gaussians, w.scene.camera, rules, w.scratch,
                                   w.raster.trace);
            }));
        }
    state.counters["project_ms"] = 1e3 * project;
    state.counters["lists_ms"] = 1e3 * lists;
    state.counters["blend_ms"] = 1e3 * (best.forward - project - lists);
    state.counters["backward_ms"] = 1e3 * (best.both - best.forward);
}
BENCHMARK(stages)->ArgName("n")->Arg(20000)->Arg(100000)->Iterations(1);

void channels(benchmark::State& state) {
    sweep(state, 100000, static_cast<int>(state.range(0)), 512);
}
BENCHMARK(channels)->ArgName("c")->Arg(1)->Arg(3)->Arg(4)->Arg(8)->Arg(16)->Arg(32)->Iterations(1);

void gaussians(benchmark::State& state) { sweep(state, state.range(0), 3, 512); }
BENCHMARK(gaussians)->ArgName("n")->RangeMultiplier(10)->Range(1000, 1000000)->Iterations(1);

void resolution(benchmark::State& state) {
    sweep(state, 20000, 3, static_cast<int>(state.range(0)));
}
BENCHMARK(resolution)->ArgName("px")->RangeMultiplier(2)->Range(128, 1024)->Iterations(1);

template <class A>
void accuracy(benchmark::State& state) {
    sweep<OneThread, A>(state, 20000, 3, 512);
}
BENCHMARK(accuracy<Fast>)->Iterations(1);
BENCHMARK(accuracy<Compatible3dgs>)->Iterations(1);
BENCHMARK(accuracy<Balanced>)->Iterations(1);
BENCHMARK(accuracy<Tight>)->Iterations(1);
BENCHMARK(accuracy<Exact32>)->Iterations(1);

template <class B>
void backend(benchmark::State& state) {
    sweep<B>(state, 20000, 3, 512);
}
BENCHMARK(backend<ScalarBackend<Serial>>)->Iterations(1);
BENCHMARK(backend<OneThread>)->Iterations(1);

/// On the wall, one thread and `t` in the same rounds.
void threads(benchmark::State& state) {
    const int n = static_cast<int>(state.range(1));
    Work<XsimdBackend<>, HeadRules> work{head_scene(state.range(0), 3)};
    Work<OneThread, HeadRules> alone{work.scene};
#ifdef _OPENMP
    omp_set_num_threads(n);
#endif
    Times one, many;
    for (auto _ : state)
        for (int round = 0; round < 15; ++round) {
            time_round(alone, wall_seconds, one);
            time_round(work, wall_seconds, many);
        }
    state.counters["fwd_speedup"] = one.forward / many.forward;
    state.counters["both_speedup"] = one.both / many.both;
}
BENCHMARK(threads)->ArgNames({"n", "t"})->Apply([](auto* b) {
    for (const int n : {20000, 100000})
        for (int t = 1; t <= DefaultThreads::count(); t *= 2) b->Args({n, t});
})->Iterations(1);

} // namespace
