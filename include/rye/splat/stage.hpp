// SPDX-License-Identifier: Apache-2.0
/// rye/splat/stage.hpp: the per-Gaussian work before and after the pixel walks: project, cull and
/// count, sort by depth, deal out into tiles; and merge the tiles' gradients and pull them back.
#pragma once

#include <string>
#include <utility>

#include <rye/backend/xsimd.hpp>
#include <rye/splat/footprint.hpp>
#include <rye/splat/raster.hpp>

namespace rye {

/// Whether every number that is read of a Gaussian is finite and its quaternion has a direction.
template <class T>
bool usable(const Gaussians<T>& g, Index i) {
    int bad = 0;
    const auto look = [&](const T* x, Index n) {
        for (Index k = 0; k < n; ++k) {
            const real_t<T> v = value_of(x[k]);
            bad |= !(v - v == real_t<T>(0));                 // inf - inf is NaN
        }
    };
    look(g.mean.data() + 3 * i, 3);
    look(g.rotation.data() + 4 * i, 4);
    look(g.scale.data() + 3 * i, 3);
    look(g.opacity.data() + i, 1);
    look(g.feature.data() + i * g.channels(), g.channels());
    const T* q = g.rotation.data() + 4 * i;
    const bool turned = q[0] != T(0) || q[1] != T(0) || q[2] != T(0) || q[3] != T(0);
    return bad == 0 && turned;
}

/// Columns of fixed length; the compiler must not see a loop over a length it does not know.
template <class T>
Shape<T> load_shape(const Gaussians<T>& g, Index i) {
    return {Eigen::Map<const Vec3<T>>(g.mean.data() + 3 * i),
            Eigen::Map<const Quat<T>>(g.rotation.data() + 4 * i),
            Eigen::Map<const Vec3<T>>(g.scale.data() + 3 * i)};
}

template <class T>
void store_shape(const Shape<T>& s, Gaussians<T>& g, Index i) {
    Eigen::Map<Vec3<T>>(g.mean.data() + 3 * i) = s.mean;
    Eigen::Map<Quat<T>>(g.rotation.data() + 4 * i) = s.rotation;
    Eigen::Map<Vec3<T>>(g.scale.data() + 3 * i) = s.scale;
}

/// Completes candidate i, whose splat and footprint are known: it is visible if it has rows, of an
/// image that has columns.
template <class T, Distortion D>
void settle(Index i, const Span& rows, const Pinhole<T, D>& camera, RasterScratch<T>& scratch) {
    using R = real_t<T>;
    const auto at = static_cast<std::size_t>(i);
    Member<T>& c = scratch.candidates[at];
    c.rows.begin = rows.begin;
    c.rows.end = rows.end;
    c.source = static_cast<std::uint32_t>(i);
    const bool visible = rows.begin < rows.end && camera.width > 0;
    scratch.state[at] = visible ? Candidacy::visible : Candidacy::hidden;
    if (!visible) return;
    const R x = std::clamp(scratch.footprints[at].x, R(0), static_cast<R>(camera.width - 1));
    scratch.home[at] = static_cast<std::uint32_t>(
        rows.begin / tile_edge * tiles_across(camera.width) + static_cast<int>(x) / tile_edge);
}

/// Fills candidate and state of Gaussians [b, e); one at a time, for any scalar.
template <class A, class T, Distortion D>
void project_range(const Gaussians<T>& g, const Pinhole<T, D>& camera, const A& accuracy, Index b,
                   Index e, RasterScratch<T>& scratch) {
    const Lens<T, D> lens(camera, accuracy.frustum_margin, screen_dilation(accuracy));
    const bool look = accuracy.non_finite != NonFinite::trust;
    for (Index i = b; i < e; ++i) {
        const auto at = static_cast<std::size_t>(i);
        scratch.state[at] = Candidacy::non_finite;
        if (look && !usable(g, i)) continue;
        const Projected<T, A::antialias> s = project<A::antialias>(load_shape(g, i), lens);
        scratch.state[at] = Candidacy::hidden;
        if (!s.drawable || !(g.opacity(0, i) > T(0))) continue;
        Member<T>& c = scratch.candidates[at];
        c.splat = make_splat(s, kept_opacity(s, g.opacity(0, i)), accuracy);
        if (!(c.splat.log2_opacity > c.splat.cut)) continue;
        scratch.footprints[at] = footprint_of<A>(s, c.splat, camera.cx, camera.cy);
        const Cover<A::support, real_t<T>> cover{scratch.footprints[at], camera.width,
                                                 camera.height};
        settle(i, cover.rows(), camera, scratch);
        if (scratch.state[at] != Candidacy::visible || !c.rows.known(camera.width)) continue;
        for (int y = c.rows.first_row(); y < c.rows.last_row(); ++y) {
            const Span x = cover.columns(y, c.rows);
            c.rows.columns[static_cast<std::size_t>(y - c.rows.first_row())] = {
                static_cast<std::uint16_t>(x.begin), static_cast<std::uint16_t>(x.end)};
        }
    }
}

/// The depth of Gaussian i in double, whatever it is given in.
template <class T, Distortion D>
double fine_depth(const Gaussians<T>& g, const Pinhole<T, D>& camera, Index i) {
    const auto& pose = camera.camera_from_world;
    double z = 0;
    for (int k = 0; k < 3; ++k)
        z += static_cast<double>(value_of(pose.rotation(2, k))) *
             static_cast<double>(value_of(g.mean(k, i)));
    return z + static_cast<double>(value_of(pose.translation[2]));
}

/// Visible candidates become members, in the order of the tiles that they lie in, there by index.
/// Candidates are cut into as many chunks as there are threads, as in TileLists.
template <Threads P, class A, class T, Distortion D>
void gather_members(const Gaussians<T>& g, const Pinhole<T, D>& camera, const A& accuracy,
                    RasterScratch<T>& scratch, RasterTrace<T>& trace) {
    const auto tiles = static_cast<std::size_t>(tiles_across(camera.width)) *
                       static_cast<std::size_t>(tiles_across(camera.height));
    const Index n = static_cast<Index>(scratch.candidates.size());
    const Index grain = std::max<Index>(2048, (n + P::count() - 1) / P::count());
    const auto chunks = static_cast<std::size_t>(chunk_count(n, grain));
    if (scratch.homes.size() < chunks) scratch.homes.resize(chunks);
    for_chunks<P>(n, grain, [&](Index b, Index e, Index c) {
        auto& homes = scratch.homes[static_cast<std::size_t>(c)];
        homes.assign(tiles + 1, 0);      // the last counts those that are not finite
        for (auto i = static_cast<std::size_t>(b); i < static_cast<std::size_t>(e); ++i) {
            if (scratch.state[i] == Candidacy::visible) ++homes[scratch.home[i]];
            homes[tiles] += scratch.state[i] == Candidacy::non_finite ? 1U : 0U;
        }
    });
    std::uint32_t members = 0;
    for (std::size_t t = 0; t < tiles; ++t)
        for (std::size_t c = 0; c < chunks; ++c)
            members += std::exchange(scratch.homes[c][t], members);
    trace.non_finite = 0;
    for (std::size_t c = 0; c < chunks; ++c)
        trace.non_finite += static_cast<Index>(scratch.homes[c][tiles]);
    if (accuracy.non_finite == NonFinite::fail && trace.non_finite > 0)
        throw Error("rasterizer: got " + std::to_string(trace.non_finite) +
                    " Gaussians with a number that is not finite, expected none");
    trace.members.resize(members);
    trace.member.resize(static_cast<std::size_t>(n));
    trace.peaks.resize(A::order == BlendOrder::by_peak ? members : 0);
    for_chunks<P>(n, grain, [&](Index b, Index e, Index c) {
        auto& homes = scratch.homes[static_cast<std::size_t>(c)];
        for (auto i = static_cast<std::size_t>(b); i < static_cast<std::size_t>(e); ++i) {
            trace.member[i] = no_member;
            if (scratch.state[i] != Candidacy::visible) continue;
            const std::uint32_t m = homes[scratch.home[i]]++;
            if constexpr (A::order == BlendOrder::by_peak)
                trace.peaks[m] = ray_peak(g, camera, static_cast<Index>(i));
            trace.members[m] = scratch.candidates[i];
            trace.member[i] = m;
        }
    });
}

/// Visible candidates become members and entries of tiles in the order of depth, ties by index.
template <Backend B, class A, class T, Distortion D>
void arrange(const Gaussians<T>& g, const Pinhole<T, D>& camera, const A& accuracy,
             RasterScratch<T>& scratch, RasterTrace<T>& trace) {
    using R = real_t<T>;
    constexpr bool fine = A::depth_bits > 8 * static_cast<int>(sizeof(R));
    gather_members<typename B::threads>(g, camera, accuracy, scratch, trace);
    const auto member = [&](Index m) -> const Member<T>& {
        return trace.members[static_cast<std::size_t>(m)];
    };
    const auto key = [&](Index m) {
        if constexpr (fine)
            return depth_key(fine_depth(g, camera, static_cast<Index>(member(m).source)));
        else
            return depth_key(static_cast<R>(value_of(member(m).splat.depth)));
    };
    auto& deal = [&]() -> auto& {
        if constexpr (fine)
            return scratch.fine_deal;
        else
            return scratch.deal;
    }();
    trace.lists.template build<typename B::threads, A::support, R>(
        camera.width, camera.height, static_cast<Index>(trace.members.size()),
        [&](Index m) -> const TileRows& { return member(m).rows; }, key,
        [&](Index m) { return member(m).source; }, accuracy.max_entries,
        [&](Index m) -> const Footprint<R>& { return scratch.footprints[member(m).source]; },
        deal);
}

/// Adds a member's slots over its tiles, in the order of tiles, to sum[0 ... stride).
template <class T>
void merge_slots(const TileLists& lists, const Slots<T>& slots, Index member, T* sum) {
    std::fill_n(sum, slots.stride, T(0));
    const auto m = static_cast<std::size_t>(member);
    for (Index i = lists.first[m]; i < lists.first[m + 1]; ++i) {
        if (!slots.is_touched(i)) continue;
        const T* s = slots[i];
        for (Index k = 0; k < slots.stride; ++k) sum[k] += s[k];
    }
}

/// Zeros for a Gaussian that is not drawn.
template <class T>
void clear_gradient(Gaussians<T>& out, Index i) {
    Gaussians<T>::fields(
        [&](const std::string&, Columns<T>& a) { a.col(i).setZero(); }, out);
}

/// Gradients of Gaussians [b, e), from slots to world.
template <class A, class T, Distortion D>
void pull_back_range(const Gaussians<T>& g, const Pinhole<T, D>& camera, const A& accuracy,
                     const RasterTrace<T>& trace, const Slots<T>& slots, Index b, Index e,
                     Gaussians<T>& out) {
    const Lens<T, D> lens(camera, accuracy.frustum_margin, screen_dilation(accuracy));
    std::vector<T> sum(static_cast<std::size_t>(slots.stride));
    for (Index i = b; i < e; ++i) {
        const std::uint32_t m = trace.member[static_cast<std::size_t>(i)];
        if (m == no_member) {
            clear_gradient(out, i);
            continue;
        }
        merge_slots(trace.lists, slots, static_cast<Index>(m), sum.data());
        for (Index k = 0; k < g.channels(); ++k)
            out.feature(k, i) = sum[static_cast<std::size_t>(Slots<T>::head + k)];
        const SplatCotangent<T> s{sum[0], sum[1], sum[2], sum[3], sum[4], sum[5], sum[6]};
        store_shape(project_vjp<A::antialias>(load_shape(g, i), lens,
                                              screen_cotangent(trace.members[m].splat, s), s.alpha),
                    out, i);
        out.opacity(0, i) = s.alpha / g.opacity(0, i);
    }
}

} // namespace rye
