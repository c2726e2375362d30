// SPDX-License-Identifier: Apache-2.0
// Sweeps of one parameter: stages, channels, Gaussians, resolution, accuracy, backend, threads.
#include <malloc.h>

#include <array>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "work.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

template <class B = OneThread, class A = HeadRules>
void sweep(benchmark::State& state, HeadScene&& scene) {
    Work<B, A> work{std::move(scene)};
    const int rounds = work.scene.gaussians.count() > 200000 ? 3 : 9;
    Times best;
    for (auto _ : state)
        for (int round = 0; round < rounds; ++round) time_round(work, thread_seconds, best);
    report(state, work.counted(), best);
}

void stages(benchmark::State& state) {
    using V = OneThread::batch<float>;
    Work<OneThread, HeadRules> w{head_scene(state.range(0), 3)};
    const Index n = w.scene.gaussians.count();
    const SplatInput in{view_of(w.scene.gaussians), w.scene.camera, w.rasterizer.accuracy};
    Times best;
    double project = 1e30, lists = 1e30;
    for (auto _ : state)
        for (int round = 0; round < 9; ++round) {
            time_round(w, thread_seconds, best);
            project = std::min(project, least_time(1, [&] {
                                   project_range_lanes<V>(in, {0, n}, w.scratch);
                               }));
            lists = std::min(lists, least_time(1, [&] {
                                 bin_and_sort(OneThread{}, in, w.scratch, w.raster.trace);
                             }));
        }
    state.counters["project_ms"] = 1e3 * project;
    state.counters["lists_ms"] = 1e3 * lists;
    state.counters["blend_ms"] = 1e3 * (best.forward - project - lists);
    state.counters["backward_ms"] = 1e3 * (best.both - best.forward);
}
BENCHMARK(stages)->ArgName("n")->Arg(20000)->Arg(100000)->Iterations(1);

void channels(benchmark::State& state) {
    sweep(state, head_scene(100000, static_cast<int>(state.range(0))));
}
BENCHMARK(channels)->ArgName("c")->Arg(1)->Arg(3)->Arg(4)->Arg(8)->Arg(16)->Arg(32)->Iterations(1);

/// More Gaussians in one image: more of them are hidden and cost time without a blended pair.
void gaussians(benchmark::State& state) { sweep(state, head_scene(state.range(0), 3)); }
BENCHMARK(gaussians)->ArgName("n")->RangeMultiplier(10)->Range(1000, 1000000)->Iterations(1);

/// More Gaussians in a proportionally larger image, smaller in the world: each contributes as
/// before, which leaves the growth of the work itself.
void gaussians_and_pixels(benchmark::State& state) {
    const double more = static_cast<double>(state.range(0)) / 20000;
    HeadScene scene = head_scene(state.range(0), 3, static_cast<int>(512 * std::sqrt(more)));
    scene.gaussians.scale /= static_cast<float>(std::sqrt(more));
    sweep(state, std::move(scene));
}
BENCHMARK(gaussians_and_pixels)
    ->ArgName("n")->RangeMultiplier(10)->Range(10000, 1000000)->Iterations(1);

/// Memory that a render and its gradient keep, by the sizes of arrays and by the allocator.
void memory(benchmark::State& state) {
    const Index n = state.range(0);
    const int channels = static_cast<int>(state.range(1));
    const auto allocated = [] {
        const auto m = mallinfo2();
        return static_cast<double>(m.uordblks + m.hblkhd);
    };
    for (auto _ : state) {
        Work<OneThread, HeadRules> work{head_scene(n, channels)};
        const double before = allocated();
        work.forward();
        work.backward();
        const double measured = allocated() - before;
        const double entries = static_cast<double>(work.raster.trace.lists.entries());
        const double visible = static_cast<double>(work.raster.trace.members.size());
        state.counters["entries"] = entries;
        state.counters["stated_mbyte"] =
            1e-6 * kept_bytes(static_cast<double>(n), visible, entries, channels,
                              static_cast<double>(work.raster.alpha.size()));
        state.counters["measured_mbyte"] = 1e-6 * measured;
        state.counters["byte_per_gaussian"] = measured / static_cast<double>(n);
    }
}
BENCHMARK(memory)
    ->ArgNames({"n", "c"})->ArgsProduct({{20000, 100000, 1000000}, {3}})->Args({100000, 32})
    ->Iterations(1);

void resolution(benchmark::State& state) {
    sweep(state, head_scene(20000, 3, static_cast<int>(state.range(0))));
}
BENCHMARK(resolution)->ArgName("px")->RangeMultiplier(2)->Range(128, 1024)->Iterations(1);

template <class A>
void accuracy(benchmark::State& state) {
    sweep<OneThread, A>(state, head_scene(20000, 3));
}
BENCHMARK(accuracy<Fast>)->Iterations(1);
BENCHMARK(accuracy<Compatible3dgs>)->Iterations(1);
BENCHMARK(accuracy<Balanced>)->Iterations(1);
BENCHMARK(accuracy<Tight>)->Iterations(1);
BENCHMARK(accuracy<Exact32>)->Iterations(1);

template <class B>
void backend(benchmark::State& state) {
    sweep<B>(state, head_scene(20000, 3));
}
BENCHMARK(backend<ScalarBackend<Serial>>)->Iterations(1);
BENCHMARK(backend<OneThread>)->Iterations(1);

/// Forward mode: a render with its derivative along all Gaussians and the camera, over a render.
void jvp(benchmark::State& state) {
    Work<OneThread, HeadRules> work{
        head_scene(state.range(0), static_cast<int>(state.range(1)))};
    const HeadScene& s = work.scene;
    const Gaussians<float> direction = s.gaussians;
    const Pinhole<float> turn = s.camera;
    const RasterTangents<float> along{&direction, &turn};
    RasterJvp<float, HeadRules::outputs> out;
    double forward = 1e30, both = 1e30;
    for (auto _ : state)
        for (int round = 0; round < 9; ++round) {
            forward = std::min(forward, least_time(1, [&] { work.forward(); }));
            both = std::min(both, least_time(1, [&] {
                                work.rasterizer.jvp_into(work.backend, s.gaussians, along, s.camera,
                                                         s.background, out, &work.scratch);
                            }));
        }
    state.counters["forward_ms"] = 1e3 * forward;
    state.counters["jvp_by_forward"] = both / forward;
}
BENCHMARK(jvp)->ArgNames({"n", "c"})->ArgsProduct({{20000, 100000}, {3, 32}})->Iterations(1);

/// A call of run: its begin and its end [s].
struct Region {
    double begin, end;
};

/// A pool's threads that note when they were called.
struct Noted {
    ThreadPool::Handle threads;
    std::vector<Region>* calls;

    template <std::invocable<Index> F>
    void run(Index n, F&& f) const {
        const double begin = wall_seconds();
        threads.run(n, f);
        calls->push_back({begin, wall_seconds()});
    }
    int size() const { return threads.size(); }
};
static_assert(Threads<Noted>);

/// The least times of a render's stages, by its calls of the threads: projection, two of gathering,
/// two of binning, sorting, blending; the reverse walk, merging. `between`: in none of them.
struct StageTimes {
    static constexpr std::array<const char*, 8> names{"project", "gather",  "bin",   "sort",
                                                      "blend",   "reverse", "merge", "between"};
    static constexpr std::array<std::size_t, 9> stage_of{0, 1, 1, 2, 2, 3, 4, 5, 6};
    std::array<double, 8> least;
    double forward = 1e30, both = 1e30;

    StageTimes() { least.fill(1e30); }
    template <class W>
    void round(W& work, std::vector<Region>& calls) {
        calls.clear();
        const double begin = wall_seconds();
        work.forward();
        const double middle = wall_seconds();
        work.backward();
        const double end = wall_seconds();
        forward = std::min(forward, middle - begin);
        both = std::min(both, end - begin);
        if (calls.size() != stage_of.size()) return;
        std::array<double, 8> now{};
        double inside = 0;
        for (std::size_t i = 0; i < calls.size(); ++i) {
            now[stage_of[i]] += calls[i].end - calls[i].begin;
            inside += calls[i].end - calls[i].begin;
        }
        now[7] = end - begin - inside;
        for (std::size_t i = 0; i < now.size(); ++i) least[i] = std::min(least[i], now[i]);
    }
};

/// The speed-up by `t` threads, and of each stage, in the same rounds: wall time.
void threads(benchmark::State& state) {
    const HeadScene scene = head_scene(state.range(0), 3);
    ThreadPool one_pool(1), pool(static_cast<int>(state.range(1)));
    std::vector<Region> calls;
    using B = XsimdBackend<DefaultArch, Noted>;
    Work<B, HeadRules> alone{scene, B{Noted{one_pool.threads(), &calls}}};
    Work<B, HeadRules> work{scene, B{Noted{pool.threads(), &calls}}};
    StageTimes one, many;
    for (auto _ : state)
        for (int round = 0; round < 15; ++round) {
            one.round(alone, calls);
            many.round(work, calls);
        }
    state.counters["fwd_speedup"] = one.forward / many.forward;
    state.counters["both_speedup"] = one.both / many.both;
    state.counters["both_ms"] = 1e3 * many.both;
    for (std::size_t i = 0; i < one.least.size(); ++i) {
        const std::string name = StageTimes::names[i];
        state.counters[name + "_ms"] = 1e3 * many.least[i];
        state.counters[name + "_speedup"] = one.least[i] / many.least[i];
    }
}
BENCHMARK(threads)->ArgNames({"n", "t"})->Apply([](auto* b) {
    for (const int n : {20000, 100000})
        for (int t = 1; t <= ThreadPool().size(); t *= 2) b->Args({n, t});
})->Iterations(1);

} // namespace
