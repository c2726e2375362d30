// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/jvp.hpp: forward mode on a device: the derivatives of a frame's images in a few
/// directions at once. A warp walks a strip, from far to near, by the groups of visits that the
/// blend kept. What is behind a group is known with its tangents as if nothing were in front of it:
/// a group of transmittance P and colour L before colour S of transmittance Q makes L + P S and
/// P Q. Nothing is divided.
#pragma once

#include <rye/splat/cuda/jvp_step.hpp>
#include <rye/splat/cuda/products.hpp>
#include <rye/splat/cuda/strip_output.hpp>

namespace rye::detail {

/// Writes the derivatives of a strip's pixels in K directions, C channels at a time.
template <class A, int C, int K>
struct TangentKernel {
    using Layout = ChannelLayout<C>;
    static constexpr const char* name = "walk of tangents";
    static constexpr int N = planes_of<A>;
    static constexpr int threads = 32, blocks = Layout::products || K > 1 ? 8 : 12;
    struct Shared {};
    FrameMemory memory;
    DeviceScene scene;
    A accuracy;
    WalkedDirection direction[std::size_t(K)];

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        using W = typename Block::Warp;
        if (memory.report->overflow != 0) return;
        const auto strip = static_cast<std::uint32_t>(block.index());
        const std::uint32_t tile = memory.order[strip / tile_strips];
        const int w = static_cast<int>(strip % tile_strips);
        block.each_warp([&](int) {
            const StripPixels<W> pixels(tile, memory.columns, w, scene.width, scene.height);
            const TileCentre centre(scene, tile, memory.columns);
            const WarpBlend<W, A> rules(accuracy);
            Behind<W> s;
            start(s);
            // A group's visits are read while the one behind it is walked.
            Group<W> now =
                group<W>(memory.last[tile * tile_strips + static_cast<std::uint32_t>(w)]);
            while (now.index != none_of) {
                const Group<W> nearer = group<W>(memory.before[now.index]);
                take<W>(s, now, pixels, centre, rules);
                now = nearer;
            }
            repeated<K>([&](auto k) {
                StripOutput<A, C>{memory, scene, direction[k].images}.template write_sums<W>(
                    s.tangent[k], pixels, 0.0F);
            });
        });
    }

  private:
    /// A group, and the Gaussians of the lane's visits.
    template <class W>
    struct Group {
        std::uint32_t index;
        typename W::U owner[4];
    };
    template <class W>
    RYE_DEVICE Group<W> group(std::uint32_t index) const {
        using U = typename W::U;
        Group<W> r;
        r.index = index;
        const std::uint32_t* const visits = memory.visits + std::size_t(index) * 32;
        repeated<4>([&](auto i) {
            r.owner[i] = index == none_of
                             ? U(none_of)
                             : W::read(visits, W::lane() % U(4) * U(4) + U(i));
        });
        return r;
    }
    /// The part behind, seen alone: its transmittance and sums, and their tangents.
    template <class W>
    struct Behind {
        StripSums<W, A, C> value, tangent[std::size_t(K)];
    };
    template <class W>
    RYE_DEVICE static void start(Behind<W>& s) {
        const auto fill = [](StripSums<W, A, C>& to, float transmittance) {
            using F = typename W::F;
            repeated<8>([&](auto j) {
                to.transmittance[j] = F(transmittance);
                if constexpr (!Layout::products)
                    repeated<C>([&](auto c) { to.colour[j][c] = F(0.0F); });
                if constexpr (A::outputs.depth) to.depth[j] = F(0.0F);
            });
            if constexpr (Layout::products)
                repeated<4>([&](auto m) {
                    repeated<C / 8>(
                        [&](auto n) { repeated<4>([&](auto i) { to.sums[m][n][i] = F(0.0F); }); });
                });
        };
        fill(s.value, 1.0F);
        repeated<K>([&](auto k) { fill(s.tangent[k], 0.0F); });
    }

    /// Puts a group before what is behind it.
    template <class W>
    RYE_DEVICE void take(Behind<W>& s, const Group<W>& group, const StripPixels<W>& pixels,
                         const TileCentre& centre, const WarpBlend<W, A>& rules) const {
        using F = typename W::F;
        using U = typename W::U;
        const auto* const records = reinterpret_cast<const Quad4*>(memory.record);
        const auto* const kept =
            reinterpret_cast<const Quad4*>(memory.transmittance) + std::size_t(group.index) * 16;
        const U column = W::lane() / U(4) * U(2);
        const Array<F, 4> in_front[2] = {W::read4(kept, column), W::read4(kept, column + U(1))};
        const U(&owner)[4] = group.owner;
        Array<F, 4> place[4], shape[4];
        repeated<4>([&](auto i) {
            const auto has = owner[i] < U(none_of);
            place[i] = W::read4_where(has, records, owner[i] * U(2));
            shape[i] = W::read4_where(has, records, owner[i] * U(2) + U(1));
            shape[i][1] = select(has, shape[i][1], F(-1e30F));
        });
        const Visits<W, A> visits(
            [&](auto i) { return TileSplat<W>(place[i], shape[i], centre.x, centre.y); }, pixels.x,
            pixels.y, accuracy);
        VisitTangents<W, A> move[std::size_t(K)];
        repeated<K>([&](auto k) {
            move[k] = VisitTangents<W, A>(direction[k], owner, place, visits, pixels, centre);
        });
        const auto one_row = [&](auto j) {
            const auto r = tangent_row<W, A, K>(rules, visits, move, j, in_front[j / 4][j % 4]);
            F& q = s.value.transmittance[j];
            repeated<K>([&](auto k) {
                F& dq = s.tangent[k].transmittance[j];
                dq = W::fma(r.product, dq, r.product_tangent[k] * q);
                if constexpr (A::outputs.depth) {
                    F& d = s.tangent[k].depth[j];
                    d = W::fma(r.product, d, r.product_tangent[k] * s.value.depth[j]);
                    repeated<4>([&](auto i) {
                        d = W::fma(r.weight_tangent[k][i], visits.depth[i], d);
                        d = W::fma(r.weight[i], move[k].depth[i], d);
                    });
                }
            });
            q = r.product * q;
            if constexpr (A::outputs.depth) {
                s.value.depth[j] = r.product * s.value.depth[j];
                repeated<4>([&](auto i) {
                    s.value.depth[j] = W::fma(r.weight[i], visits.depth[i], s.value.depth[j]);
                });
            }
            return r;
        };
        if constexpr (Layout::products)
            by_products<W>(s, owner, one_row);
        else
            by_channels<W>(s, owner, one_row);
    }

    /// Adds a group's colours, few of them: each lane those of its own visits.
    template <class W, class OneRow>
    RYE_DEVICE void by_channels(Behind<W>& s, const typename W::U (&owner)[4],
                                const OneRow& one_row) const {
        using F = typename W::F;
        using U = typename W::U;
        F colour[4][std::size_t(C)], d_colour[std::size_t(K)][4][std::size_t(C)];
        const U stride(static_cast<std::uint32_t>(scene.feature.rows));
        const U begin(static_cast<std::uint32_t>(scene.first_channel));
        repeated<4>([&](auto i) {
            repeated<C>([&](auto c) {
                const auto has = owner[i] < U(c < scene.channels ? none_of : 0);
                const U at = owner[i] * stride + begin + U(c);
                colour[i][c] = W::read_where(has, scene.feature.data, at, 0.0F);
                repeated<K>([&](auto k) {
                    const float* const from = direction[k].feature.data;
                    d_colour[k][i][c] =
                        from != nullptr ? W::read_where(has, from, at, 0.0F) : F(0.0F);
                });
            });
        });
        repeated<8>([&](auto j) {
            const TangentRow<W, K> r = one_row(j);
            repeated<C>([&](auto c) {
                F& value = s.value.colour[j][c];
                repeated<K>([&](auto k) {
                    F& d = s.tangent[k].colour[j][c];
                    d = W::fma(r.product, d, r.product_tangent[k] * value);
                    repeated<4>([&](auto i) {
                        d = W::fma(r.weight_tangent[k][i], colour[i][c], d);
                        d = W::fma(r.weight[i], d_colour[k][i][c], d);
                    });
                });
                value = r.product * value;
                repeated<4>([&](auto i) { value = W::fma(r.weight[i], colour[i][c], value); });
            });
        });
    }

    /// Adds a group's colours as products of matrices, as BlendKernel does.
    template <class W, class OneRow>
    RYE_DEVICE void by_products(Behind<W>& s, const typename W::U (&owner)[4],
                                const OneRow& one_row) const {
        using F = typename W::F;
        const auto planes = [](const F(&a)[4], const F(&b)[4]) {
            Planes<W, N, 4> r;
            split<W, N>(r, 0, a[0], a[1]);
            split<W, N>(r, 1, b[0], b[1]);
            split<W, N>(r, 2, a[2], a[3]);
            split<W, N>(r, 3, b[2], b[3]);
            return r;
        };
        expanded<4>([&](auto m) {
            const TangentRow<W, K> a = one_row(Constant<2 * m>{});
            const TangentRow<W, K> b = one_row(Constant<2 * m + 1>{});
            const Planes<W, N, 4> weights = planes(a.weight, b.weight);
            repeated<C / 8>([&](auto n) {
                const auto features = features_over_visits<W, N>(scene, owner, n);
                Array<F, 4>& value = s.value.sums[m][n];
                repeated<K>([&](auto k) {
                    Array<F, 4>& d = s.tangent[k].sums[m][n];
                    repeated<2>([&](auto i) { // the lane's channels, of either row
                        d[i] = W::fma(a.product, d[i], a.product_tangent[k] * value[i]);
                        d[2 + i] = W::fma(b.product, d[2 + i], b.product_tangent[k] * value[2 + i]);
                    });
                    multiply<W, N>(d, planes(a.weight_tangent[k], b.weight_tangent[k]), features);
                    if (direction[k].feature.data != nullptr) {
                        DeviceScene moved = scene;
                        moved.feature = direction[k].feature;
                        multiply<W, N>(d, weights, features_over_visits<W, N>(moved, owner, n));
                    }
                });
                repeated<2>([&](auto i) {
                    value[i] = a.product * value[i];
                    value[2 + i] = b.product * value[2 + i];
                });
                multiply<W, N>(value, weights, features);
            });
        });
    }
};

} // namespace rye::detail
