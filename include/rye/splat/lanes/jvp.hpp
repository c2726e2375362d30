// SPDX-License-Identifier: Apache-2.0
/// rye/splat/lanes/jvp.hpp: a render in lanes together with its derivative in a direction. The
/// visible Gaussians' screen numbers get their tangents by the projection on duals of batches; a
/// strip then takes each entry once for the value and once for the tangent.
#pragma once

#include <rye/splat/lanes/forward.hpp>
#include <rye/splat/lanes/stage.hpp>
#include <rye/splat/tangents.hpp>

namespace rye {

/// Tangents of a Splat's numbers, but the cut-off.
template <class T>
struct SplatTangent {
    T x, y, ux, vx, vy, log2_opacity, floor, depth;
};

/// Tangents of the screen numbers of visible Gaussians [b, e).
template <class V, class A>
void project_tangents(const Gaussians<typename V::value_type>& g,
                      const Gaussians<typename V::value_type>* tangent,
                      const Pinhole<Dual<V, 1>>& camera, const A& accuracy,
                      const RasterTrace<typename V::value_type>& trace, Index b, Index e,
                      SplatTangent<typename V::value_type>* to) {
    using T = typename V::value_type;
    using Number = Dual<V, 1>;
    constexpr int lanes = static_cast<int>(V::size);
    const Projector<Number> projector(camera, accuracy.frustum_margin, screen_dilation(accuracy));
    for (Index start = b; start < e; start += lanes) {
        const auto index = [&](int lane) {
            const Index m = std::min(start + lane, e - 1);
            return static_cast<Index>(trace.members[static_cast<std::size_t>(m)].source);
        };
        const LaneShapes<V> in(g, index);
        LaneBlock<V, 11> still;
        for (auto& row : still.row) std::fill_n(row, lanes, T(0));
        const LaneBlock<V, 11> moved =
            tangent != nullptr ? LaneShapes<V>(*tangent, index).in : still;
        const auto number = [&](int k) { return dual_of<V>(in.in[k], moved[k]); };
        const Shape<Number> shape{
            Vec3<Number>(number(0), number(1), number(2)),
            Quat<Number>(number(3), number(4), number(5), number(6)),
            Vec3<Number>(number(7), number(8), number(9))};
        const Projected<Number, A::antialias> s = project<A::antialias>(shape, projector);
        const Splat<Number> splat = make_splat(s, kept_opacity(s, number(10)), accuracy);
        LaneBlock<V, 8> out;
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

/// The tangent of an entry as the strips see it, beside LaneEntry.
template <class V>
struct alignas(64) LaneEntryTangent {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    T v[Tile::sides][Tile::lanes];         ///< tangent of v = this + down
    T exponent[Tile::sides][Tile::lanes];  ///< of the exponent = this - 2 v (tangent of v)
    T down[tile_edge];
    T floor, depth;
};

/// Memory of one thread's tiles.
template <class V>
struct LaneTangentCanvas : Workspaces::Space {
    using T = typename V::value_type;
    LaneGroup<V> group;
    LaneEntryTangent<V> tangent[std::size_t(LaneGroup<V>::usual)];
    /// Of each strip: transmittance and its tangent, depth and its, and of each channel the sum and
    /// its tangent; a vector each.
    Lines<T> state;
};

/// What a walk for tangents reads besides the scene.
template <class T>
struct TangentScene {
    const SplatTangent<T>* splats;         ///< of each visible Gaussian
    const Columns<T>* feature;             ///< C x N, or null
    T cx, cy;                              ///< tangents of the principal point
};

/// Tangents of what strips share of an entry.
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
    unrolled<Tile::sides>([&](auto i) {
        const V dx = V::load_aligned(tile.x + i * lanes) - V(s.x);
        const V u = V(s.ux) * dx, u_tangent = V(d.ux) * dx + V(s.ux) * dx_tangent;
        (V(d.vx) * dx + V(s.vx) * dx_tangent).store_aligned(to.v[i]);
        (V(d.log2_opacity) - V(T(2)) * u * u_tangent).store_aligned(to.exponent[i]);
    });
    unrolled<tile_edge / lanes>([&](auto i) {
        const V dy = V::load_aligned(tile.y + i * lanes) - V(s.y);
        (V(d.vy) * dy + V(s.vy) * dy_tangent).store_aligned(to.down + i * lanes);
    });
}

/// Draws a tile and its tangent. C few channels, or any number for C = 0.
template <class V, int C, class A>
void blend_tile_jvp_lanes(const Scene<typename V::value_type>& scene,
                          const TangentScene<typename V::value_type>& moving, const A& accuracy,
                          Index tile, RasterJvp<typename V::value_type, A::outputs>& out,
                          LaneTangentCanvas<V>& canvas) {
    using T = typename V::value_type;
    using Tile = Strips<V>;
    constexpr int lanes = Tile::lanes, most = LaneGroup<V>::usual, sums = 4;
    const Index channels = C > 0 ? C : scene.feature.rows();
    const Index vectors = sums + 2 * channels, stride = vectors * lanes;
    const Tile strips(scene, tile);
    const LaneBlend<A, V> blend(accuracy);
    T* const state = canvas.state.reserve(Tile::count * stride);
    std::fill_n(state, Tile::count * stride, T(0));
    strips.start(all_strips, state, stride);
    const StripMask inside = strips.inside(all_strips);
    StripMask open = inside;
    const Index begin = scene.begin(tile), end = scene.end(tile);
    Index k = begin;
    fetch_ahead(scene, begin, std::min<Index>(end, begin + 2 * most));
    while (k < end && !open.none()) {
        const Index next = std::min<Index>(end, k + most);
        fetch_ahead(scene, next, std::min<Index>(end, next + most));
        canvas.group.template fill<0>(scene, strips, scene.top(tile), k, next);
        for (Index n = k; n < next; ++n)
            share_tangent<V>(scene.splat(n), moving.splats[scene.member_of(n)], moving, strips,
                             canvas.tangent[n - k]);
        for (int strip = 0; strip < Tile::count; ++strip) {
            if (canvas.group.reaching[strip] == 0 || !open.has(strip)) continue;
            T* const at = state + strip * stride;
            const int side = Tile::side(strip), row = Tile::row(strip);
            const auto vector = [&](Index i) { return V::load_aligned(at + i * lanes); };
            V transmittance = vector(0), behind = vector(1), depth = vector(2), deep = vector(3);
            std::array<V, std::size_t(2 * C + 1)> sum;
            unrolled<2 * C>([&](auto i) { sum[i] = vector(sums + i); });
            for (std::uint64_t todo = canvas.group.reaching[strip]; todo != 0; todo &= todo - 1) {
                const int n = std::countr_zero(todo);
                const LaneEntry<V>& entry = canvas.group.entry[n];
                const LaneEntryTangent<V>& d = canvas.tangent[n];
                const auto across = [&](const auto& e) __attribute__((always_inline)) {
                    return V::load_aligned(e.v[side]) + repeat<Tile::high, V>(e.down + row);
                };
                const V v = across(entry), v_tangent = across(d);
                const V x = less_square(V::load_aligned(entry.exponent[side]), v);
                const V x_tangent =
                    V::load_aligned(d.exponent[side]) - V(T(2)) * v * v_tangent;
                const auto c =
                    blend.take(blend.coverage(x, V(entry.cut), V(entry.floor)), transmittance);
                const V weight = blend.take_jvp(c, x_tangent, V(d.floor), behind);
                if constexpr (A::outputs.depth) {
                    depth = depth + c.weight * V(entry.depth);
                    deep = deep + weight * V(entry.depth) + c.weight * V(d.depth);
                }
                const Index source = scene.member(k + n).source;
                const T* const colour = scene.feature.data() + source * channels;
                const T* const moved =
                    moving.feature != nullptr ? moving.feature->data() + source * channels
                                              : nullptr;
                if constexpr (C > 0) {
                    unrolled<C>([&](auto i) __attribute__((always_inline)) {
                        const V f(colour[i]);
                        sum[2 * i] = sum[2 * i] + c.weight * f;
                        sum[2 * i + 1] = sum[2 * i + 1] + weight * f;
                        if (moved != nullptr)
                            sum[2 * i + 1] = sum[2 * i + 1] + c.weight * V(moved[i]);
                    });
                } else {
                    for (Index i = 0; i < channels; ++i) {
                        T* const s = at + (sums + 2 * i) * lanes;
                        const V f(colour[i]), df(moved != nullptr ? moved[i] : T(0));
                        (V::load_aligned(s) + c.weight * f).store_aligned(s);
                        (V::load_aligned(s + lanes) + (weight * f + c.weight * df))
                            .store_aligned(s + lanes);
                    }
                }
            }
            transmittance.store_aligned(at);
            behind.store_aligned(at + lanes);
            depth.store_aligned(at + 2 * lanes);
            deep.store_aligned(at + 3 * lanes);
            unrolled<2 * C>([&](auto i) { sum[i].store_aligned(at + (sums + i) * lanes); });
            if (!blend.any_open(transmittance)) open.clear(strip);
        }
        k = next;
    }
    out.value.trace.used[static_cast<std::size_t>(tile)] = k - begin;
    for (int y = 0; y < strips.height; ++y)
        for (int x = 0; x < strips.width; ++x) {
            const T* const at = state + Tile::strip(x, y) * stride + Tile::lane(x, y);
            const auto number = [&](Index i) { return at[i * lanes]; };
            const Index p = scene.pixel(scene.left(tile) + x, scene.top(tile) + y);
            const T rest = std::abs(number(0));
            out.value.alpha.pixels(0, p) = T(1) - rest;
            out.alpha(0, p) = -number(1);
            if constexpr (A::outputs.depth) {
                out.value.depth.pixels(0, p) = number(2);
                out.depth(0, p) = number(3);
            }
            for (Index i = 0; i < channels; ++i) {
                const T behind = scene.background[i];
                out.value.feature.pixels(i, p) = number(sums + 2 * i) + rest * behind;
                out.feature(i, p) = number(sums + 2 * i + 1) + number(1) * behind;
            }
        }
}

} // namespace rye
