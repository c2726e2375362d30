// SPDX-License-Identifier: Apache-2.0
/// benchmarks/splatting/work.hpp: a scene, a rasterizer and their memory, ready for timing; and
/// counts of a render's work.
#pragma once

#include <benchmark/benchmark.h>

#include <rye/core/thread_pool.hpp>
#include <rye/splat/jvp.hpp>

#include "../roofline/machine.hpp"
#include "../scenes/head_scene.hpp"

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
    /// Pixel-Gaussian pairs that the last render blended, counted by plain loops.
    double pairs() const {
        const Scene<float> s{raster.trace,     scene.gaussians, scene.background,
                             scene.camera.cx,  scene.camera.cy,         scene.camera.width,
                             scene.camera.height};
        double n = 0;
        for (Index t = 0; t < raster.trace.lists.tiles(); ++t)
            for (int y = s.top(t); y < s.bottom(t); ++y)
                for (int x = s.left(t); x < s.right(t); ++x)
                    walk_pixel(s, rasterizer.accuracy, {t, x, y},
                               [&](const PixelContribution<float>&) { ++n; });
        return n;
    }
    SplatWork counted() const {
        return {double(scene.gaussians.count()), double(scene.gaussians.channels()),
                double(raster.alpha.size()), pairs()};
    }
};

/// The minimum times of several rounds [s].
struct Times {
    double forward = 1e30, both = 1e30;
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

/// Reports counts, which are independent of the machine, and times relative to its peak.
inline void report(benchmark::State& state, const SplatWork& w, Index entries, const Times& t) {
    const Machine& m = machine();
    state.counters["fwd_ms"] = 1e3 * t.forward;
    state.counters["both_ms"] = 1e3 * t.both;
    state.counters["entries"] = static_cast<double>(entries);
    state.counters["pairs"] = w.pairs;
    state.counters["fwd_mflop"] = 1e-6 * w.forward_flops();
    state.counters["both_mflop"] = 1e-6 * (w.forward_flops() + w.backward_flops());
    state.counters["fwd_mbyte"] = 1e-6 * w.forward_bytes();
    state.counters["both_mbyte"] = 1e-6 * (w.forward_bytes() + w.backward_bytes());
    state.counters["fwd_over_floor"] = t.forward / w.forward_floor(m);
    state.counters["both_over_floor"] = t.both / w.floor(m);
    state.counters["ns_per_pair"] = 1e9 * t.both / w.pairs;
}

} // namespace rye::bench
