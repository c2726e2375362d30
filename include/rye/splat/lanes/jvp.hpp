// SPDX-License-Identifier: Apache-2.0
/// rye/splat/lanes/jvp.hpp: a render in lanes together with its derivative in a direction. The
/// visible Gaussians' screen numbers get their tangents by the projection on duals of batches; a
/// strip then takes each entry once for the value and once for the tangent.
#pragma once

#include <rye/splat/lanes/forward.hpp>
#include <rye/splat/lanes/stage.hpp>
#include <rye/splat/tangents.hpp>

namespace rye {

namespace detail {

/// Gaussians, their tangents or null, and the camera with its own.
template <class V, class A>
struct TangentInput {
    using T = typename V::value_type;
    const GaussianView<T>& gaussians;
    const Gaussians<T>* tangent;
    const Pinhole<Dual<V, 1>>& camera;
    const A& accuracy;
};

} // namespace detail

/// Computes the tangents of the screen numbers of a range of visible Gaussians.
template <class V, class A>
void project_tangents(const detail::TangentInput<V, A>& moves,
                      const RasterTrace<typename V::value_type>& trace, detail::ChunkRange r,
                      detail::SplatTangent<typename V::value_type>* to) {
    using T = typename V::value_type;
    const GaussianView<T>& g = moves.gaussians;
    const Gaussians<T>* const tangent = moves.tangent;
    const A& accuracy = moves.accuracy;
    const Index e = r.end;
    using Number = Dual<V, 1>;
    constexpr int lanes = static_cast<int>(V::size);
    const Projector<Number> projector(moves.camera, accuracy.frustum_margin,
                                      screen_dilation(accuracy));
    for (Index start = r.begin; start < e; start += lanes) {
        const auto index = [&](int lane) {
            const Index m = std::min(start + lane, e - 1);
            return static_cast<Index>(trace.members[static_cast<std::size_t>(m)].source);
        };
        const detail::LaneShapes<V> in(g, index);
        detail::LaneBlock<V, 11> still;
        for (auto& row : still.row) std::fill_n(row, lanes, T(0));
        const detail::LaneBlock<V, 11> moved =
            tangent != nullptr ? detail::LaneShapes<V>(*tangent, index).in : still;
        const auto number = [&](int k) { return detail::dual_of<V>(in.in[k], moved[k]); };
        const Shape<Number> shape{
            Vec3<Number>(number(0), number(1), number(2)),
            Quat<Number>(number(3), number(4), number(5), number(6)),
            Vec3<Number>(number(7), number(8), number(9))};
        const Projected<Number, A::antialias> s = project<A::antialias>(shape, projector);
        const Splat<Number> splat = make_splat(s, detail::kept_opacity(s, number(10)), accuracy);
        detail::LaneBlock<V, 8> out;
        const Number* const numbers[8] = {&splat.x,  &splat.y,  &splat.ux,    &splat.vx,
                                          &splat.vy, &splat.log2_opacity, &splat.floor,
                                          &splat.depth};
        for (int k = 0; k < 8; ++k) out.set(k, numbers[k]->d[0]);
        for (int lane = 0; lane < lanes && start + lane < e; ++lane) {
            const auto row = [&](int k) { return out.row[k][lane]; };
            to[start + lane] = {row(0), row(1), row(2), row(3), row(4), row(5), row(6), row(7)};
        }
    }
}

namespace detail {

/// The tangent of an entry as the strips see it, beside LaneEntry.
template <class V>
struct alignas(64) LaneEntryTangent {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    T v[Tile::columns];        ///< tangent of v = this + down
    T exponent[Tile::columns]; ///< tangent of the exponent = this - 2 v (tangent of v)
    T down[tile_edge];
    T floor, depth;
    T colour[std::size_t(LaneEntry<V>::few)];
};

/// Memory of one thread's tiles.
template <class V>
struct LaneTangentCanvas : Workspaces::Space {
    using T = typename V::value_type;
    LaneGroup<V> group;
    LaneEntryTangent<V> tangent[std::size_t(LaneGroup<V>::usual)];
    /// [strips] Transmittance and its tangent, depth and its tangent, and for each of a few
    /// channels the sum and its tangent; a vector each.
    AlignedArray<T> state;
    // For many channels: rows of sums and of their tangents, a pixel each; the group's features and
    // their tangents; a strip's visits.
    AlignedArray<T> sums, sum_tangents, feature, feature_tangent;
    alignas(64) T weight[std::size_t(LaneGroup<V>::usual)][V::size];
    alignas(64) T weight_tangent[std::size_t(LaneGroup<V>::usual)][V::size];
    std::uint8_t of[std::size_t(LaneGroup<V>::usual)];
};

/// Inputs of a walk for tangents.
template <class T>
struct TangentScene {
    const Scene<T>& scene;
    const SplatTangent<T>* splats;         ///< [visible Gaussians]
    const Columns<T>* feature;             ///< C x N, or null
    T cx, cy;                              ///< tangents of the principal point
};

/// Computes the tangents of the terms of an entry that all strips share.
template <class V>
void share_tangent(const Splat<typename V::value_type>& s,
                   const SplatTangent<typename V::value_type>& d,
                   const TangentScene<typename V::value_type>& moving, const Strips<V>& tile,
                   LaneEntryTangent<V>& to) {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    constexpr int lanes = Tile::lanes;
    const V dx_tangent(-(d.x + moving.cx)), dy_tangent(-(d.y + moving.cy));
    to.floor = d.floor;
    to.depth = d.depth;
    unrolled<Tile::columns / lanes>([&](auto i) {
        const V dx = V::load_aligned(tile.x + i * lanes) - V(s.x);
        const V u = V(s.ux) * dx, u_tangent = V(d.ux) * dx + V(s.ux) * dx_tangent;
        (V(d.vx) * dx + V(s.vx) * dx_tangent).store_aligned(to.v + i * lanes);
        (V(d.log2_opacity) - V(T(2)) * u * u_tangent).store_aligned(to.exponent + i * lanes);
    });
    unrolled<tile_edge / lanes>([&](auto i) {
        const V dy = V::load_aligned(tile.y + i * lanes) - V(s.y);
        (V(d.vy) * dy + V(s.vy) * dy_tangent).store_aligned(to.down + i * lanes);
    });
}

} // namespace detail

/// sums(pixel, channels) += sum_j weight[j][pixel] feature(of[j], channels) for a strip's pixels.
template <class V>
void blend_many(const detail::StripVisits<V>& visits, const typename V::value_type* feature,
                Index stride, typename V::value_type* sums) {
    constexpr int lanes = static_cast<int>(V::size);
    Index c = 0;
    const auto blocks = [&]<int P>(std::integral_constant<int, P>) {
        for (; c + P * lanes <= stride; c += P * lanes)
            detail::blend_channels<P>(visits, feature + c, stride, sums + c);
    };
    blocks(std::integral_constant<int, 4>());
    blocks(std::integral_constant<int, 2>());
    blocks(std::integral_constant<int, 1>());
}

namespace detail {

/// Draws a tile and its tangent. C few channels, or any number for C = 0.
template <class V, int C, class A>
void blend_tile_jvp_lanes(const TangentScene<typename V::value_type>& moving, const A& accuracy,
                          Index tile, RasterJvp<typename V::value_type, A::outputs>& out,
                          LaneTangentCanvas<V>& canvas) {
    using T = typename V::value_type;
    const Scene<T>& scene = moving.scene;
    using Tile = Strips<V>;
    constexpr int lanes = Tile::lanes, most = LaneGroup<V>::usual, own = 4;
    constexpr Index stride = (own + 2 * C) * lanes;
    const Index channels = C > 0 ? C : scene.channels(), row_of = padded_channels<V>(channels);
    if (scene.begin(tile) == scene.end(tile)) {
        draw_background(scene, tile, tile + 1, out.value);
        for (int y = scene.top(tile); y < scene.bottom(tile); ++y) {
            const Index p = scene.pixel(scene.left(tile), y),
                        n = scene.right(tile) - scene.left(tile);
            std::fill_n(out.feature.data() + p * channels, n * channels, T(0));
            std::fill_n(out.alpha.data() + p, n, T(0));
            if constexpr (A::outputs.depth) std::fill_n(out.depth.data() + p, n, T(0));
        }
        return;
    }
    const Tile strips(scene, tile);
    const LaneBlend<A, V> blend(accuracy);
    T* const state = canvas.state.reserve(Tile::count * stride);
    std::fill_n(state, Tile::count * stride, T(0));
    strips.start(all_strips, state, stride);
    T *sums = nullptr, *sum_tangents = nullptr;
    if constexpr (C == 0) {
        const Index numbers = tile_pixels * row_of;
        sums = canvas.sums.reserve(numbers);
        sum_tangents = canvas.sum_tangents.reserve(numbers);
        std::fill_n(sums, numbers, T(0));
        std::fill_n(sum_tangents, numbers, T(0));
        canvas.feature.reserve(most * row_of);
        canvas.feature_tangent.reserve(most * row_of);
    }
    const StripMask inside = strips.inside(all_strips);
    StripMask open = inside;
    const Index begin = scene.begin(tile), end = scene.end(tile);
    Index k = begin;
    const FetchRecords<T> records(scene, tile, end);
    const auto fetch = [&](Index entry) __attribute__((always_inline)) {
        records(entry);
        fetch_features(scene, std::min(entry + records.ahead, end - 1));
    };
    while (k < end && !open.none()) {
        const Index next = std::min<Index>(end, k + most);
        canvas.group.template fill<C>(scene, strips, scene.top(tile), k, next, fetch);
        for (Index n = k; n < next; ++n) {
            LaneEntryTangent<V>& to = canvas.tangent[n - k];
            share_tangent<V>(scene.splat(n), moving.splats[scene.member_of(n)], moving, strips, to);
            const Index source = scene.member(n).source;
            const T* const from =
                moving.feature != nullptr ? moving.feature->data() + source * channels : nullptr;
            if constexpr (C > 0) {
                for (int i = 0; i < C; ++i) to.colour[i] = from != nullptr ? from[i] : T(0);
            } else {
                T* const row = canvas.feature_tangent.data() + (n - k) * row_of;
                std::fill_n(row, row_of, T(0));
                if (from != nullptr) std::copy_n(from, channels, row);
            }
        }
        if constexpr (C == 0) copy_features<V>(scene, k, next, row_of, canvas.feature.data());
        for (int strip = 0; strip < Tile::count; ++strip) {
            if (canvas.group.reaching[strip] == 0 || !open.has(strip)) continue;
            T* const at = state + strip * stride;
            const int side = Tile::side(strip), row = Tile::row(strip);
            std::array<V, std::size_t(own + 2 * C)> sum;
            unrolled<own + 2 * C>([&](auto i) { sum[i] = V::load_aligned(at + i * lanes); });
            [[maybe_unused]] int visits = 0;
            for (std::uint64_t todo = canvas.group.reaching[strip]; todo != 0; todo &= todo - 1) {
                const int n = std::countr_zero(todo);
                const LaneEntry<V>& entry = canvas.group.entry[n];
                const LaneEntryTangent<V>& d = canvas.tangent[n];
                const auto across = [&](const auto& e) __attribute__((always_inline)) {
                    return Tile::along_rows(e.v, side) + Tile::down_rows(e.down, row);
                };
                const V v = across(entry);
                const V x = less_square(Tile::along_rows(entry.exponent, side), v);
                const V x_tangent = Tile::along_rows(d.exponent, side) - (v + v) * across(d);
                const auto c =
                    blend.take(blend.coverage(x, V(entry.cut), V(entry.floor)), sum[0]);
                const V weight = blend.take_jvp(c, x_tangent, V(d.floor), sum[1]);
                if constexpr (A::outputs.depth) {
                    sum[2] = sum[2] + c.weight * V(entry.depth);
                    sum[3] = sum[3] + (weight * V(entry.depth) + c.weight * V(d.depth));
                }
                unrolled<C>([&](auto i) __attribute__((always_inline)) {
                    const V f(entry.colour[i]);
                    V& value = sum[own + 2 * i];
                    V& tangent = sum[own + 2 * i + 1];
                    value = value + c.weight * f;
                    tangent = tangent + (weight * f + c.weight * V(d.colour[i]));
                });
                if constexpr (C == 0) {
                    c.weight.store_aligned(canvas.weight[visits]);
                    weight.store_aligned(canvas.weight_tangent[visits]);
                    canvas.of[visits] = static_cast<std::uint8_t>(n);
                    visits += any(c.weight > V(T(0))) ? 1 : 0;
                }
            }
            unrolled<own + 2 * C>([&](auto i) { sum[i].store_aligned(at + i * lanes); });
            if constexpr (C == 0) {
                const T* const f = canvas.feature.data();
                T* const to = sum_tangents + strip * lanes * row_of;
                const StripVisits<V> weights{canvas.weight, canvas.of, visits};
                blend_many(weights, f, row_of, sums + strip * lanes * row_of);
                blend_many(StripVisits<V>{canvas.weight_tangent, canvas.of, visits}, f, row_of, to);
                if (moving.feature != nullptr)
                    blend_many(weights, canvas.feature_tangent.data(), row_of, to);
            }
            if (!blend.any_open(sum[0])) open.clear(strip);
        }
        k = next;
    }
    out.value.trace.used[static_cast<std::size_t>(tile)] = k - begin;
    for (int y = 0; y < strips.height; ++y)
        for (int x = 0; x < strips.width; ++x) {
            const int strip = Tile::strip(x, y), lane = Tile::lane(x, y);
            const T* const at = state + strip * stride + lane;
            const Index p = scene.pixel(scene.left(tile) + x, scene.top(tile) + y);
            const T rest = std::abs(at[0]), rest_tangent = at[lanes];
            out.value.alpha.pixels.data()[p] = T(1) - rest;
            out.alpha.data()[p] = -rest_tangent;
            if constexpr (A::outputs.depth) {
                out.value.depth.pixels.data()[p] = at[2 * lanes];
                out.depth.data()[p] = at[3 * lanes];
            }
            T* const to = out.value.feature.pixels.data() + p * channels;
            T* const tangent = out.feature.data() + p * channels;
            [[maybe_unused]] const Index many = (strip * lanes + lane) * row_of;
            const T* const behind = scene.background.data();
            Index i = 0;
            if constexpr (C == 0)
                for (; i + lanes <= channels; i += lanes) {
                    const V b = V::load_unaligned(behind + i);
                    (V::load_aligned(sums + many + i) + V(rest) * b).store_unaligned(to + i);
                    (V::load_aligned(sum_tangents + many + i) + V(rest_tangent) * b)
                        .store_unaligned(tangent + i);
                }
            for (; i < channels; ++i) {
                const T value = C > 0 ? at[(own + 2 * i) * lanes] : sums[many + i];
                const T slope = C > 0 ? at[(own + 2 * i + 1) * lanes] : sum_tangents[many + i];
                to[i] = value + rest * behind[i];
                tangent[i] = slope + rest_tangent * behind[i];
            }
        }
}

} // namespace detail

} // namespace rye
