// SPDX-License-Identifier: Apache-2.0
/// rye/splat/plain/forward.hpp: blending, pixel by pixel: the reference that every tuned walk is
/// held to, and, on duals, the forward derivative. Decisions are taken on values.
#pragma once

#include <algorithm>
#include <vector>

#include <rye/math/exponential.hpp>
#include <rye/splat/blend.hpp>
#include <rye/splat/raster.hpp>

namespace rye {

/// One contribution to a pixel.
template <class T>
struct PixelContribution : detail::Contribution<T> {
    Index entry;
    T u, v;                  ///< folded offsets
};

namespace detail {

/// Blending of one pixel at a time.
template <class A, class T>
using PlainBlend = Blend<A, T, SinglePixel, Exp2Library>;

} // namespace detail

/// Visits the contributions to a pixel, near to far, and returns the transmittance
/// behind them all.
template <class A, class T, class Visit>
T walk_pixel(const Scene<T>& scene, const A& accuracy, const detail::TilePixel& at, Visit&& visit) {
    using R = real_t<T>;
    const Index tile = at.tile;
    const int x = at.x, y = at.y;
    const detail::PlainBlend<A, T> blend(accuracy);
    const T px = T(static_cast<R>(x) + R(0.5)) - scene.cx;
    const T py = T(static_cast<R>(y) + R(0.5)) - scene.cy;
    const Index begin = scene.begin(tile), end = scene.end(tile);
    [[maybe_unused]] std::vector<std::pair<R, Index>> by_peak;
    if constexpr (A::order == BlendOrder::by_peak) {
        for (Index k = begin; k < end; ++k)
            by_peak.push_back({scene.trace.peaks[scene.member_of(k)].at(
                                   static_cast<R>(value_of(px)), static_cast<R>(value_of(py))),
                               k});
        // Ties stay in the order of centres.
        std::stable_sort(by_peak.begin(), by_peak.end(),
                         [](const auto& a, const auto& b) { return a.first < b.first; });
    }
    T transmittance = T(1);
    for (Index n = begin; n < end; ++n) {
        Index k = n;
        if constexpr (A::order == BlendOrder::by_peak)
            k = by_peak[static_cast<std::size_t>(n - begin)].second;
        const VisibleGaussian<T>& m = scene.member(k);
        if (y < m.rows.begin || y >= m.rows.end) continue;
        const Splat<T>& s = m.splat;
        const Response<T> r = respond(s, T(px - s.x), T(py - s.y));
        if (!blend.reaches(r.exponent, s.cut)) continue;
        const auto c = blend.take(blend.coverage(r.exponent, s.cut, s.floor), transmittance);
        if (!c.taken) break;
        visit(PixelContribution<T>{c, k, r.u, r.v});
        if (!blend.open(transmittance)) break;
    }
    return transmittance;
}

namespace detail {

/// Draws one tile.
template <class A, class T>
void blend_tile(const Scene<T>& scene, const A& accuracy, Index tile, Raster<T, A::outputs>& out) {
    const Index channels = scene.channels();
    for (int y = scene.top(tile); y < scene.bottom(tile); ++y)
        for (int x = scene.left(tile); x < scene.right(tile); ++x) {
            const Index p = scene.pixel(x, y);
            T* sum = out.feature.pixels.data() + p * channels;
            for (Index c = 0; c < channels; ++c) sum[c] = T(0);
            [[maybe_unused]] T depth = T(0);
            [[maybe_unused]] real_t<T> most = 0;
            [[maybe_unused]] std::uint32_t contributor = no_contributor;
            const T end =
                walk_pixel(scene, accuracy, {tile, x, y}, [&](const PixelContribution<T>& h) {
                    const T* feature = scene.feature_of(h.entry);
                    for (Index c = 0; c < channels; ++c) sum[c] += h.weight * feature[c];
                    if constexpr (A::outputs.depth) depth += h.weight * scene.splat(h.entry).depth;
                    if constexpr (A::outputs.contributor)
                        if (value_of(h.weight) > most) {
                            most = static_cast<real_t<T>>(value_of(h.weight));
                            contributor = scene.member(h.entry).source;
                        }
                });
            for (Index c = 0; c < channels; ++c) sum[c] += end * scene.background[c];
            out.alpha.pixels(0, p) = T(1) - end;
            if constexpr (A::outputs.depth) out.depth.pixels(0, p) = depth;
            if constexpr (A::outputs.contributor) out.contributor.pixels(0, p) = contributor;
        }
    out.trace.used[static_cast<std::size_t>(tile)] = scene.end(tile) - scene.begin(tile);
}

} // namespace detail

} // namespace rye
