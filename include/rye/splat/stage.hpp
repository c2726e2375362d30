// SPDX-License-Identifier: Apache-2.0
/// rye/splat/stage.hpp: work per Gaussian before and after the pixel walks, for all backends: cull,
/// count, sort by depth, bin into tiles; merge the tiles' gradients. Projection and its adjoint are
/// in plain/stage.hpp and lanes/stage.hpp.
#pragma once

#include <string>
#include <type_traits>
#include <utility>

#include <rye/backend/backend.hpp>
#include <rye/splat/footprint.hpp>
#include <rye/splat/raster.hpp>

namespace rye {

namespace detail {

/// Indices [begin, end) of the Gaussians or tiles of one chunk.
struct ChunkRange {
    Index begin, end;
};

} // namespace detail

/// Gaussians to draw, with the camera and the rules.
template <class A, class T, Distortion D>
struct SplatInput {
    GaussianView<T> gaussians;
    const Pinhole<T, D>& camera;
    const A& accuracy;
};
template <class A, class T, Distortion D>
SplatInput(const GaussianView<T>&, const Pinhole<T, D>&, const A&) -> SplatInput<A, T, D>;

namespace detail {

/// The partial gradients of a render.
template <class T>
struct TracedSlots {
    const RasterTrace<T>& trace;
    const PartialGradients<T>& slots;
};

} // namespace detail

/// Completes candidate i, whose splat is known: it is visible if it has rows, of an image that has
/// columns. x: its centre [px].
template <class T, Distortion D>
void cull(Index i, const Span& rows, const real_t<T>& x, const Pinhole<T, D>& camera,
          RasterScratch<T>& scratch) {
    using R = real_t<T>;
    const auto at = static_cast<std::size_t>(i);
    VisibleGaussian<T>& c = scratch.candidates[at];
    c.rows.begin = rows.begin;
    c.rows.end = rows.end;
    c.source = static_cast<std::uint32_t>(i);
    const bool visible = rows.begin < rows.end && camera.width > 0;
    scratch.state[at] = visible ? Visibility::visible : Visibility::hidden;
    if (!visible) return;
    const R column = std::clamp(x, R(0), static_cast<R>(camera.width - 1));
    scratch.first_tile[at] =
        static_cast<std::uint32_t>(rows.begin / detail::tile_edge * tiles_across(camera.width) +
                                   static_cast<int>(column) / detail::tile_edge);
}

namespace detail {

/// Returns the depth of Gaussian i in double, whatever it is given in.
template <class T, Distortion D>
double fine_depth(const GaussianView<T>& g, const Pinhole<T, D>& camera, Index i) {
    const auto& pose = camera.camera_from_world;
    double z = 0;
    for (int k = 0; k < 3; ++k)
        z += static_cast<double>(value_of(pose.rotation(2, k))) *
             static_cast<double>(value_of(g.mean(i)[k]));
    return z + static_cast<double>(value_of(pose.translation[2]));
}

/// Makes visible candidates members, in the order of the tiles that they lie in, there by index.
/// Candidates are cut into as many chunks as there are threads, as in TileLists.
template <Threads P, class A, class T, Distortion D>
void gather_members(const P& threads, const SplatInput<A, T, D>& in, RasterScratch<T>& scratch,
                    RasterTrace<T>& trace) {
    const Pinhole<T, D>& camera = in.camera;
    const auto tiles = static_cast<std::size_t>(tiles_across(camera.width)) *
                       static_cast<std::size_t>(tiles_across(camera.height));
    const Index n = in.gaussians.count();
    const Index grain = std::max<Index>(512, (n + threads.size() - 1) / threads.size());
    const auto chunks = static_cast<std::size_t>(chunk_count(n, grain));
    if (scratch.tile_counts.size() < chunks) scratch.tile_counts.resize(chunks);
    for_chunks(threads, n, grain, [&](Index b, Index e, Index c) {
        auto& counts = scratch.tile_counts[static_cast<std::size_t>(c)];
        counts.assign(tiles + 1, 0);      // the last counts those that are not finite
        for (auto i = static_cast<std::size_t>(b); i < static_cast<std::size_t>(e); ++i) {
            if (scratch.state[i] == Visibility::visible) ++counts[scratch.first_tile[i]];
            counts[tiles] += scratch.state[i] == Visibility::non_finite ? 1U : 0U;
        }
    });
    std::uint32_t members = 0;
    for (std::size_t t = 0; t < tiles; ++t)
        for (std::size_t c = 0; c < chunks; ++c)
            members += std::exchange(scratch.tile_counts[c][t], members);
    trace.non_finite = 0;
    for (std::size_t c = 0; c < chunks; ++c)
        trace.non_finite += static_cast<Index>(scratch.tile_counts[c][tiles]);
    if (in.accuracy.non_finite == NonFinite::fail && trace.non_finite > 0)
        throw Error("rasterizer: got " + std::to_string(trace.non_finite) +
                    " Gaussians with a number that is not finite, expected none");
    trace.members.resize(members);
    trace.member.resize(static_cast<std::size_t>(n));
    trace.peaks.resize(A::order == BlendOrder::by_peak ? members : 0);
    for_chunks(threads, n, grain, [&](Index b, Index e, Index c) {
        auto& counts = scratch.tile_counts[static_cast<std::size_t>(c)];
        for (auto i = static_cast<std::size_t>(b); i < static_cast<std::size_t>(e); ++i) {
            trace.member[i] = no_member;
            if (scratch.state[i] != Visibility::visible) continue;
            const std::uint32_t m = counts[scratch.first_tile[i]]++;
            if constexpr (A::order == BlendOrder::by_peak)
                trace.peaks[m] = ray_peak(in.gaussians, camera, static_cast<Index>(i));
            trace.members[m] = scratch.candidates[i];
            trace.member[i] = m;
        }
    });
}

} // namespace detail

/// Makes visible candidates members and entries of tiles in the order of depth, ties by index.
template <class A, class T, Distortion D, Backend B>
void bin_and_sort(const B& backend, const SplatInput<A, T, D>& in, RasterScratch<T>& scratch,
                  RasterTrace<T>& trace) {
    using R = real_t<T>;
    constexpr bool fine = A::depth_bits > 8 * static_cast<int>(sizeof(R));
    detail::gather_members(backend.threads, in, scratch, trace);
    const auto member = [&](Index m) -> const VisibleGaussian<T>& {
        return trace.members[static_cast<std::size_t>(m)];
    };
    const auto key = [&](Index m) {
        if constexpr (fine)
            return detail::depth_key(
                detail::fine_depth(in.gaussians, in.camera, static_cast<Index>(member(m).source)));
        else
            return detail::depth_key(static_cast<R>(value_of(member(m).splat.depth)));
    };
    auto& bins = [&]() -> auto& {
        if constexpr (fine)
            return scratch.fine_bins;
        else
            return scratch.bins;
    }();
    const detail::BinInput members{
        static_cast<Index>(trace.members.size()),
        [&](Index m) -> const detail::TileRows& { return member(m).rows; }, key,
        [&](Index m) { return member(m).source; },
        [&](Index m) -> const Footprint<R>& { return scratch.footprints[member(m).source]; }};
    trace.lists.template build<A::support, R>(backend.threads, {in.camera.width, in.camera.height},
                                              members, in.accuracy.max_memory, bins);
}

/// Adds a member's slots over its tiles, in the order of tiles, to sum[0 ... stride).
template <class T>
void merge_slots(const TileLists& lists, const detail::PartialGradients<T>& slots, Index member,
                 T* sum) {
    std::fill_n(sum, slots.stride, T(0));
    const auto m = static_cast<std::size_t>(member);
    for (Index i = lists.first[m]; i < lists.first[m + 1]; ++i) {
        if (!slots.is_touched(i)) continue;
        const T* s = slots[i];
        for (Index k = 0; k < slots.stride; ++k) sum[k] += s[k];
    }
}

namespace detail {

/// Writes zeros for a Gaussian that is not drawn.
template <class T>
void clear_gradient(Gaussians<T>& out, Index i) {
    Gaussians<T>::fields(
        [&](const std::string&, Columns<T>& a) { a.col(i).setZero(); }, out);
}

} // namespace detail

} // namespace rye
