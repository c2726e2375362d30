// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/reverse_step.hpp: the step back over a group of visits: what a row of a strip's
/// pixels adds to the cotangents of its visits, and their sums over the strip.
#pragma once

#include <rye/splat/cuda/walk.hpp>

namespace rye::detail {

/// A warp's state of its pixels on the way back.
template <class W, int C, bool extra>
struct StripCotangents {
    using F = typename W::F;
    F behind[8]; ///< <cotangent, what is behind>
    F colour[8][ChannelLayout<C>::products ? 1 : C];
    F alpha[extra ? 8 : 1], depth[extra ? 8 : 1];
};

/// The formulas by the rules A. extra: cotangents of alpha or depth are given.
template <class A, int C, bool extra>
struct ReverseStep {
    using Layout = ChannelLayout<C>;
    /// Count of a visit's numbers that are summed over lanes.
    static constexpr int sums = Layout::products ? 8 : Layout::stride;

    /// Returns <cotangent, colour>: one function for Gaussians and background, so that equal
    /// colours give equal sums.
    template <class W, class F>
    RYE_DEVICE static F along(const F (&cotangent)[std::size_t(C)], const Array<F, 4>& colour) {
        F s = cotangent[0] * colour[0];
        repeated<C - 1>([&](auto c) { s = W::fma(cotangent[c + 1], colour[c + 1], s); });
        return s;
    }
    /// Sums over the pixels of each of a lane's visits.
    template <class W>
    struct Moments {
        using F = typename W::F;
        F one[4], y[4], yy[4]; ///< sums of h, h y, h y^2; y in rows
        F alpha[A::has_floor ? 4 : 1], depth[extra ? 4 : 1];
        F colour[Layout::products ? 1 : 4][Layout::products ? 1 : C];

        RYE_DEVICE Moments() {
            expanded<4>([&](auto i) {
                one[i] = y[i] = yy[i] = F(0.0F);
                if constexpr (A::has_floor) alpha[i] = F(0.0F);
                if constexpr (extra) depth[i] = F(0.0F);
                if constexpr (!Layout::products)
                    repeated<C>([&](auto c) { colour[i][c] = F(0.0F); });
            });
        }
    };

    /// Steps back over one row of pixels: from <cotangent, colour> of its visits to their sums.
    template <class W, class Rules, class J>
    RYE_DEVICE static Taken<W> one_row(StripCotangents<W, C, extra>& s, Moments<W>& sum,
                                       const Visits<W, A>& v, const Rules& rules, J j,
                                       const typename W::F& before,
                                       const Array<typename W::F, 4>& along_visit) {
        using F = typename W::F;
        const auto& one = rules.one_visit;
        F more[4];
        const Taken<W> t = rules.take(v, j, before);
        expanded<4>([&](auto i) {
            const ColourCotangent<F> colour{along_visit[i]};
            const struct {
                F depth;
            } gaussian{v.depth[i]};
            if constexpr (extra)
                more[i] = one.excess(gaussian,
                                       PixelCotangent<F>{colour, s.alpha[j], s.depth[j]},
                                       s.behind[j]);
            else
                more[i] = one.excess(gaussian, colour, s.behind[j]);
        });
        // b, from its value behind the group: over the own visits from 0, then over the lanes.
        F own(0.0F);
        expanded<4>([&](auto k) {
            constexpr int i = 3 - k;
            own = one.in_front(own, t.visit[i].alpha, more[i] - own);
        });
        const F third = W::template quad_down<3>(own, 0.0F);
        const F second = W::fma(W::template quad_down<2>(t.product, 1.0F), third,
                                W::template quad_down<2>(own, 0.0F));
        F b = W::fma(W::template quad_down<1>(t.product, 1.0F), second,
                     W::template quad_down<1>(own, 0.0F));
        expanded<4>([&](auto k) {
            constexpr int i = 3 - k;
            const auto g = one.step_back(t.visit[i], more[i] - b, v.floor_of(i), b);
            if constexpr (A::has_floor) sum.alpha[i] = sum.alpha[i] + g.opacity;
            constexpr float y = static_cast<float>(J()) - 3.5F;
            sum.one[i] = sum.one[i] + g.exponent;
            sum.y[i] = W::fma(g.exponent, F(y), sum.y[i]);
            sum.yy[i] = W::fma(g.exponent, F(y * y), sum.yy[i]);
            [[maybe_unused]] const F& weight = t.visit[i].weight;
            if constexpr (extra) sum.depth[i] = W::fma(weight, s.depth[j], sum.depth[i]);
            if constexpr (!Layout::products)
                repeated<C>([&](auto c) {
                    sum.colour[i][c] = W::fma(weight, s.colour[j][c], sum.colour[i][c]);
                });
        });
        s.behind[j] = s.behind[j] + W::template of_quad<0>(b);
        return t;
    }

    /// Converts sums over rows to offsets (u, v), and adds the eight columns: by halves, each lane
    /// going on with one of them.
    template <class W>
    RYE_DEVICE static void add_lanes(const Visits<W, A>& v, const Moments<W>& sum, float* partial) {
        using F = typename W::F;
        using U = typename W::U;
        constexpr int count = 4 * sums;
        static_assert(count % 8 == 0);
        F x[std::size_t(count)];
        repeated<count>([&](auto k) { x[k] = F(0.0F); });
        expanded<4>([&](auto i) {
            F* const to = x + i * sums;
            const F gv = W::fma(v.v[i], sum.one[i], v.vy[i] * sum.y[i]);
            const F gu = v.u[i] * sum.one[i];
            to[0] = gu;
            to[1] = gv;
            to[2] = gu * v.u[i];
            to[3] = gv * v.u[i];
            to[4] = W::fma(v.v[i], gv, v.vy[i] * W::fma(v.v[i], sum.y[i], v.vy[i] * sum.yy[i]));
            if constexpr (A::has_floor)
                to[5] = sum.alpha[i];
            else
                to[5] = sum.one[i];
            if constexpr (extra)
                to[6] = sum.depth[i];
            else
                to[6] = F(0.0F);
            if constexpr (!Layout::products)
                repeated<C>([&](auto c) { to[7 + c] = sum.colour[i][c]; });
        });
        halve<W, 16, count>(x);
        halve<W, 8, count / 2>(x);
        halve<W, 4, count / 4>(x);
        repeated<count / 8>([&](auto k) {
            const U flat = W::lane() / U(4) * U(count / 8) + U(k);
            const U at =
                (W::lane() % U(4) * U(4) + flat / U(sums)) * U(Layout::stride) + flat % U(sums);
            W::write(partial, at, x[k]);
        });
    }
    template <class W, int apart, int n, class F>
    RYE_DEVICE static void halve(F* x) {
        using U = typename W::U;
        const auto upper = (W::lane() & U(apart)) > U(0);
        repeated<n / 2>([&](auto k) {
            const F keep = select(upper, x[k + n / 2], x[k]);
            const F give = select(upper, x[k], x[k + n / 2]);
            x[k] = keep + W::template across<apart>(give);
        });
    }
};

} // namespace rye::detail
