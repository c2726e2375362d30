// SPDX-License-Identifier: Apache-2.0
/// rye/splat/accuracy.hpp: the permitted error of each shortcut of splatting, as a policy.
/// Numbers are fields that a caller may change; kinds of rules are static, so that a kernel holds
/// only the rule it uses. The named presets are ordered from exact to fast. With D the range of
/// colour along a ray: a skipped contribution costs at most alpha_min D, the inclusive stop
/// at most stop D, the exclusive one at most stop / (1 - alpha_max) D.
#pragma once

#include <concepts>
#include <cstdint>
#include <type_traits>

#include <rye/core/config.hpp>
#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/core/memory.hpp>
#include <rye/gaussian/antialias.hpp>
#include <rye/splat/outputs.hpp>

namespace rye {

/// End of a pixel's blending: never, after the blend that leaves transmittance < stop, or before
/// it.
enum class Stop { never, inclusive, exclusive };

/// Pixels tested for a Gaussian: exactly those where its alpha can reach alpha_min; or, as in the
/// first implementation, the 16 px tiles that a square of 3 standard deviations touches.
enum class Support { ellipse, square };

/// The order in which a pixel blends: by the depths of centres, one order for all pixels; or by the
/// depths at which the pixel's own ray is closest to each Gaussian, sorted at every pixel. The
/// second is the better model where Gaussians cross; it has plain loops only, on every backend.
enum class BlendOrder { by_centre, by_peak };

/// What a device's render makes of a Gaussian's features: floats; or, of 5 channels and more,
/// halves (binary16), in renders that keep nothing for a derivative. Halves of features and of
/// weights change a pixel by at most 2^-10 of the largest feature and 2^-25 of it a visit; features
/// beyond 65504 are as 65504. Up to 4 channels, and the host, have floats.
enum class Payload { whole, half };

/// Treatment of a Gaussian with a NaN or an infinity. cull: leave it out and count it; fail: throw;
/// trust: skip the check. If there is one despite the trust, no memory is misused, but pixels and
/// gradients may be NaN.
enum class NonFinite { cull, fail, trust };

/// The default policy: shortcuts whose error is below that of 8-bit pictures.
struct Balanced {
    double alpha_min = 1.0 / 2550.0;   ///< contributions below are skipped; > 0
    double alpha_max = 0.999;          ///< alpha is clamped here; no gradient above
    double stop = 1e-5;                ///< transmittance at which a pixel is full
    double dilation = 0.3;             ///< added variance of Antialias::dilate and mip [px^2]
    double frustum_margin = 0.3;       ///< Jacobian is clamped this many half-images outside
    double alpha_floor = 0;            ///< f in alpha = o (exp(-|w|^2/2) - f), if has_floor
    NonFinite non_finite = NonFinite::cull;
    std::uint64_t max_memory = default_memory; ///< limit of the tiles' lists [bytes], else Error

    static constexpr Stop stop_rule = Stop::inclusive;
    static constexpr Support support = Support::ellipse;
    static constexpr Antialias antialias = Antialias::dilate;
    static constexpr BlendOrder order = BlendOrder::by_centre;
    /// Bits of the depths that are compared: 32, or 64, which measures float Gaussians' depths in
    /// double. Double Gaussians' depths always have 64.
    static constexpr int depth_bits = 32;
    static constexpr bool has_floor = false;
    static constexpr Outputs outputs = {};
    static constexpr Payload payload = Payload::whole;
    /// Degree of the polynomial in lanes, 3 to 6; 0 is the library's exp2.
    static constexpr int exp2_degree = 5;
};

/// Errors below 1e-11 (in double), against an image of every Gaussian at every pixel in double.
/// Sets alpha_min = 1e-15, alpha_max = 1, stop = 1e-14, and the library's exp2.
struct Exact64 : Balanced {
    RYE_HD constexpr Exact64() {
        alpha_min = 1e-15;
        alpha_max = 1;
        stop = 1e-14;
    }
    static constexpr int exp2_degree = 0;
};

/// Errors below 5e-5: only float's rounding is left. Sets alpha_min = 1e-9, alpha_max = 1, stop =
/// 1e-8, exp2_degree = 6.
struct Exact32 : Balanced {
    RYE_HD constexpr Exact32() {
        alpha_min = 1e-9;
        alpha_max = 1;
        stop = 1e-8;
    }
    static constexpr int exp2_degree = 6;
};

/// Errors below 1e-3. Sets alpha_min = 1 / 25500, alpha_max = 1, stop = 1e-6.
struct Tight : Balanced {
    RYE_HD constexpr Tight() {
        alpha_min = 1.0 / 25500.0;
        alpha_max = 1;  // costs no time, and the gradient behind opaque surfaces stays right
        stop = 1e-6;
    }
};

/// Errors of several 8-bit steps, at the speed of a preview. Sets alpha_min = 1 / 255, stop = 1e-4,
/// exp2_degree = 4.
struct Fast : Balanced {
    RYE_HD constexpr Fast() {
        alpha_min = 1.0 / 255.0;
        stop = 1e-4;
    }
    static constexpr int exp2_degree = 4;
};

/// The rules of the first 3DGS implementation (Kerbl et al., 2023), which viewers share. Some
/// viewers use has_floor with alpha_floor = exp(-4.5): see Compatible3dgsFloor. Sets alpha_min =
/// 1 / 255, alpha_max = 0.99, stop = 1e-4, exp2_degree = 6.
struct Compatible3dgs : Balanced {
    RYE_HD constexpr Compatible3dgs() {
        alpha_min = 1.0 / 255.0;
        alpha_max = 0.99;
        stop = 1e-4;
    }
    static constexpr Stop stop_rule = Stop::exclusive;
    static constexpr Support support = Support::square;
    static constexpr int exp2_degree = 6;
};

/// The rules of Compatible3dgs, but alpha reaches 0 at three standard deviations.
struct Compatible3dgsFloor : Compatible3dgs {
    RYE_HD constexpr Compatible3dgsFloor() { alpha_floor = 0.011108996538242306; }
    static constexpr bool has_floor = true;
};

/// Policy A with features as halves.
template <class A>
struct WithHalves : A {
    RYE_HD constexpr WithHalves(const A& a = {}) : A(a) {}
    static constexpr Payload payload = Payload::half;
};

/// Has every member of Balanced. A policy of one's own derives from Balanced and states only what
/// differs: numbers in its constructor, rules as constants of the class. Numbers can be set on a
/// value too, as `Rasterizer<Draft> r; r.accuracy.stop = 0`. The compiler names the first member
/// that is missing.
template <class A>
concept AccuracyPolicy = std::copyable<A> && std::default_initializable<A> && requires(const A a) {
    { a.alpha_min } -> std::convertible_to<double>;
} && requires(const A a) {
    { a.alpha_max } -> std::convertible_to<double>;
} && requires(const A a) {
    { a.stop } -> std::convertible_to<double>;
} && requires(const A a) {
    { a.dilation } -> std::convertible_to<double>;
} && requires(const A a) {
    { a.frustum_margin } -> std::convertible_to<double>;
} && requires(const A a) {
    { a.alpha_floor } -> std::convertible_to<double>;
} && requires(const A a) {
    { a.non_finite } -> std::convertible_to<NonFinite>;
} && requires(const A a) {
    { a.max_memory } -> std::convertible_to<std::uint64_t>;
} && requires {
    typename std::integral_constant<Stop, A::stop_rule>;
} && requires {
    typename std::integral_constant<Support, A::support>;
} && requires {
    typename std::integral_constant<Antialias, A::antialias>;
} && requires {
    typename std::integral_constant<BlendOrder, A::order>;
} && requires {
    typename std::integral_constant<int, A::depth_bits>;
} && requires {
    typename std::integral_constant<bool, A::has_floor>;
} && requires {
    typename std::integral_constant<Outputs, A::outputs>;
} && requires {
    typename std::integral_constant<Payload, A::payload>;
} && requires {
    typename std::integral_constant<int, A::exp2_degree>;
} &&(A::exp2_degree == 0 || (A::exp2_degree >= 3 && A::exp2_degree <= 6));

/// Returns the variance that is added along both axes of the screen [px^2].
template <AccuracyPolicy A>
RYE_HD constexpr double screen_dilation(const A& accuracy) {
    return A::antialias == Antialias::none ? 0.0 : accuracy.dilation;
}

namespace detail {

/// Throws an Error unless alpha_min, as a number of type R, is positive, or 0 where alpha_floor is
/// positive: the logarithm of 0 bounds no ellipse, and all Gaussians would be culled.
template <class R, AccuracyPolicy A>
void check_alpha_min(const A& accuracy) {
    const R least = static_cast<R>(accuracy.alpha_min);
    require(least > 0 || (A::has_floor && least == 0 && accuracy.alpha_floor > 0), "rasterizer",
            "got alpha_min = ", accuracy.alpha_min, ", expected a positive number such as 1e-9");
}

} // namespace detail

static_assert(AccuracyPolicy<Balanced> && AccuracyPolicy<Compatible3dgsFloor>);
static_assert(!AccuracyPolicy<BlendOrder>);

} // namespace rye
