// SPDX-License-Identifier: Apache-2.0
/// rye/splat/plain/stage.hpp: the per-Gaussian formulas, one Gaussian at a time and for any scalar:
/// project and cull before the pixel walks; after them, pull the gradients back to the world.
#pragma once

#include <type_traits>
#include <vector>

#include <rye/splat/stage.hpp>

namespace rye {

/// Returns true if every number that is read of a Gaussian is finite.
template <class T>
bool usable(const GaussianView<T>& g, Index i) {
    int bad = 0;
    const auto look = [&](const T* x, Index n) {
        for (Index k = 0; k < n; ++k) {
            const real_t<T> v = value_of(x[k]);
            bad |= !(v - v == real_t<T>(0));                 // inf - inf is NaN
        }
    };
    look(g.mean(i), 3);
    look(g.rotation(i), 4);
    look(g.scale(i), 3);
    look(g.opacity(i), 1);
    look(g.feature_of(i), g.channels());
    return bad == 0;
}

namespace detail {

/// Returns the shape of Gaussian i. Reads columns of fixed length, so that the compiler sees no
/// loop over a length it does not know.
template <class T>
Shape<T> load_shape(const GaussianView<T>& g, Index i) {
    return {Eigen::Map<const Vec3<T>>(g.mean(i)), Eigen::Map<const Quat<T>>(g.rotation(i)),
            Eigen::Map<const Vec3<T>>(g.scale(i))};
}

/// Stores a shape in column i.
template <class T>
void store_shape(const Shape<T>& s, Gaussians<T>& g, Index i) {
    Eigen::Map<Vec3<T>>(g.mean.data() + 3 * i) = s.mean;
    Eigen::Map<Quat<T>>(g.rotation.data() + 4 * i) = s.rotation;
    Eigen::Map<Vec3<T>>(g.scale.data() + 3 * i) = s.scale;
}

/// Fills candidate and state of a range of Gaussians; one at a time, for any scalar.
template <class A, class T, Distortion D>
void project_range(const SplatInput<A, T, D>& in, ChunkRange r, RasterScratch<T>& scratch) {
    const GaussianView<T>& g = in.gaussians;
    const Pinhole<T, D>& camera = in.camera;
    const A& accuracy = in.accuracy;
    const Projector<T, D> lens(camera, accuracy.frustum_margin, screen_dilation(accuracy));
    const bool look = accuracy.non_finite != NonFinite::trust;
    for (Index i = r.begin; i < r.end; ++i) {
        const auto at = static_cast<std::size_t>(i);
        scratch.state[at] = Visibility::non_finite;
        if (look && !usable(g, i)) continue;
        const Projected<T, A::antialias> s = project<A::antialias>(load_shape(g, i), lens);
        scratch.state[at] = Visibility::hidden;
        const T opacity = *g.opacity(i);
        if (!s.drawable || !(opacity > T(0))) continue;
        VisibleGaussian<T>& c = scratch.candidates[at];
        c.splat = make_splat(s, kept_opacity(s, opacity), accuracy);
        if (!(c.splat.log2_opacity > c.splat.cut)) continue;
        const Footprint<real_t<T>> f = footprint_of<A>(s, c.splat, camera.cx, camera.cy);
        const Cover<A::support, real_t<T>> cover{f, camera.width, camera.height};
        cull(i, cover.rows(), f.x, camera, scratch);
        if (scratch.state[at] != Visibility::visible) continue;
        if (!c.rows.known(camera.width)) {
            scratch.footprints[at] = f;
            continue;
        }
        for (int y = c.rows.first_row(); y < c.rows.last_row(); ++y) {
            const Span x = cover.columns(y, c.rows);
            c.rows.columns[static_cast<std::size_t>(y - c.rows.first_row())] = {
                static_cast<std::uint16_t>(x.begin), static_cast<std::uint16_t>(x.end)};
        }
    }
}

/// Computes the gradients of a range of Gaussians, from slots to world.
template <class A, class T, Distortion D>
void project_vjp_range(const SplatInput<A, T, D>& in,
                       const std::type_identity_t<TracedSlots<T>>& traced, ChunkRange r,
                       Gaussians<T>& out) {
    const GaussianView<T>& g = in.gaussians;
    const RasterTrace<T>& trace = traced.trace;
    const PartialGradients<T>& slots = traced.slots;
    const Projector<T, D> lens(in.camera, in.accuracy.frustum_margin, screen_dilation(in.accuracy));
    std::vector<T> sum(static_cast<std::size_t>(slots.stride));
    for (Index i = r.begin; i < r.end; ++i) {
        const std::uint32_t m = trace.member[static_cast<std::size_t>(i)];
        if (m == no_member) {
            clear_gradient(out, i);
            continue;
        }
        merge_slots(trace.lists, slots, static_cast<Index>(m), sum.data());
        for (Index k = 0; k < g.channels(); ++k)
            out.feature(k, i) = sum[static_cast<std::size_t>(PartialGradients<T>::head + k)];
        const SplatCotangent<T> s{sum[0], sum[1], sum[2], sum[3], sum[4], sum[5], sum[6]};
        store_shape(project_vjp<A::antialias>(load_shape(g, i), lens,
                                              screen_cotangent(trace.members[m].splat, s), s.alpha),
                    out, i);
        out.opacity(0, i) = s.alpha / *g.opacity(i);
    }
}

} // namespace detail

} // namespace rye
