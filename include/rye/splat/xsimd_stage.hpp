// SPDX-License-Identifier: Apache-2.0
/// rye/splat/xsimd_stage.hpp: the per-Gaussian formulas with a Gaussian in each lane. The formulas
/// are those of gaussian/project.hpp, instantiated on batches; here is only how lanes are filled.
#pragma once

#include <rye/backend/xsimd.hpp>
#include <rye/splat/stage.hpp>

namespace rye {

/// A few numbers of as many Gaussians as there are lanes: row k holds number k of every lane.
template <class V, int Rows>
struct LaneBlock {
    using T = typename V::value_type;
    static constexpr int lanes = static_cast<int>(V::size);
    alignas(64) T row[Rows][lanes];

    V operator[](int k) const { return V::load_aligned(row[k]); }
    void set(int k, const V& x) { x.store_aligned(row[k]); }
};

/// Mean, rotation, scale and opacity of Gaussians index(0) ... index(lanes - 1).
template <class V>
struct LaneShapes {
    using T = typename V::value_type;
    LaneBlock<V, 11> in;

    template <class IndexOf>
    LaneShapes(const Gaussians<T>& g, const IndexOf& index) {
        for (int lane = 0; lane < LaneBlock<V, 11>::lanes; ++lane) {
            const Index i = index(lane);
            for (int k = 0; k < 3; ++k) in.row[k][lane] = g.mean.data()[3 * i + k];
            for (int k = 0; k < 4; ++k) in.row[3 + k][lane] = g.rotation.data()[4 * i + k];
            for (int k = 0; k < 3; ++k) in.row[7 + k][lane] = g.scale.data()[3 * i + k];
            in.row[10][lane] = g.opacity.data()[i];
        }
    }
    Shape<V> shape() const {
        return {Vec3<V>(in[0], in[1], in[2]), Quat<V>(in[3], in[4], in[5], in[6]),
                Vec3<V>(in[7], in[8], in[9])};
    }
    V opacity() const { return in[10]; }
    /// 1 where the numbers are finite and the quaternion has a direction, else 0.
    V usable() const {
        const V zero(T(0));
        V sum = in[0] * zero;                                // 0, or NaN
        for (int k = 1; k < 11; ++k) sum = sum + in[k] * zero;
        const auto turned = in[3] != zero || in[4] != zero || in[5] != zero || in[6] != zero;
        return select((sum == zero) && turned, V(T(1)), zero);
    }
};

/// Whether n numbers are finite.
template <class V>
bool all_finite(const typename V::value_type* x, Index n) {
    using T = typename V::value_type;
    constexpr Index lanes = static_cast<Index>(V::size);
    V sum(T(0));
    T tail(0);
    Index k = 0;
    for (; k + lanes <= n; k += lanes) sum = sum + V::load_unaligned(x + k) * V(T(0));
    for (; k < n; ++k) tail += x[k] * T(0);
    return all(sum == V(T(0))) && tail == T(0);
}

/// As project_range, as many Gaussians at a time as there are lanes.
template <class V, class A>
void project_range_lanes(const Gaussians<typename V::value_type>& g,
                         const Pinhole<typename V::value_type>& camera, const A& accuracy, Index b,
                         Index e, RasterScratch<typename V::value_type>& scratch) {
    using T = typename V::value_type;
    constexpr int lanes = static_cast<int>(V::size);
    const Lens<V> lens(Lens<T>(camera, accuracy.frustum_margin, accuracy.dilation));
    const V cx(camera.cx), cy(camera.cy), zero(T(0));
    for (Index start = b; start < e; start += lanes) {
        const LaneShapes<V> in(g, [&](int lane) { return std::min(start + lane, e - 1); });
        const ScreenGaussian<V> s = project(in.shape(), lens);
        const V o = in.opacity();
        const Splat<V> splat = make_splat(s, V(select(o > zero, o, V(T(1)))), accuracy);
        const Footprint<V> f = footprint_of<A>(s, splat, cx, cy);
        const V usable = in.usable();
        const auto seen = s.drawable && (o > zero) && (splat.log2_opacity > splat.cut);

        LaneBlock<V, 17> out;
        const V* const values[17] = {&splat.x, &splat.y, &splat.ux, &splat.vx, &splat.vy,
                                     &splat.log2_opacity, &splat.cut, &splat.floor, &splat.depth,
                                     &f.x, &f.y, &f.radius, &f.covariance.xx, &f.covariance.xy,
                                     &f.covariance.yy, &f.determinant, &usable};
        for (int k = 0; k < 17; ++k) out.set(k, *values[k]);
        LaneBlock<V, 1> visible;
        visible.set(0, select(seen, V(T(1)), zero));
        for (int lane = 0; lane < lanes && start + lane < e; ++lane) {
            const Index i = start + lane;
            const auto at = static_cast<std::size_t>(i);
            const auto value = [&](int k) { return out.row[k][lane]; };
            const T* feature = g.feature.data() + i * g.channels();
            if (!(value(16) > T(0)) || !all_finite<V>(feature, g.channels())) {
                scratch.state[at] = Candidacy::non_finite;
                continue;
            }
            scratch.state[at] = Candidacy::hidden;
            if (!(visible.row[0][lane] > T(0))) continue;
            auto& c = scratch.candidates[at];
            c.splat = {value(0), value(1), value(2), value(3), value(4),
                       value(5), value(6), value(7), value(8)};
            c.footprint = {value(9), value(10), value(11), {value(12), value(13), value(14)},
                           value(15)};
            settle<A>(camera, i, scratch);
        }
    }
}

/// Asks for the slots of a member that is a few steps away, and for the column that they go to.
/// Always inlined, as fetch_ahead.
template <class T>
[[gnu::always_inline]] inline void fetch_slots_ahead(const TileLists& lists,
                                                     const RasterScratch<T>& scratch,
                                                     Index source, Index member,
                                                     const Columns<T>& out) {
    constexpr Index line = 64 / static_cast<Index>(sizeof(T));
    const Index channels = out.rows();
    for (Index c = 0; c < channels; c += line)
        __builtin_prefetch(out.data() + source * channels + c, 1);
    const auto m = static_cast<std::size_t>(member);
    for (Index i = lists.first[m]; i < lists.first[m + 1]; ++i) {
        const Index entry = lists.place[static_cast<std::size_t>(i)];
        if (scratch.touched[static_cast<std::size_t>(entry)] == 0) continue;
        __builtin_prefetch(&scratch.slots[static_cast<std::size_t>(entry)]);
        const T* f = scratch.feature_slots.data() + entry * channels;
        for (Index c = 0; c < channels; c += line) __builtin_prefetch(f + c);
    }
}

/// As pull_back_range, as many members at a time as there are lanes.
template <class V, class A>
void pull_back_range_lanes(const Gaussians<typename V::value_type>& g,
                           const Pinhole<typename V::value_type>& camera, const A& accuracy,
                           const RasterTrace<typename V::value_type>& trace,
                           const RasterScratch<typename V::value_type>& scratch, Index b, Index e,
                           Gaussians<typename V::value_type>& out) {
    using T = typename V::value_type;
    constexpr int lanes = static_cast<int>(V::size);
    const Lens<V> lens(Lens<T>(camera, accuracy.frustum_margin, accuracy.dilation));
    const Index channels = g.channels();
    for (Index start = b; start < e; start += lanes) {
        const auto member = [&](int lane) {
            return static_cast<std::size_t>(std::min(start + lane, e - 1));
        };
        const auto source = [&](int lane) -> Index { return trace.source[member(lane)]; };
        for (Index r = start + lanes; r < std::min(start + 2 * lanes, e); ++r)
            fetch_slots_ahead(trace.lists, scratch, trace.source[static_cast<std::size_t>(r)], r,
                              out.feature);
        LaneBlock<V, 10> slots;
        for (int lane = 0; lane < lanes; ++lane) {
            const Splat<T>& s = trace.splats[member(lane)];
            SplatCotangent<T> c{};
            if (start + lane < e) {
                c = merge_slots(trace.lists, scratch, start + lane);
                T* to = out.feature.data() + source(lane) * channels;
                Index k = 0;
                for (; k + lanes <= channels; k += lanes)
                    merge_features<V>(trace.lists, scratch, start + lane, k, [](const T* from) {
                        return V::load_unaligned(from);
                    }).store_unaligned(to + k);
                for (; k < channels; ++k)
                    to[k] = merge_features<T>(trace.lists, scratch, start + lane, k,
                                              [](const T* from) { return *from; });
            }
            const T values[10] = {c.u, c.v, c.uu, c.uv, c.vv, c.alpha, c.depth, s.ux, s.vx, s.vy};
            for (int k = 0; k < 10; ++k) slots.row[k][lane] = values[k];
        }
        const LaneShapes<V> in(g, source);
        Splat<V> splat;
        splat.ux = slots[7];
        splat.vx = slots[8];
        splat.vy = slots[9];
        const SplatCotangent<V> c{slots[0], slots[1], slots[2], slots[3],
                                  slots[4], slots[5], slots[6]};
        const Shape<V> d = project_vjp(in.shape(), lens, screen_cotangent(splat, c));
        LaneBlock<V, 11> r;
        for (int k = 0; k < 3; ++k) r.set(k, d.mean[k]);
        for (int k = 0; k < 4; ++k) r.set(3 + k, d.rotation[k]);
        for (int k = 0; k < 3; ++k) r.set(7 + k, d.scale[k]);
        r.set(10, c.alpha / in.opacity());
        for (int lane = 0; lane < lanes && start + lane < e; ++lane) {
            const Index i = source(lane);
            for (int k = 0; k < 3; ++k) out.mean.data()[3 * i + k] = r.row[k][lane];
            for (int k = 0; k < 4; ++k) out.rotation.data()[4 * i + k] = r.row[3 + k][lane];
            for (int k = 0; k < 3; ++k) out.scale.data()[3 * i + k] = r.row[7 + k][lane];
            out.opacity.data()[i] = r.row[10][lane];
        }
    }
}

} // namespace rye
