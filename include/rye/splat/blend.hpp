// SPDX-License-Identifier: Apache-2.0
/// rye/splat/blend.hpp: one Gaussian at one pixel, forward and reverse, for every walk: plain loops
/// over any scalar and duals, lanes over batches, a device's threads over float.
///     alpha = min(alpha_max, 2^(log2 o - u^2 - v^2) - o f)         skipped below the cut
///     T_i+1 = T_i (1 - alpha_i),  weight_i = alpha_i T_i           until the pixel is full
/// Reverse, with s_i = <cotangent, contribution i> and b_i the same for all that lies behind i,
/// composited from the background forward,
///     d/d alpha_i = T_i (s_i - b_i),   b_{i-1} = b_i + alpha_i (s_i - b_i),
/// which neither divides by 1 - alpha nor subtracts large sums: it is 0 where a Gaussian has the
/// colour of what is behind it.
/// Walks do iteration, addressing and sums over pixels and channels, and none of these formulas.
/// A walk that takes several Gaussians of a pixel at once (cuda/walk.hpp) has T and b in front of
/// and behind each by scans over these steps.
#pragma once

#include <algorithm>
#include <cmath>
#include <type_traits>

#include <rye/math/scalar.hpp>
#include <rye/splat/falloff.hpp>

namespace rye {

/// Offsets in the folded frame, and the exponent there.
template <class T>
struct Response {
    T u, v;
    T exponent;
};

namespace detail {

/// Returns one of the two squares of the exponent log2 o - u^2 - v^2. Apart, since the pixels of a
/// column share the one in u.
template <class V>
[[gnu::always_inline]] RYE_HD inline V less_square(const V& exponent, const V& w) {
    return exponent - w * w;
}

} // namespace detail

/// Returns the response of a Gaussian at an offset (dx, dy) from its centre [px].
template <class T>
RYE_HD Response<T> respond(const Splat<T>& s, const T& dx, const T& dy) {
    const T u = s.ux * dx;
    const T v = s.vx * dx + s.vy * dy;
    return {u, v, detail::less_square(detail::less_square(s.log2_opacity, u), v)};
}

/// A pixel that is walked by itself: the walk branches past a Gaussian that does not reach it, and
/// ends when it is full. So conditions that hold for every visit need no mask. Members name the
/// products that the two kinds of pixels round differently.
struct SinglePixel {
    static constexpr bool ends_when_full = true;
    static constexpr bool keeps_bell = true;     ///< for the way back; else alpha alone
    static constexpr bool mixed_from_u = true;   ///< g u v is (g u) v; else (g v) u
    /// Without a floor, d / d exponent is alpha T (s - b), from the weight; else (T (s - b)) alpha.
    static constexpr bool slope_from_weight = false;

    /// Returns a condition, or true where a branch of the walk has settled it.
    template <class M>
    RYE_HD static std::true_type settled(const M&) {
        return {};
    }
    /// Returns x where the condition holds, else 0.
    template <class V>
    RYE_HD static V when(std::true_type, const V& x) {
        return x;
    }
    template <class V>
    RYE_HD static V when(bool condition, const V& x) {
        return select(condition, x, V(0));
    }
    /// Returns alpha, 0 for a pixel that is full.
    template <class V>
    RYE_HD static V while_open(const V&, const V&, const V& alpha) {
        return alpha;
    }
    /// Returns min(most, x), of derivative 0 from `most` on; a NaN becomes `most`.
    template <class V>
    RYE_HD static V at_most(const V& most, const V& x) {
        return select(x < most, x, most);
    }
    /// Returns true where x, which `at_most` returned, moves with what it was given.
    template <class V>
    RYE_HD static auto moves(const V& most, const V& x) {
        return x < most;
    }
    /// Returns the transmittance behind a contribution.
    template <class V>
    RYE_HD static V behind(const V& before, const V& alpha, const V&) {
        return before * (V(1) - alpha);
    }
    /// Returns the transmittance of a pixel that is full before it falls below `stop`.
    template <class V>
    RYE_HD static V full(const V& transmittance) {
        return transmittance;
    }
    /// Returns c + a b.
    template <class V>
    [[gnu::always_inline]] RYE_HD static V add_product(const V& c, const V& a, const V& b) {
        return c + a * b;
    }
};

namespace detail {

/// Pixels that are walked together, in lanes or threads, without a branch of their own: a pixel
/// that is full, or that a Gaussian does not reach, takes nothing. A full pixel keeps the
/// transmittance with which it got full: below `stop`, or, where a pixel stops before the blend
/// that would take it there, with its sign turned.
struct PixelGroup {
    static constexpr bool ends_when_full = false;
    static constexpr bool keeps_bell = false;
    static constexpr bool mixed_from_u = false;
    static constexpr bool slope_from_weight = false;

    template <class M>
    RYE_HD static const M& settled(const M& condition) {
        return condition;
    }
    template <class M, class V>
    RYE_HD static V when(const M& condition, const V& x) {
        return select(condition, x, V(real_t<V>(0)));
    }
    template <class V>
    [[gnu::always_inline]] RYE_HD static V while_open(const V& transmittance, const V& stop,
                                                      const V& alpha) {
        return select(transmittance >= stop, alpha, V(real_t<V>(0)));
    }
    template <class V>
    [[gnu::always_inline]] RYE_HD static V at_most(const V& most, const V& x) {
        return min(most, x);
    }
    template <class V>
    [[gnu::always_inline]] RYE_HD static auto moves(const V& most, const V& x) {
        return x < most;
    }
    template <class V>
    [[gnu::always_inline]] RYE_HD static V behind(const V& before, const V&, const V& weight) {
        return before - weight;
    }
    template <class V>
    RYE_HD static V full(const V& transmittance) {
        using std::abs;
        return -abs(transmittance);
    }
    template <class V>
    [[gnu::always_inline]] RYE_HD static V add_product(const V& c, const V& a, const V& b) {
        return c + a * b;
    }
};

/// A Gaussian's share of a pixel with nothing in front of it.
template <class V>
struct Coverage {
    V alpha;
    V bell;                  ///< alpha without its floor; where pixels keep it, 0 if clamped
};

/// A Gaussian's contribution to a pixel.
template <class V>
struct Contribution : Coverage<V> {
    V before;                ///< transmittance in front of it
    V weight;                ///< alpha times before; 0 where nothing is added
};
/// A contribution that the pixel may reject as it is full: `taken` is false only if
/// Stop::exclusive rejects it.
template <class V, class Mask>
struct TakenContribution : Contribution<V> {
    Mask taken;
};

/// The cotangents of a Gaussian's exponent and of the logarithm of its opacity, from one pixel.
template <class V>
struct ResponseCotangent {
    V exponent, opacity;
};

/// Cotangent of a pixel: s, the sum over channels of cotangent times the Gaussian's colour.
template <class V>
struct ColourCotangent {
    V colour;
};
/// Cotangent of a pixel, with those of alpha and depth.
template <class V>
struct PixelCotangent : ColourCotangent<V> {
    V alpha, depth;
};

} // namespace detail

/// The formulas by the rules A, for numbers V in a walk of Pixels. Exp2: 2^x of exponents from the
/// cut to log2 o; in a group of pixels it also meets others, and may give any number there.
template <class A, class V, class Pixels, class Exp2>
struct Blend {
    using R = real_t<V>;
    V alpha_max, stop;

    RYE_HD explicit Blend(const A& a)
        : alpha_max(static_cast<R>(a.alpha_max)), stop(static_cast<R>(a.stop)) {}

    /// Returns true where a Gaussian reaches a pixel.
    [[gnu::always_inline]] RYE_HD static auto reaches(const V& exponent, const V& cut) {
        return exponent >= cut;
    }
    /// Returns the coverage of a pixel. `floor` is o f, not read unless the rules have one.
    [[gnu::always_inline]] RYE_HD detail::Coverage<V> coverage(const V& exponent, const V& cut,
                                                               const V& floor) const {
        V bell = V(Exp2()(exponent)), alpha = bell;
        if constexpr (A::has_floor) alpha = alpha - floor;
        if constexpr (Pixels::keeps_bell) bell = Pixels::when(alpha < alpha_max, bell);
        const auto reached = Pixels::settled(reaches(exponent, cut));
        return {Pixels::when(reached, V(Pixels::at_most(alpha_max, alpha))), bell};
    }

    /// Returns the contribution to a pixel by the stop rule; `transmittance` becomes what is behind
    /// it.
    [[gnu::always_inline]] RYE_HD auto take(const detail::Coverage<V>& given,
                                            V& transmittance) const {
        const V before = transmittance;
        V alpha = given.alpha;
        if constexpr (A::stop_rule == Stop::inclusive)
            alpha = Pixels::while_open(before, stop, alpha);
        V weight = alpha * before;
        V behind = Pixels::behind(before, alpha, weight);
        if constexpr (A::stop_rule == Stop::exclusive) {
            const auto more = behind >= stop;              // never of a full pixel
            alpha = Pixels::when(more, alpha);
            weight = Pixels::when(more, weight);
            transmittance = select(more, behind, V(Pixels::full(before)));
            return detail::TakenContribution<V, std::remove_const_t<decltype(more)>>{
                {{alpha, given.bell}, before, weight}, more};
        } else {
            transmittance = behind;
            return detail::TakenContribution<V, std::true_type>{
                {{alpha, given.bell}, before, weight}, {}};
        }
    }

    /// Returns true where a pixel can still take a contribution.
    [[gnu::always_inline]] RYE_HD auto open(const V& transmittance) const {
        if constexpr (Pixels::ends_when_full && A::stop_rule != Stop::inclusive) {
            return std::true_type();
        } else if constexpr (Pixels::ends_when_full) {
            return transmittance >= stop;
        } else {
            const V least = V(A::stop_rule == Stop::inclusive ? stop : V(R(0)));
            return transmittance >= least && transmittance > V(R(0));
        }
    }

    /// Returns the derivative of alpha in a direction, for contribution c, which `take` returned:
    /// from the tangents of the exponent and of the floor. What is clamped, or not taken, does not
    /// move.
    [[gnu::always_inline]] RYE_HD V alpha_jvp(const detail::Contribution<V>& c,
                                              const V& exponent_tangent,
                                              [[maybe_unused]] const V& floor_tangent) const {
        V alpha = V(R(0.69314718055994530942)) * c.bell * exponent_tangent;
        if constexpr (A::has_floor) alpha = alpha - floor_tangent;
        alpha = Pixels::when(c.alpha < alpha_max, alpha);
        return Pixels::when(Pixels::settled(c.weight > V(R(0))), alpha);
    }

    /// Returns the derivative of the weight that `take` returned; `transmittance_tangent` becomes
    /// that of what is behind.
    [[gnu::always_inline]] RYE_HD V take_jvp(const detail::Contribution<V>& c,
                                             const V& exponent_tangent, const V& floor_tangent,
                                             V& transmittance_tangent) const {
        const V alpha = alpha_jvp(c, exponent_tangent, floor_tangent);
        const V weight = alpha * c.before + c.alpha * transmittance_tangent;
        transmittance_tangent = transmittance_tangent - weight;
        return weight;
    }

    /// Returns s - b for a Gaussian: what a pixel would gain by more of it in place of what is
    /// behind it. g: a ColourCotangent or PixelCotangent; depth is read of `gaussian`.
    template <class Gaussian, class Cotangent>
    [[gnu::always_inline]] RYE_HD static V excess(const Gaussian& gaussian, const Cotangent& g,
                                                  const V& behind) {
        V more = g.colour - behind;
        if constexpr (requires { g.depth; })
            more = more + Pixels::add_product(g.alpha, g.depth, gaussian.depth);
        return more;
    }
    /// Returns b in front of a Gaussian.
    [[gnu::always_inline]] RYE_HD static V in_front(const V& behind, const V& alpha,
                                                    const V& excess) {
        return Pixels::add_product(behind, alpha, excess);
    }

    /// Steps back over contribution c, whose excess is `more`; b becomes that in front of it.
    [[gnu::always_inline]] RYE_HD detail::ResponseCotangent<V> step_back(
        const detail::Contribution<V>& c, V more, const V& floor, V& b) const {
        if constexpr (A::has_floor || !Pixels::slope_from_weight)
            more = Pixels::when(Pixels::settled(c.weight > V(R(0))), more);
        b = in_front(b, c.alpha, more);
        if constexpr (Pixels::slope_from_weight && !A::has_floor) {
            const V slope = Pixels::when(Pixels::moves(alpha_max, c.alpha), V(c.weight * more));
            return {slope, slope};
        }
        // With the bell o e: d alpha / d exponent = o e, o d alpha / d o = o e - o f = alpha.
        V g_alpha = c.before * more;
        if constexpr (Pixels::keeps_bell) {
            const V exponent = g_alpha * c.bell;
            return {exponent, exponent - Pixels::when(c.bell > V(R(0)), V(g_alpha * floor))};
        } else {
            g_alpha = Pixels::when(Pixels::moves(alpha_max, c.alpha), g_alpha);
            const V opacity = g_alpha * c.alpha;
            if constexpr (A::has_floor)
                return {Pixels::add_product(opacity, g_alpha, floor), opacity};
            else
                return {opacity, opacity};
        }
    }

    /// Steps back over contribution c at offsets (u, v), for g, a ColourCotangent or
    /// PixelCotangent. `behind`, b, becomes the b in front of c. Cotangents of
    /// `gaussian`, of which floor and depth are read, are added to `sum`: the numbers of
    /// SplatCotangent in their order.
    template <class Gaussian, class Cotangent, class Sums>
    [[gnu::always_inline]] RYE_HD void take_vjp(const detail::Contribution<V>& c, const V& u,
                                                const V& v, const Gaussian& gaussian,
                                                const Cotangent& g, V& behind, Sums&& sum) const {
        const V weight = c.weight;                         // sums may be stored beside c
        const auto [g_exponent, g_opacity] =
            step_back(c, excess(gaussian, g, behind), gaussian.floor, behind);
        const V gu = g_exponent * u, gv = g_exponent * v;
        sum[0] = sum[0] + gu;
        sum[1] = sum[1] + gv;
        sum[2] = sum[2] + gu * u;
        if constexpr (Pixels::mixed_from_u)
            sum[3] = sum[3] + gu * v;
        else
            sum[3] = sum[3] + gv * u;
        sum[4] = sum[4] + gv * v;
        sum[5] = sum[5] + g_opacity;
        if constexpr (requires { g.depth; }) sum[6] = sum[6] + weight * g.depth;
    }
};

} // namespace rye
