// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/jvp_step.hpp: a row of a strip's pixels and a group of visits in forward mode:
/// the weights of the visits as if nothing were in front of the group, and their tangents.
#pragma once

#include <rye/splat/cuda/tangents.hpp>
#include <rye/splat/cuda/walk.hpp>

namespace rye::detail {

/// Tangents of a lane's visits in a direction, in their column, as Visits has the values.
template <class W, class A>
struct VisitTangents {
    using F = typename W::F;
    F rest[4], v[4], vy[4]; ///< as those of Visits
    F depth[A::outputs.depth ? 4 : 1], floor[A::has_floor ? 4 : 1];

    VisitTangents() = default;
    /// owner: the Gaussians of the visits, or none_of; place: their x and y [px], ux, vx.
    RYE_DEVICE VisitTangents(const WalkedDirection& direction, const typename W::U (&owner)[4],
                             const Array<F, 4> (&place)[4], const Visits<W, A>& visits,
                             const StripPixels<W>& pixels, const TileCentre& centre) {
        using U = typename W::U;
        const auto* const splats = reinterpret_cast<const Quad4*>(direction.splats);
        repeated<4>([&](auto i) {
            const auto has = owner[i] < U(none_of);
            const Array<F, 4> dplace = W::read4_where(has, splats, owner[i] * U(2));
            const Array<F, 4> dshape = W::read4_where(has, splats, owner[i] * U(2) + U(1));
            const F x = F(centre.x) + pixels.x - place[i][0];
            const F y = F(centre.y + pixels.y) - place[i][1];
            const F dx = -(dplace[0] + F(direction.cx)), dy = -(dplace[1] + F(direction.cy));
            const F du = W::fma(dplace[2], x, place[i][2] * dx);
            const F across = W::fma(dplace[3], x, place[i][3] * dx);
            v[i] = W::fma(dshape[0], y, W::fma(visits.vy[i], dy, across));
            vy[i] = dshape[0];
            rest[i] = W::fma(F(-2.0F) * visits.u[i], du, dshape[1]);
            if constexpr (A::outputs.depth) depth[i] = dshape[2];
            if constexpr (A::has_floor) floor[i] = dshape[3];
        });
    }
    /// Returns the tangent of the exponent of visit i in row `row`.
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
template <class W, int K>
struct TangentRow {
    using F = typename W::F;
    F weight[4], product;
    F weight_tangent[std::size_t(K)][4], product_tangent[std::size_t(K)];
};

/// Returns row j of a group, t being the transmittance in front of it.
template <class W, class A, int K>
RYE_DEVICE TangentRow<W, K> tangent_row(const WarpBlend<W, A>& rules, const Visits<W, A>& visits,
                                        const VisitTangents<W, A> (&move)[std::size_t(K)], int j,
                                        const typename W::F& t) {
    using F = typename W::F;
    const F one(1.0F), zero(0.0F);
    const Taken<W> taken = rules.take(visits, j, t);
    TangentRow<W, K> r;
    F own = one;
    repeated<4>([&](auto i) { own = own * (one - taken.visit[i].alpha); });
    // In front of each lane: the product of the lanes before it.
    const F near = W::template quad_up<1>(own, 1.0F);
    const F next = W::template quad_up<1>(near, 1.0F);
    const F third = W::template quad_up<2>(near, 1.0F);
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
        r.product_tangent[k] = W::template of_quad<3>(W::fma(d_behind, own, front * d_own));
        repeated<4>([&](auto i) {
            r.weight_tangent[k][i] =
                W::fma(alpha[i], passed[i], taken.visit[i].alpha * d_behind);
            d_behind = d_behind - r.weight_tangent[k][i];
        });
    });
    return r;
}

} // namespace rye::detail
