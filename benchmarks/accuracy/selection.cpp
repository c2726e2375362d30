// SPDX-License-Identifier: Apache-2.0
// select_accuracy on held-out scenes: whether the image keeps the bound, and the time of the choice
// relative to the cheapest rung that keeps it by the oracle.
#include <array>
#include <cmath>
#include <ctime>

#include <rye/splat/oracle.hpp>
#include <rye/splat/lanes.hpp>
#include <rye/splat/select_accuracy.hpp>

#include "scenes.hpp"
#include "table.hpp"

namespace rye::bench {
namespace {

using B = XsimdBackend<DefaultArch, Serial>;

/// CPU time of this thread.
double seconds() {
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

Scenery held_out(std::uint64_t seed) {
    const Random r{seed, 77};
    const auto n = static_cast<Index>(100 * std::exp(2.5 * r.uniform(0)));
    const double size = 0.01 * std::exp(3 * r.uniform(1));
    auto s = random_cloud("held out", n, 1000 + seed, size, {0.5 + r.uniform(2), 3 + r.uniform(3)});
    if (r.below(4, 4) == 0) s.gaussians.opacity.array() = 1 - 0.1F * s.gaussians.opacity.array();
    if (r.below(5, 4) == 0) s.gaussians.opacity *= 0.1F;
    if (r.below(6, 4) == 0)
        for (Index i = 0; i < n; i += 3) s.gaussians.scale(0, i) *= 10;
    s.camera.width = 64 + static_cast<int>(r.below(7, 64));
    s.camera.height = 64 + static_cast<int>(r.below(8, 64));
    return s;
}

} // namespace

int selection(int scenes) {
    int broken = 0, slow = 0, unmet = 0;
    double worst_ratio = 1, sum_log = 0;
    for (int k = 0; k < scenes; ++k) {
        const auto seed = static_cast<std::uint64_t>(k);
        const Scenery s = held_out(seed);
        const double bound = 5e-4 * std::exp(std::log(100.0) * Random{seed, 78}.uniform(3));
        const SelectedAccuracy chosen =
            select_accuracy(B{}, s.gaussians, s.camera, s.background, bound);
        Gaussians<double> g;
        convert_fields(g, s.gaussians, [](float x) { return static_cast<double>(x); });
        const auto truth = oracle(g, s.camera.cast<double>(), s.background.cast<double>(),
                                  depth_order(s.gaussians, s.camera));
        double error_of_chosen = 0, time_of_chosen = 0, least = INFINITY;
        std::string best = "none";
        Raster<float> raster;
        RasterScratch<float> scratch;
        std::array<double, accuracy_ladder.size()> times;
        times.fill(INFINITY);
        for (int i = 0; i < 9; ++i) // interleaved
            for (std::size_t r = 0; r < times.size(); ++r) {
                const Rasterizer<> rasterizer{accuracy_ladder[r].accuracy()};
                const double a = seconds();
                rasterizer.forward_into(B{}, s.gaussians, s.camera, s.background, raster, &scratch);
                times[r] = std::min(times[r], seconds() - a);
            }
        for (std::size_t r = 0; r < times.size(); ++r) {
            const AccuracyRung& rung = accuracy_ladder[r];
            const Rasterizer<> rasterizer{rung.accuracy()};
            rasterizer.forward_into(B{}, s.gaussians, s.camera, s.background, raster, &scratch);
            const Columns<double> d = raster.feature.pixels.cast<double>() - truth.feature.pixels;
            const double error = d.cwiseAbs().maxCoeff();
            if (error <= bound && times[r] < least) least = times[r], best = rung.name;
            if (chosen.name == rung.name) error_of_chosen = error, time_of_chosen = times[r];
        }
        const bool kept = error_of_chosen <= bound;
        const double ratio = std::isfinite(least) ? time_of_chosen / least : 1;
        if (!chosen.met) ++unmet;
        if (!kept) ++broken;
        if (kept && ratio > 1.3) ++slow;
        if (kept) worst_ratio = std::max(worst_ratio, ratio);
        sum_log += std::log(std::max(1e-3, ratio));
        if (!kept || ratio > 1.3)
            std::printf(
                "scene %d: bound %.2e, chose %s with error %.2e, best %s, time ratio %.2f\n", k,
                bound, chosen.name.c_str(), error_of_chosen, best.c_str(), ratio);
    }
    std::printf(
        "select_accuracy: bound kept on %d of %d held-out scenes (%d not promised); slower "
        "than 1.3x of the best in hindsight on %d, mean ratio %.2f, worst %.2f\n",
        scenes - broken, scenes, unmet, slow, std::exp(sum_log / scenes), worst_ratio);
    return broken;
}

} // namespace rye::bench
