// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/decisions.hpp: pixels at which a rule decides between numbers that are closer than
/// rounding in float may move them: a Gaussian at the cut, alpha at its clamp, transmittance at the
/// stop. There two renders by the same rules may differ by a whole contribution; elsewhere only by
/// rounding.
#pragma once

#include <cmath>

#include <rye/splat/plain/kernels.hpp>
#include <rye/splat/rasterizer.hpp>

namespace rye::test {

/// For each pixel 1, or 0 where a decision is within `band` [relative] of its threshold.
template <class A>
Columns<float> undecided_left_out(const A& accuracy, const Gaussians<double>& g,
                                  const Pinhole<double>& camera, const RasterTrace<double>& trace,
                                  double band = 2e-4) {
    const VecX<double> background = VecX<double>::Zero(g.channels());
    const GaussianView<double> view(g);
    const Scene<double> scene = Rasterizer<A>::scene_of(view, camera, background, trace);
    const detail::PlainBlend<A, double> blend(accuracy);
    Columns<float> clear = Columns<float>::Ones(1, Index(camera.width) * camera.height);
    const auto close = [&](double x, double threshold) {
        return std::abs(x - threshold) <= band * threshold;
    };
    for (Index tile = 0; tile < trace.lists.tiles(); ++tile)
        for (int y = scene.top(tile); y < scene.bottom(tile); ++y)
            for (int x = scene.left(tile); x < scene.right(tile); ++x) {
                float& here = clear(0, scene.pixel(x, y));
                double transmittance = 1;
                for (Index k = scene.begin(tile); k < scene.end(tile); ++k) {
                    const VisibleGaussian<double>& m = scene.member(k);
                    const Splat<double>& s = m.splat;
                    const auto r = respond(s, x + 0.5 - scene.cx - s.x, y + 0.5 - scene.cy - s.y);
                    if (std::abs(r.exponent - s.cut) <= 1.4427 * band) here = 0;
                    if (!blend.reaches(r.exponent, s.cut)) continue;
                    const auto given = blend.coverage(r.exponent, s.cut, s.floor);
                    if (close(std::exp2(r.exponent) - s.floor, accuracy.alpha_max)) here = 0;
                    const auto c = blend.take(given, transmittance);
                    if (A::stop_rule != Stop::never &&
                        close(c.before * (1 - c.alpha), accuracy.stop))
                        here = 0;
                    if (!c.taken || !blend.open(transmittance)) break;
                }
            }
    return clear;
}

} // namespace rye::test
