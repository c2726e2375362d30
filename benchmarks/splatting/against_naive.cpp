// SPDX-License-Identifier: Apache-2.0
// The tuned kernels against the yardstick of benchmarks/naive, one thread each, alternating in one
// run, the minimum time of each; and the error at that speed.
#include <rye/splat/oracle.hpp>

#include "../naive/adapter.hpp"
#include "work.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

void against_naive(benchmark::State& state) {
    const Index count = state.range(0);
    const int channels = static_cast<int>(state.range(1));
    Work<OneThread, HeadRules> work{head_scene(count, channels)};
    const naive::Cloud cloud = naive_cloud(work.scene.gaussians);
    const naive::Camera camera = naive_camera(work.scene.camera);
    const std::vector<float> g_image(work.scene.cotangent.data(),
                                     work.scene.cotangent.data() + work.scene.cotangent.size());
    naive::Rasterizer rasterizer;
    naive::Cloud gradient;
    std::vector<float> image;
    Times ours, theirs;
    for (auto _ : state)
        for (int round = 0; round < 5; ++round) {
            const double start = thread_seconds();
            rasterizer.forward(cloud, camera, channels, image);
            const double middle = thread_seconds();
            rasterizer.backward(cloud, camera, channels, g_image, gradient);
            theirs.both = std::min(theirs.both, thread_seconds() - start);
            theirs.forward = std::min(theirs.forward, middle - start);
            for (int i = 0; i < 5; ++i) time_round(work, thread_seconds, ours);
        }
    report(state, work.counted(), ours);
    state.counters["naive_fwd_ms"] = 1e3 * theirs.forward;
    state.counters["naive_both_ms"] = 1e3 * theirs.both;
    state.counters["fwd_ratio"] = theirs.forward / ours.forward;
    state.counters["both_ratio"] = theirs.both / ours.both;
}
BENCHMARK(against_naive)
    ->ArgNames({"n", "c"})
    ->ArgsProduct({{20000, 100000}, {3, 32}})
    ->Iterations(1)
    ->Unit(benchmark::kMillisecond);

/// Relative errors of image and gradients against the reference in double under the same rules, and
/// the largest difference of the image from the oracle (every Gaussian at every pixel).
void error(benchmark::State& state) {
    Work<OneThread, HeadRules> work{head_scene(2000, static_cast<int>(state.range(0)), 128)};
    for (auto _ : state) {
        work.forward();
        work.backward();
    }
    const auto widen = [](float x) { return double(x); };
    Gaussians<double> g;
    convert_fields(g, work.scene.gaussians, widen);
    const Pinhole<double> camera = work.scene.camera.cast<double>();
    const VecX<double> black = VecX<double>::Zero(g.channels());
    const Rasterizer<HeadRules> reference;
    const auto r = reference.forward(ScalarBackend<>{}, g, camera, black);
    const Gaussians<double> d = reference.vjp(ScalarBackend<>{}, g, camera, black, r,
                                              Columns<double>(work.scene.cotangent.cast<double>()));
    const auto relative = [](const Columns<float>& a, const Columns<double>& b) {
        return (a.cast<double>() - b).norm() / b.norm();
    };
    const OracleImages truth =
        oracle(g, camera, black, depth_order(work.scene.gaussians, work.scene.camera));
    state.counters["image_max_to_oracle"] =
        (work.raster.feature.pixels.cast<double>() - truth.feature.pixels).cwiseAbs().maxCoeff();
    state.counters["image"] = relative(work.raster.feature.pixels, r.feature.pixels);
    state.counters["d_mean"] = relative(work.gradient.mean, d.mean);
    state.counters["d_scale"] = relative(work.gradient.scale, d.scale);
    state.counters["d_rotation"] = relative(work.gradient.rotation, d.rotation);
    state.counters["d_opacity"] = relative(work.gradient.opacity, d.opacity);
    state.counters["d_feature"] = relative(work.gradient.feature, d.feature);
}
BENCHMARK(error)->ArgName("c")->Arg(3)->Arg(32)->Iterations(1)->Unit(benchmark::kMillisecond);

} // namespace

BENCHMARK_MAIN();
