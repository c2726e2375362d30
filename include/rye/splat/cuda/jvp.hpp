// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/jvp.hpp: forward mode on a device: the derivatives of a frame's images in a few
/// directions at once. Screen numbers get their tangents by the projection on duals; then a warp
/// walks a strip, from far to near, by the groups of visits that the blend kept. What is behind a
/// group is known with its tangents as if nothing were in front of it: a group of transmittance P
/// and colour L before colour S of transmittance Q makes L + P S and P Q. Nothing is divided.
#pragma once

#include <rye/splat/cuda/lens.hpp>
#include <rye/splat/cuda/lists.hpp>
#include <rye/splat/cuda/products.hpp>
#include <rye/splat/cuda/strip_output.hpp>
#include <rye/splat/tangents.hpp>

namespace rye {

/// A direction in the inputs of a device's render, and the images of its derivative. Arrays without
/// data, and a camera that is null, do not move.
template <Distortion D = NoDistortion>
struct DeviceDirection {
    DeviceGaussians<const float> gaussians = {}; ///< tangents, in the shapes of the Gaussians
    const Pinhole<float, D>* camera = nullptr;   ///< as RasterTangents has it, on the host
    DeviceImages images;                         ///< without a contributor; depth may be null
};

/// Computes the tangents of the screen numbers of visible Gaussians: SplatRecords, [N].
template <class A, class D>
struct ProjectTangentsKernel {
    using Number = Dual<float, 1>;
    static constexpr const char* name = "project tangents";
    static constexpr int threads = 128, blocks = 3;
    struct Shared {};
    DeviceGaussians<const float> g, tangent;
    DeviceLens<D, Number> lens;
    A accuracy;
    FrameMemory memory;
    SplatRecord* out;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        const auto base = static_cast<std::uint32_t>(block.index()) * threads;
        block.each_thread([&](int t) {
            const std::uint32_t i = base + static_cast<std::uint32_t>(t);
            if (i < memory.count && memory.spans[i].rows > 0) project_one(i);
        });
    }

  private:
    RYE_DEVICE static Number number(const DeviceColumns<const float>& x,
                                    const DeviceColumns<const float>& dx, Index at) {
        return dual_of<float>(x.data[at], dx.data != nullptr ? dx.data[at] : 0.0F);
    }
    RYE_DEVICE void project_one(std::uint32_t i) const {
        typename DeviceLens<D, Number>::Held held;
        lens.put(held);
        const auto mean = [&](int k) { return number(g.mean, tangent.mean, 3 * Index(i) + k); };
        const auto turn = [&](int k) {
            return number(g.rotation, tangent.rotation, 4 * Index(i) + k);
        };
        const auto scale = [&](int k) { return number(g.scale, tangent.scale, 3 * Index(i) + k); };
        const Shape<Number> shape{Vec3<Number>(mean(0), mean(1), mean(2)),
                                  Quat<Number>(turn(0), turn(1), turn(2), turn(3)),
                                  Vec3<Number>(scale(0), scale(1), scale(2))};
        const Projected<Number, A::antialias> s = project<A::antialias>(shape, held.projector);
        const Number opacity = kept_opacity(s, number(g.opacity, tangent.opacity, i));
        const Splat<Number> splat = make_splat(s, opacity, accuracy);
        out[i] = {{splat.x.d[0], splat.y.d[0], splat.ux.d[0], splat.vx.d[0]},
                  {splat.vy.d[0], splat.log2_opacity.d[0], splat.depth.d[0], splat.floor.d[0]}};
    }
};

/// What a walk reads and writes of a direction.
struct WalkedDirection {
    const SplatRecord* splats;          ///< [N] tangents
    DeviceColumns<const float> feature; ///< C x N tangents, or no data
    float cx, cy;                       ///< tangents of the principal point [px]
    DeviceImages images;
};

/// Writes the derivatives of a strip's pixels in K directions, C channels at a time.
template <class A, int C, int K>
struct TangentKernel {
    using Layout = ChannelLayout<C>;
    static constexpr const char* name = "walk of tangents";
    static constexpr int N = planes_of<A>;
    static constexpr int threads = 32, blocks = 8;
    struct Shared {};
    FrameMemory memory;
    DeviceScene scene;
    A accuracy;
    WalkedDirection direction[K];

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
    /// What is behind, seen alone: its transmittance and sums, and their tangents.
    template <class W>
    struct Behind {
        StripSums<W, A, C> value, tangent[K];
    };
    /// Tangents of a lane's visits in a direction, in their column, as Visits has the values.
    template <class W>
    struct Moves {
        using F = typename W::F;
        F rest[4], v[4], vy[4];
        F depth[A::outputs.depth ? 4 : 1], floor[A::has_floor ? 4 : 1];

        RYE_DEVICE F exponent(const Visits<W, A>& visits, int i, int row) const {
            const F y(static_cast<float>(row) - 3.5F);
            const F v_of_row = W::fma(visits.vy[i], y, visits.v[i]);
            return W::fma(F(-2.0F) * v_of_row, W::fma(vy[i], y, v[i]), rest[i]);
        }
        RYE_DEVICE F floor_of(int i) const {
            if constexpr (A::has_floor)
                return floor[i];
            else
                return F(0.0F);
        }
    };
    /// Weights of a lane's visits in a row as if nothing were in front of the group, the group's
    /// transmittance, and the tangents of both.
    template <class W>
    struct Row {
        using F = typename W::F;
        F weight[4], product;
        F weight_tangent[K][4], product_tangent[K];
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

    /// Returns the tangents of visits in direction k. place[i]: x and y of visit i [px], ux, vx.
    template <class W>
    RYE_DEVICE Moves<W> moves(int k, const typename W::U (&owner)[4],
                              const Array<typename W::F, 4> (&place)[4], const Visits<W, A>& visits,
                              const StripPixels<W>& pixels, const TileCentre& centre) const {
        using F = typename W::F;
        using U = typename W::U;
        const auto* const splats = reinterpret_cast<const Quad4*>(direction[k].splats);
        Moves<W> r;
        repeated<4>([&](auto i) {
            const auto has = owner[i] < U(none_of);
            const Array<F, 4> dplace = W::read4_where(has, splats, owner[i] * U(2));
            const Array<F, 4> dshape = W::read4_where(has, splats, owner[i] * U(2) + U(1));
            const F x = F(centre.x) + pixels.x - place[i][0], y = F(centre.y + pixels.y) - place[i][1];
            const F dx = -(dplace[0] + F(direction[k].cx)), dy = -(dplace[1] + F(direction[k].cy));
            const F du = W::fma(dplace[2], x, place[i][2] * dx);
            const F across = W::fma(dplace[3], x, place[i][3] * dx);
            r.v[i] = W::fma(dshape[0], y, W::fma(visits.vy[i], dy, across));
            r.vy[i] = dshape[0];
            r.rest[i] = W::fma(F(-2.0F) * visits.u[i], du, dshape[1]);
            if constexpr (A::outputs.depth) r.depth[i] = dshape[2];
            if constexpr (A::has_floor) r.floor[i] = dshape[3];
        });
        return r;
    }

    /// Returns row j of a group, t being the transmittance in front of it.
    template <class W>
    RYE_DEVICE static Row<W> row(const WarpBlend<W, A>& rules, const Visits<W, A>& visits,
                                 const Moves<W> (&move)[K], int j, const typename W::F& t) {
        using F = typename W::F;
        const F one(1.0F), zero(0.0F);
        const Taken<W> taken = rules.take(visits, j, t);
        Row<W> r;
        F own = one;
        repeated<4>([&](auto i) { own = own * (one - taken.visit[i].alpha); });
        // In front of each lane: the product of the lanes before it.
        const F near = W::template quad_up<1>(own, 1.0F);
        const F next = W::template quad_up<1>(near, 1.0F), third = W::template quad_up<2>(near, 1.0F);
        const F nearer = near * next, front = nearer * third;
        r.product = W::template of_quad<3>(front * own);
        F behind = front;
        F passed[4]; // transmittance in front of each visit
        repeated<4>([&](auto i) {
            passed[i] = behind;
            r.weight[i] = taken.visit[i].alpha * behind;
            behind = behind - r.weight[i];
        });
        repeated<K>([&](auto k) {
            F alpha[4], own_so_far = one, d_own = zero;
            repeated<4>([&](auto i) {
                alpha[i] = rules.one_visit.alpha_jvp(taken.visit[i], move[k].exponent(visits, i, j),
                                                     move[k].floor_of(i));
                const F left = one - taken.visit[i].alpha;
                d_own = W::fma(d_own, left, -(own_so_far * alpha[i]));
                own_so_far = own_so_far * left;
            });
            const F d_near = W::template quad_up<1>(d_own, 0.0F);
            const F d_next = W::template quad_up<1>(d_near, 0.0F);
            const F d_third = W::template quad_up<2>(d_near, 0.0F);
            const F d_nearer = W::fma(d_near, next, near * d_next);
            F d_behind = W::fma(d_nearer, third, nearer * d_third);
            r.product_tangent[k] =
                W::template of_quad<3>(W::fma(d_behind, own, front * d_own));
            repeated<4>([&](auto i) {
                r.weight_tangent[k][i] =
                    W::fma(alpha[i], passed[i], taken.visit[i].alpha * d_behind);
                d_behind = d_behind - r.weight_tangent[k][i];
            });
        });
        return r;
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
        Moves<W> move[K];
        repeated<K>(
            [&](auto k) { move[k] = moves<W>(k, owner, place, visits, pixels, centre); });
        const auto one_row = [&](auto j) {
            const Row<W> r = row<W>(rules, visits, move, j, in_front[j / 4][j % 4]);
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
        F colour[4][C], d_colour[K][4][C];
        const U stride(static_cast<std::uint32_t>(scene.feature.rows));
        repeated<4>([&](auto i) {
            repeated<C>([&](auto c) {
                const auto has = owner[i] < U(none_of) && U(c) < U(static_cast<std::uint32_t>(scene.channels));
                const U at = owner[i] * stride + U(static_cast<std::uint32_t>(scene.first_channel + c));
                colour[i][c] = W::read_where(has, scene.feature.data, at, 0.0F);
                repeated<K>([&](auto k) {
                    const float* const from = direction[k].feature.data;
                    d_colour[k][i][c] =
                        from != nullptr ? W::read_where(has, from, at, 0.0F) : F(0.0F);
                });
            });
        });
        repeated<8>([&](auto j) {
            const Row<W> r = one_row(j);
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
            const Row<W> a = one_row(Constant<2 * m>{}), b = one_row(Constant<2 * m + 1>{});
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

} // namespace rye
