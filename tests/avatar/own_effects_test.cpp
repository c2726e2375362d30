// SPDX-License-Identifier: Apache-2.0
#include <rye/avatar/own_effects.hpp>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>

#include "../support/effect_sets.hpp"

using namespace rye;
using namespace rye::test;

namespace {

// [docs/effects.md begins]
/// Adds red in proportion to the first expression coefficient, with a learned weight per Gaussian.
struct Blush {
    static constexpr std::string_view name = "blush";
    static constexpr Reads reads = Reads::expression;
    static constexpr Touches touches = Touches::colour;
    static constexpr std::string_view neutral = "red 0";
    static constexpr EffectBound droppable{1e-3, "the first expression coefficient"};

    template <class T>
    struct Parameters {
        Columns<T> red;  ///< 1 x N

        template <class F, class... P>
        static void fields(F&& f, P&&... p) {
            f("red", p.red...);
        }
    };
    template <class B, class T, class D>
    static void add(const B&, const Parameters<T>& p, const D& drivers, GaussianSpan<T>& g) {
        g.feature.row(0) += drivers.expression[0] * p.red;
    }
    template <class B, class T, class D>
    static void vjp(const B&, const Parameters<T>&, const D& drivers, const Gaussians<T>&,
                    GaussianSpan<T>& g_gaussians, Parameters<T>& grad) {
        grad.red += drivers.expression[0] * g_gaussians.feature.row(0);
    }
};
static_assert(OwnEffect<Blush>);
// [docs/effects.md ends]

/// Depends on the Gaussians it is given: the face swells by a share of its own scales.
struct Swell {
    static constexpr std::string_view name = "swell";
    static constexpr Reads reads = Reads::nothing;
    static constexpr Touches touches = Touches::scale;
    static constexpr std::string_view neutral = "share 0";
    static constexpr EffectBound droppable{1e-4, "the share"};

    template <class T>
    struct Parameters {
        Columns<T> share;  ///< 1 x 1

        template <class F, class... P>
        static void fields(F&& f, P&&... p) {
            f("share", p.share...);
        }
    };
    template <class B, class T, class D>
    static void add(const B&, const Parameters<T>& p, const D&, GaussianSpan<T>& g) {
        g.scale += p.share(0, 0) * g.scale.cwiseProduct(g.scale).eval();
    }
    template <class B, class T, class D>
    static void vjp(const B&, const Parameters<T>& p, const D&, const Gaussians<T>& before,
                    GaussianSpan<T>& g_gaussians, Parameters<T>& grad) {
        grad.share(0, 0) +=
            g_gaussians.scale.cwiseProduct(before.scale.cwiseProduct(before.scale)).sum();
        g_gaussians.scale +=
            T(2) * p.share(0, 0) * g_gaussians.scale.cwiseProduct(before.scale).eval();
    }
};
static_assert(OwnEffect<Swell> && !OwnEffect<Expression>);

using B = ScalarBackend<>;
using Mine = More<PaperEffects, Swell, Blush>;

} // namespace

TEST_CASE("a user's effects: parameters, tensors, value, vjp, and nothing at neutral") {
    Draw draw{{3, 1}};
    TwoStream<double, Mine> avatar = restricted<Mine>(avatar_of_all());
    avatar.red = draw.columns(1, avatar.face.position.cols());
    avatar.share = draw.columns(1, 1, 0.5);
    std::string names;
    TwoStream<double, Mine>::fields([&](const std::string& n, const auto&) { names += n + " "; },
                                    avatar);
    CHECK(names.starts_with("swell.share blush.red face.xyz"));
    const Drivers<double, Mine> drivers = restricted<Mine>(drivers_of_all());

    TwoStreamTrace<double, Mine> trace;
    drive(B{}, avatar, {tiny_config(), tiny_roles(), drivers}, trace);
    Gaussians<double> w = random_like(trace.gaussians, Random{4, 0});
    Gaussians<double>::fields([&](const std::string&, auto& a) { // the eyes have no own effects
        a.rightCols(trace.eye_columns().count).setZero();
    }, w);
    Gaussians<double> g = w;
    TwoStream<double, Mine> grad = zeros_like(avatar);
    drive_vjp(B{}, avatar, {tiny_config(), tiny_roles(), drivers}, trace, {g, grad});
    const TwoStream<double, Mine> direction = random_like(avatar, Random{5, 0});
    const auto moved = [&](double h) {
        TwoStream<double, Mine> a = avatar;
        TwoStream<double, Mine>::fields(
            [&](const std::string&, auto& x, const auto& d) { x += h * d; }, a, direction);
        TwoStreamTrace<double, Mine> t;
        drive(B{}, a, {tiny_config(), tiny_roles(), drivers}, t);
        DotSum sum;
        sum.add_all(t.gaussians, w);
        return sum.sum;
    };
    DotSum by_vjp;
    by_vjp.add_all(grad, direction);
    const double h = 1e-6;
    CHECK(std::abs(by_vjp.sum - (moved(h) - moved(-h)) / (2 * h)) <= 1e-6 * by_vjp.magnitude);
    DotSum own;
    own.add(grad.red, direction.red);
    own.add(grad.share, direction.share);
    CHECK(std::abs(own.sum) > 1e-3 * by_vjp.magnitude);

    TwoStream<double, Mine> neutral = avatar;
    neutral.red.setZero();
    neutral.share.setZero();
    const auto with = driven(neutral, drivers);
    const auto without =
        driven(restricted<PaperEffects>(avatar_of_all()), restricted<PaperEffects>(drivers));
    CHECK(with.gaussians.feature == without.gaussians.feature);
    CHECK(with.gaussians.scale == without.gaussians.scale);
    CHECK(trace.gaussians.feature != without.gaussians.feature);
}
