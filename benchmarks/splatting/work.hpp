// SPDX-License-Identifier: Apache-2.0
/// benchmarks/splatting/work.hpp: a scene, a rasterizer and their memory, ready for timing; and
/// what is reported of a render.
#pragma once

#include <benchmark/benchmark.h>

#include <rye/core/thread_pool.hpp>
#include <rye/splat/jvp.hpp>

#include "../roofline/bound.hpp"
#include "../roofline/load.hpp"
#include "../scenes/head_scene.hpp"
#include "count.hpp"

namespace rye::bench {

using OneThread = XsimdBackend<DefaultArch, Serial>;

template <class B, AccuracyPolicy A>
struct Work {
    HeadScene scene;
    B backend = {};
    Rasterizer<A> rasterizer = {};
    Raster<float, A::outputs> raster = {};
    RasterScratch<float> scratch = {};
    Gaussians<float> gradient = {};

    void forward() {
        rasterizer.forward_into(backend, scene.gaussians, scene.camera, scene.background, raster,
                                &scratch);
    }
    void backward() {
        rasterizer.vjp_into(backend, scene.gaussians, scene.camera, scene.background, raster,
                            RasterCotangent<float>{scene.cotangent}, gradient, &scratch);
    }
    /// Returns counts of what the last render blended, in blocks of pixels.
    BlendCount count(Block block) const {
        const Scene<float> s{raster.trace,     scene.gaussians, scene.background,
                             scene.camera.cx,  scene.camera.cy,         scene.camera.width,
                             scene.camera.height};
        return count_blends(s, rasterizer.accuracy, block);
    }
    /// The last render's work, for vectors of this machine's lanes.
    SplatWork counted() const {
        const BlendCount n = count(Block::of(int(Floats::size)));
        return {double(scene.gaussians.count()),       double(scene.gaussians.channels()),
                double(raster.alpha.size()),           double(raster.trace.members.size()),
                double(raster.trace.lists.entries()),  n.pairs, n.blocks, n.touched};
    }
};

/// The minimum times of several rounds [s], and the load that they had.
struct Times {
    double forward = 1e30, both = 1e30;
    LoadSeen load;
};
template <class W, class Clock>
void time_round(W& work, const Clock& clock, Times& best) {
    const double start = clock();
    work.forward();
    const double middle = clock();
    work.backward();
    const double end = clock();
    best.forward = std::min(best.forward, middle - start);
    best.both = std::min(best.both, end - start);
    best.load.look();
}

/// Memory that a render of floats and its vjp keep between calls [byte]: by Gaussian, by visible
/// one, by pair of a tile and a Gaussian, and the images; and the gradients that the vjp returns.
/// The memory of a thread's tile, half a megabyte, is extra.
inline double kept_bytes(double gaussians, double visible, double entries, int channels,
                         double pixels) {
    const double record = sizeof(VisibleGaussian<float>), slot = 4 * (8 + (channels + 7) / 8 * 8);
    return gaussians * (record + sizeof(Footprint<float>) + 1 + 4 + 4 + 4 * (11 + channels)) +
           visible * (record + 8) + entries * (8 + 12 + 8 + slot + 1) +
           pixels * 4 * (channels + 2);
}

/// Reports counts, which are independent of the machine but for the blocks' size, times relative to
/// the machine's bound, and which machine that is, with its load at the time.
inline void report(benchmark::State& state, const SplatWork& w, const Times& t) {
    const Machine& m = machine();
    const StageBounds bounds = w.bounds(m);
    const double forward = bounds.forward(), both = bounds.both();
    const Load load = t.load.mean();
    state.counters["fwd_ms"] = 1e3 * t.forward;
    state.counters["both_ms"] = 1e3 * t.both;
    state.counters["fwd_bound_ms"] = 1e3 * forward;
    state.counters["both_bound_ms"] = 1e3 * both;
    state.counters["fwd_over_bound"] = t.forward / forward;
    state.counters["both_over_bound"] = t.both / both;
    state.counters["bound_project_ms"] = 1e3 * bounds.project;
    state.counters["bound_sort_ms"] = 1e3 * bounds.sort;
    state.counters["bound_lists_ms"] = 1e3 * bounds.lists;
    state.counters["bound_blend_ms"] = 1e3 * bounds.blend;
    state.counters["bound_reverse_ms"] = 1e3 * bounds.reverse;
    state.counters["bound_project_vjp_ms"] = 1e3 * bounds.project_vjp;
    state.counters["load"] = load.average;
    state.counters["running"] = load.running;
    state.counters["live"] = w.live(m.lanes);
    state.counters["entries"] = w.entries;
    state.counters["pairs"] = w.pairs;
    state.counters["fwd_mflop"] = 1e-6 * w.forward_flops();
    state.counters["both_mflop"] = 1e-6 * (w.forward_flops() + w.backward_flops());
    state.counters["fwd_mbyte"] = 1e-6 * w.forward_bytes();
    state.counters["both_mbyte"] = 1e-6 * (w.forward_bytes() + w.backward_bytes());
    state.counters["ns_per_pair"] = 1e9 * t.both / w.pairs;
    state.SetLabel(processor_name());
}

} // namespace rye::bench
