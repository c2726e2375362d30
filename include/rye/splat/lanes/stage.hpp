// SPDX-License-Identifier: Apache-2.0
/// rye/splat/lanes/stage.hpp: the per-Gaussian formulas with a Gaussian in each lane. The formulas
/// are those of gaussian/project.hpp, instantiated on batches; this file only fills the lanes.
#pragma once

#include <rye/splat/lanes/registers.hpp>
#include <rye/splat/stage.hpp>

namespace rye {

namespace detail {

/// A few numbers of as many Gaussians as there are lanes: row k holds number k of every lane.
template <class V, int Rows>
struct LaneBlock {
    using T = typename V::value_type;
    static constexpr int lanes = static_cast<int>(V::size);
    alignas(64) T row[std::size_t(Rows)][V::size];

    V operator[](int k) const { return V::load_aligned(row[k]); }
    void set(int k, const V& x) { x.store_aligned(row[k]); }
};

/// Mean, rotation, scale and opacity of Gaussians index(0) ... index(lanes - 1).
template <class V>
struct LaneShapes {
    using T = typename V::value_type;
    LaneBlock<V, 11> in;

    template <class IndexOf>
    LaneShapes(const GaussianView<T>& g, const IndexOf& index) {
        for (int lane = 0; lane < LaneBlock<V, 11>::lanes; ++lane) {
            const Index i = opaque(index(lane));
            const T *const mean = g.mean(i), *const rotation = g.rotation(i);
            const T *const scale = g.scale(i), *const opacity = g.opacity(i);
            for (int k = 0; k < 3; ++k) in.row[k][lane] = mean[k];
            for (int k = 0; k < 4; ++k) in.row[3 + k][lane] = rotation[k];
            for (int k = 0; k < 3; ++k) in.row[7 + k][lane] = scale[k];
            in.row[10][lane] = *opacity;
        }
    }
    Shape<V> shape() const {
        return {Vec3<V>(in[0], in[1], in[2]), Quat<V>(in[3], in[4], in[5], in[6]),
                Vec3<V>(in[7], in[8], in[9])};
    }
    V opacity() const { return in[10]; }
    /// Returns 1 where the numbers are finite, else 0.
    V usable() const {
        const V zero(T(0));
        V sum = in[0] * zero;                                // 0, or NaN
        for (int k = 1; k < 11; ++k) sum = sum + in[k] * zero;
        return select(sum == zero, V(T(1)), zero);
    }
};

} // namespace detail

/// Returns true if n numbers are finite.
template <class V>
bool finite_numbers(const typename V::value_type* x, Index n) {
    using T = typename V::value_type;
    constexpr Index lanes = static_cast<Index>(V::size);
    V sum(T(0));
    T tail(0);
    Index k = 0;
    for (; k + lanes <= n; k += lanes) sum = sum + V::load_unaligned(x + k) * V(T(0));
    for (; k < n; ++k) tail += x[k] * T(0);
    return all(sum == V(T(0))) && tail == T(0);
}

/// Does what project_range does, for as many Gaussians at a time as there are lanes.
template <class V, class A>
void project_range_lanes(const SplatInput<A, typename V::value_type, NoDistortion>& from,
                         detail::ChunkRange r, RasterScratch<typename V::value_type>& scratch) {
    using T = typename V::value_type;
    const GaussianView<T>& g = from.gaussians;
    const Pinhole<T>& camera = from.camera;
    const A& accuracy = from.accuracy;
    const Index e = r.end;
    constexpr int lanes = static_cast<int>(V::size);
    const Projector<V> lens(
        Projector<T>(camera, accuracy.frustum_margin, screen_dilation(accuracy)));
    const V cx(camera.cx), cy(camera.cy), zero(T(0));
    const bool look = accuracy.non_finite != NonFinite::trust;
    for (Index start = r.begin; start < e; start += lanes) {
        const detail::LaneShapes<V> in(g, [&](int lane) { return std::min(start + lane, e - 1); });
        const Projected<V, A::antialias> s = project<A::antialias>(in.shape(), lens);
        const V o = in.opacity();
        const Splat<V> splat =
            make_splat(s, V(select(o > zero, detail::kept_opacity(s, o), V(T(1)))), accuracy);
        const Footprint<V> f = detail::footprint_of<A>(s, splat, cx, cy);
        const V usable = in.usable();
        const auto seen = s.drawable && (o > zero) && (splat.log2_opacity > splat.cut);

        detail::LaneBlock<V, 17> out;
        const V* const values[17] = {&splat.x, &splat.y, &splat.ux, &splat.vx, &splat.vy,
                                     &splat.log2_opacity, &splat.cut, &splat.floor, &splat.depth,
                                     &f.x, &f.y, &f.radius, &f.covariance.xx, &f.covariance.xy,
                                     &f.covariance.yy, &f.determinant, &usable};
        for (int k = 0; k < 17; ++k) out.set(k, *values[k]);
        detail::LaneBlock<V, 1> visible;
        visible.set(0, select(seen, V(T(1)), zero));
        const Cover<A::support, V> cover{f, camera.width, camera.height};
        const detail::PixelInterval<V> rows = cover.row_range();
        detail::LaneBlock<V, 2 + 2 * detail::TileRows::most>
            range; // range of pixels: rows, then columns
        range.set(0, rows.begin);
        range.set(1, rows.end);
        const typename Cover<A::support, V>::Slabs slabs(cover);
        V top = floor(rows.begin * V(T(1) / detail::tile_edge)) * V(T(detail::tile_edge));
        for (int j = 0; j < detail::TileRows::most; ++j) {
            const V bottom = top + V(T(detail::tile_edge));
            const detail::PixelInterval<V> px =
                slabs.pixels(max(top, rows.begin), min(bottom, rows.end));
            range.set(2 + 2 * j, px.begin);
            range.set(3 + 2 * j, px.end);
            top = bottom;
        }
        for (int lane = 0; lane < lanes && start + lane < e; ++lane) {
            const Index i = start + lane;
            const auto at = static_cast<std::size_t>(i);
            const auto value = [&](int k) { return out.row[k][lane]; };
            const T* feature = g.feature_of(i);
            if (look && (!(value(16) > T(0)) || !finite_numbers<V>(feature, g.channels()))) {
                scratch.state[at] = Visibility::non_finite;
                continue;
            }
            scratch.state[at] = Visibility::hidden;
            if (!(visible.row[0][lane] > T(0))) continue;
            VisibleGaussian<T>& c = scratch.candidates[at];
            c.splat = {value(0), value(1), value(2), value(3), value(4),
                       value(5), value(6), value(7), value(8)};
            const auto span = [&](int k) {
                return whole(detail::PixelInterval<T>{range.row[k][lane], range.row[k + 1][lane]});
            };
            cull(i, span(0), value(9), camera, scratch);
            if (scratch.state[at] != Visibility::visible) continue;
            if (!c.rows.known(camera.width)) {
                scratch.footprints[at] = {value(9), value(10), value(11),
                                          {value(12), value(13), value(14)}, value(15)};
                continue;
            }
            for (int j = 0; j < c.rows.last_row() - c.rows.first_row(); ++j) {
                const Span x = tiles_of(span(2 + 2 * j));
                c.rows.columns[static_cast<std::size_t>(j)] = {
                    static_cast<std::uint16_t>(x.begin), static_cast<std::uint16_t>(x.end)};
            }
        }
    }
}

namespace detail {

/// Does what merge_slots does, for the 8 leading numbers and, in whole eights, the features.
template <class Lanes>
void merge_slots_lanes(const TileLists& lists,
                       const PartialGradients<typename Lanes::value_type>& slots, Index member,
                       typename Lanes::value_type* sum) {
    using V = typename EightLanes<Lanes>::type;
    using T = typename V::value_type;
    constexpr Index lanes = static_cast<Index>(V::size);
    if constexpr (8 % lanes != 0) {
        merge_slots(lists, slots, member, sum);
    } else {
        const auto m = static_cast<std::size_t>(member);
        const Index begin = lists.first[m], end = lists.first[m + 1];
        for (Index k = 0; k < slots.stride; k += 8) {
            std::array<V, static_cast<std::size_t>(8 / lanes)> s;
            s.fill(V(T(0)));
            for (Index i = begin; i < end; ++i)
                if (slots.is_touched(i))
                    for (std::size_t p = 0; p < s.size(); ++p)
                        s[p] = s[p] +
                               V::load_aligned(slots[i] + k + static_cast<Index>(p) * lanes);
            for (std::size_t p = 0; p < s.size(); ++p)
                s[p].store_aligned(sum + k + static_cast<Index>(p) * lanes);
        }
    }
}

/// Prefetches the slots of a Gaussian a few steps ahead, whose range was prefetched before.
/// Always inlined, as fetch_record.
template <class T>
[[gnu::always_inline]] inline void fetch_slots(const RasterTrace<T>& trace,
                                               const PartialGradients<T>& slots, Index index) {
    const std::uint32_t m = trace.member[static_cast<std::size_t>(index)];
    if (m == no_member) return;
    prefetch(&trace.members[m]);
    constexpr Index line = 64 / static_cast<Index>(sizeof(T));
    const T* const end = slots[trace.lists.first[std::size_t(m) + 1]];
    for (const T* s = slots[trace.lists.first[m]]; s < end; s += line) prefetch(s);
}

/// Memory of one thread's gradients.
template <class V>
struct LaneSums : Workspaces::Space {
    AlignedArray<typename V::value_type> sum;
};

/// Does what project_vjp_range does, for as many Gaussians at a time as there are lanes.
template <class V, class A>
void project_vjp_range_lanes(const SplatInput<A, typename V::value_type, NoDistortion>& from,
                             const TracedSlots<typename V::value_type>& traced, ChunkRange range,
                             Gaussians<typename V::value_type>& out, LaneSums<V>& memory) {
    using T = typename V::value_type;
    constexpr int lanes = static_cast<int>(V::size);
    const GaussianView<T>& g = from.gaussians;
    const RasterTrace<T>& trace = traced.trace;
    const PartialGradients<T>& slots = traced.slots;
    const Index e = range.end;
    const Projector<V> lens(
        Projector<T>(from.camera, from.accuracy.frustum_margin, screen_dilation(from.accuracy)));
    const Index channels = g.channels();
    T* const sum = memory.sum.reserve(slots.stride);
    std::array<Index, static_cast<std::size_t>(lanes)> index{};
    LaneBlock<V, 10> in_slots;
    for (Index i = range.begin; i < e;) {
        int filled = 0;
        for (; i < e && filled < lanes; ++i) {
            if (i + 4 * lanes < e) {
                const std::uint32_t far = trace.member[static_cast<std::size_t>(i + 4 * lanes)];
                if (far != no_member) prefetch(&trace.lists.first[far]);
            }
            const std::uint32_t m = trace.member[static_cast<std::size_t>(i)];
            if (m == no_member) {
                clear_gradient(out, i);
                continue;
            }
            merge_slots_lanes<V>(trace.lists, slots, static_cast<Index>(m), sum);
            const Splat<T>& s = trace.members[m].splat;
            for (int k = 0; k < 7; ++k) in_slots.row[k][filled] = sum[k];
            in_slots.row[7][filled] = s.ux;
            in_slots.row[8][filled] = s.vx;
            in_slots.row[9][filled] = s.vy;
            T* const to = out.feature.data() + i * channels;
            for (Index k = 0; k < channels; ++k) to[k] = sum[PartialGradients<T>::head + k];
            index[static_cast<std::size_t>(filled++)] = i;
        }
        if (filled == 0) break;
        const LaneShapes<V> in(g, [&](int lane) {
            return index[static_cast<std::size_t>(std::min(lane, filled - 1))];
        });
        for (int lane = filled; lane < lanes; ++lane)
            for (auto& row : in_slots.row) row[lane] = T(0);
        Splat<V> splat;
        splat.ux = in_slots[7];
        splat.vx = in_slots[8];
        splat.vy = in_slots[9];
        const SplatCotangent<V> c{in_slots[0], in_slots[1], in_slots[2], in_slots[3],
                                  in_slots[4], in_slots[5], in_slots[6]};
        const Shape<V> d = project_vjp<A::antialias>(in.shape(), lens, screen_cotangent(splat, c),
                                                     c.alpha);
        LaneBlock<V, 11> r;
        for (int k = 0; k < 3; ++k) r.set(k, d.mean[k]);
        for (int k = 0; k < 4; ++k) r.set(3 + k, d.rotation[k]);
        for (int k = 0; k < 3; ++k) r.set(7 + k, d.scale[k]);
        r.set(10, c.alpha / in.opacity());
        for (int lane = 0; lane < filled; ++lane) {
            if (i + lanes + lane < e) fetch_slots(trace, slots, i + lanes + lane);
            const Index to = opaque(index[static_cast<std::size_t>(lane)]);
            for (int k = 0; k < 3; ++k) out.mean.data()[3 * to + k] = r.row[k][lane];
            for (int k = 0; k < 4; ++k) out.rotation.data()[4 * to + k] = r.row[3 + k][lane];
            for (int k = 0; k < 3; ++k) out.scale.data()[3 * to + k] = r.row[7 + k][lane];
            out.opacity.data()[to] = r.row[10][lane];
        }
    }
}

} // namespace detail

} // namespace rye
