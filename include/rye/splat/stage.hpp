// SPDX-License-Identifier: Apache-2.0
/// rye/splat/stage.hpp: the per-Gaussian work before and after the pixel walks: project, cull and
/// count, sort by depth, deal out into tiles; and merge the tiles' gradients and pull them back.
#pragma once

#include <string>

#include <rye/backend/backend.hpp>
#include <rye/splat/raster.hpp>

namespace rye {

enum class Candidacy : std::uint8_t { hidden, visible, non_finite };

/// Whether every number that is read of a Gaussian is finite and its quaternion has a direction.
template <class T>
bool usable(const Gaussians<T>& g, Index i) {
    using std::isfinite;
    const auto finite = [](const T* x, Index n) {
        real_t<T> zero = 0;                                  // 0 * x sums to NaN if any x is not finite
        for (Index k = 0; k < n; ++k) zero += real_t<T>(0) * static_cast<real_t<T>>(value_of(x[k]));
        return zero == real_t<T>(0);
    };
    const T* q = g.rotation.data() + 4 * i;
    const bool turned = q[0] != T(0) || q[1] != T(0) || q[2] != T(0) || q[3] != T(0);
    return turned && finite(g.mean.data() + 3 * i, 3) && finite(q, 4) &&
           finite(g.scale.data() + 3 * i, 3) && finite(g.opacity.data() + i, 1) &&
           finite(g.feature.data() + i * g.channels(), g.channels());
}

/// The value of a screen Gaussian's extent, in the image's pixels.
template <class A, class T>
Footprint<real_t<T>> footprint_of(const ScreenGaussian<T>& s, const Splat<T>& splat,
                                  const Pinhole<T>& camera) {
    using R = real_t<T>;
    Footprint<R> f;
    f.x = value_of(s.centre[0]) + value_of(camera.cx);
    f.y = value_of(s.centre[1]) + value_of(camera.cy);
    f.covariance = {value_of(s.covariance.xx), value_of(s.covariance.xy), value_of(s.covariance.yy)};
    f.determinant = value_of(s.determinant);
    if constexpr (A::support == Support::square) {
        const R mid = R(0.5) * (f.covariance.xx + f.covariance.yy);
        const R spread = std::sqrt(std::max(R(0.1), mid * mid - f.determinant));
        f.radius = std::ceil(R(3) * std::sqrt(mid + spread));             // [px]
    } else {
        // exponent >= cut  <=>  |w|^2 <= 2 ln(2) (log2 o - cut); the factor covers rounding.
        const R reach = value_of(splat.log2_opacity) - value_of(splat.cut);
        f.radius = R(unfold) * std::sqrt(std::max(R(0), reach)) *
                   (R(1) + R(16) * std::numeric_limits<R>::epsilon());
    }
    return f;
}

/// Fills candidate and state of Gaussians [b, e); one at a time, for any scalar.
template <class A, class T>
void project_range(const Gaussians<T>& g, const Pinhole<T>& camera, const A& accuracy, Index b,
                   Index e, RasterScratch<T>& scratch) {
    const Lens<T> lens(camera, accuracy.frustum_margin, accuracy.dilation);
    for (Index i = b; i < e; ++i) {
        const auto at = static_cast<std::size_t>(i);
        scratch.state[at] = static_cast<std::uint8_t>(Candidacy::non_finite);
        if (!usable(g, i)) continue;
        const ScreenGaussian<T> s = project(
            Shape<T>{g.mean.col(i), g.rotation.col(i), g.scale.col(i)}, lens);
        scratch.state[at] = static_cast<std::uint8_t>(Candidacy::hidden);
        if (!s.drawable || !(g.opacity(0, i) > T(0))) continue;
        auto& c = scratch.candidates[at];
        c.splat = make_splat(s, g.opacity(0, i), accuracy);
        if (!(c.splat.log2_opacity > c.splat.cut)) continue;
        c.footprint = footprint_of<A>(s, c.splat, camera);
        scratch.state[at] = static_cast<std::uint8_t>(Candidacy::visible);
    }
}

/// Projected candidates become ranks, near to far, ties by index, and entries of tiles.
template <Backend B, class A, class T>
void arrange(const Pinhole<T>& camera, const A& accuracy, RasterScratch<T>& scratch,
             RasterTrace<T>& trace) {
    using R = real_t<T>;
    using Covers = Cover<A::support, R>;
    const std::size_t n = scratch.candidates.size();
    scratch.keys.clear();
    trace.source.clear();
    trace.non_finite = 0;
    for (std::size_t i = 0; i < n; ++i) {
        const auto state = static_cast<Candidacy>(scratch.state[i]);
        if (state == Candidacy::non_finite) ++trace.non_finite;
        if (state != Candidacy::visible) continue;
        auto& c = scratch.candidates[i];
        const Span rows = Covers{c.footprint, camera.width, camera.height}.rows();
        if (rows.begin >= rows.end) continue;
        c.splat.row_begin = rows.begin;
        c.splat.row_end = rows.end;
        scratch.keys.push_back(depth_key(static_cast<R>(value_of(c.splat.depth))));
        trace.source.push_back(static_cast<std::uint32_t>(i));
    }
    if (accuracy.non_finite == NonFinite::fail && trace.non_finite > 0)
        throw Error("rasterizer: got " + std::to_string(trace.non_finite) +
                    " Gaussians with a number that is not finite, expected none");
    sort_by_key(scratch.keys, trace.source, scratch.sort);

    const std::size_t visible = trace.source.size();
    trace.splats.resize(visible);
    scratch.pixel_rows.resize(visible);
    for (std::size_t r = 0; r < visible; ++r) {
        trace.splats[r] = scratch.candidates[trace.source[r]].splat;
        scratch.pixel_rows[r] = {trace.splats[r].row_begin, trace.splats[r].row_end};
    }
    trace.lists.template build<typename B::threads, A::support, R>(
        camera.width, camera.height, scratch.pixel_rows, accuracy.max_entries,
        [&](Index r) -> const Footprint<R>& {
            return scratch.candidates[trace.source[static_cast<std::size_t>(r)]].footprint;
        });
}

/// The sum of a rank's slots over its tiles, in the order of tiles; its features go to g_feature.
template <class T>
SplatCotangent<T> merge_slots(const TileLists& lists, const RasterScratch<T>& scratch, Index rank,
                              T* g_feature, Index channels) {
    SplatCotangent<T> sum{T(0), T(0), T(0), T(0), T(0), T(0), T(0)};
    for (Index c = 0; c < channels; ++c) g_feature[c] = T(0);
    const auto r = static_cast<std::size_t>(rank);
    for (Index i = lists.first[r]; i < lists.first[r + 1]; ++i) {
        const Index entry = lists.place[static_cast<std::size_t>(i)];
        const auto k = static_cast<std::size_t>(entry);
        if (scratch.touched[k] == 0) continue;
        const SplatCotangent<T>& s = scratch.slots[k];
        sum.u += s.u;
        sum.v += s.v;
        sum.uu += s.uu;
        sum.uv += s.uv;
        sum.vv += s.vv;
        sum.alpha += s.alpha;
        sum.depth += s.depth;
        const T* f = scratch.feature_slots.data() + entry * channels;
        for (Index c = 0; c < channels; ++c) g_feature[c] += f[c];
    }
    return sum;
}

/// Gradients of ranks [b, e), from slots to world; the columns of the other Gaussians stay.
template <class A, class T>
void pull_back_range(const Gaussians<T>& g, const Pinhole<T>& camera, const A& accuracy,
                     const RasterTrace<T>& trace, const RasterScratch<T>& scratch, Index b, Index e,
                     Gaussians<T>& out) {
    const Lens<T> lens(camera, accuracy.frustum_margin, accuracy.dilation);
    for (Index r = b; r < e; ++r) {
        const auto at = static_cast<std::size_t>(r);
        const Index i = trace.source[at];
        const SplatCotangent<T> sum =
            merge_slots(trace.lists, scratch, r, out.feature.data() + i * g.channels(),
                        g.channels());
        const Shape<T> shape{g.mean.col(i), g.rotation.col(i), g.scale.col(i)};
        const Shape<T> d = project_vjp(shape, lens, screen_cotangent(trace.splats[at], sum));
        out.mean.col(i) = d.mean;
        out.rotation.col(i) = d.rotation;
        out.scale.col(i) = d.scale;
        out.opacity(0, i) = sum.alpha / g.opacity(0, i);
    }
}

} // namespace rye
