// SPDX-License-Identifier: Apache-2.0
// Rules of an accuracy policy that are not numbers: the bits of depth keys, and the treatment of
// numbers that are not finite. The order of blending is in ray_peak_test.cpp.
#include <rye/splat/accuracy.hpp>

#include <limits>

#include <rye/splat/oracle.hpp>
#include <rye/splat/lanes.hpp>

#include <doctest/doctest.h>

#include "../support/scenes.hpp"

using namespace rye;
using namespace rye::test;

namespace {

struct FineKeys : Exact32 {
    static constexpr int depth_bits = 64;
};

// Each hides one name of Balanced, or gives it another type.
struct NoAlphaMin : Balanced { void alpha_min(); };
struct NoFrustumMargin : Balanced { void frustum_margin(); };
struct NoAlphaFloor : Balanced { void alpha_floor(); };
struct NoNonFinite : Balanced { void non_finite(); };
struct NoMaxMemory : Balanced { void max_memory(); };
struct NoStopRule : Balanced { void stop_rule(); };
struct NoHasFloor : Balanced { void has_floor(); };
struct NoDepthBits : Balanced { void depth_bits(); };
struct NonFiniteOfAnotherType : Balanced { bool non_finite = true; };
struct NotCopied : Balanced {
    NotCopied() = default;
    NotCopied(const NotCopied&) = delete;
    NotCopied& operator=(const NotCopied&) = delete;
};
static_assert(!AccuracyPolicy<NoAlphaMin> && !AccuracyPolicy<NoFrustumMargin> &&
              !AccuracyPolicy<NoAlphaFloor> && !AccuracyPolicy<NoNonFinite> &&
              !AccuracyPolicy<NoMaxMemory> && !AccuracyPolicy<NoStopRule> &&
              !AccuracyPolicy<NoHasFloor> && !AccuracyPolicy<NoDepthBits>);
static_assert(!AccuracyPolicy<NonFiniteOfAnotherType> &&
              !AccuracyPolicy<NotCopied>);
static_assert(AccuracyPolicy<FineKeys> && AccuracyPolicy<Exact64> && AccuracyPolicy<Fast> &&
              AccuracyPolicy<FeaturesOnly<Balanced>>);

using Plain = ScalarBackend<>;
using Lanes = XsimdBackend<>;

/// Red behind blue by 1e-8 of a depth of 3, which float does not resolve; red has the lower index.
Scenery<float> near_tie() {
    auto s = random_scene<float>(2, 3, 1);
    s.gaussians.mean.col(0) << 0, 0, 2e-8F;
    s.gaussians.mean.col(1) << 0, 0, 1e-8F;
    for (Index i = 0; i < 2; ++i) {
        s.gaussians.scale.col(i).setConstant(0.2F);
        s.gaussians.opacity(0, i) = 0.8F;
        s.gaussians.feature.col(i) << (i == 0 ? 1.0F : 0.0F), 0.0F, (i == 0 ? 0.0F : 1.0F);
    }
    return s;
}

template <class B, class A>
double gap(const Scenery<float>& s) {
    const auto r = Rasterizer<A>{}.forward(B{}, s.gaussians, s.camera, s.background);
    Gaussians<double> g;
    convert_fields(g, s.gaussians, [](float x) { return static_cast<double>(x); });
    const auto camera = s.camera.cast<double>();
    const auto truth =
        oracle(g, camera, s.background.cast<double>(), depth_order(g, camera)); // in double
    return (r.feature.pixels.template cast<double>() - truth.feature.pixels).cwiseAbs().maxCoeff();
}

template <class B>
Raster<float> draw(const Scenery<float>& s, NonFinite rule) {
    Balanced a;
    a.non_finite = rule;
    return Rasterizer<>{a}.forward(B{}, s.gaussians, s.camera, s.background);
}

} // namespace

TEST_CASE_TEMPLATE("depth keys of 64 bits: float Gaussians in the order of double depths", B,
                   Plain, Lanes) {
    CHECK(gap<B, FineKeys>(near_tie()) < 5e-5);
    CHECK(gap<B, Exact32>(near_tie()) > 0.3); // a tie, which goes by index: the wrong one in front
    // A thin sheet: hundreds of pairs whose float depths tie.
    auto s = random_scene<float>(300, 3, 5);
    s.gaussians.mean.row(2) *= 1e-7F;
    CHECK(gap<B, FineKeys>(s) < 5e-5);
    CHECK(gap<B, Exact32>(s) > 1e-2);
}

TEST_CASE_TEMPLATE("depth keys of 64 bits: nothing else changes", B, Plain, Lanes) {
    const auto s = random_scene<float>(80, 3, 6);
    const auto a = Rasterizer<FineKeys>{}.forward(B{}, s.gaussians, s.camera, s.background);
    const auto b = Rasterizer<Exact32>{}.forward(B{}, s.gaussians, s.camera, s.background);
    CHECK(a.trace.lists.entry == b.trace.lists.entry);
    CHECK(a.feature.pixels == b.feature.pixels);
}

TEST_CASE_TEMPLATE("trust: the same bits where all is finite", B, Plain, Lanes) {
    for (const auto& s : hard_scenes<float>(3)) {
        CAPTURE(s.name);
        const auto a = draw<B>(s, NonFinite::trust), b = draw<B>(s, NonFinite::cull);
        CHECK(a.feature.pixels == b.feature.pixels);
        CHECK(a.trace.member == b.trace.member);
    }
}

TEST_CASE_TEMPLATE("trust: nothing is looked at, and a bad number still reaches no memory", B,
                   Plain, Lanes) {
    const auto clean = random_scene<float>(41, 3, 13);
    const float nan = std::numeric_limits<float>::quiet_NaN(),
                inf = std::numeric_limits<float>::infinity();
    Gaussians<float>::fields(
        [&](const std::string& name, const Columns<float>& a) {
            CAPTURE(name);
            for (Index row = 0; row < a.rows(); ++row)
                for (const float x : {nan, inf, -inf}) {
                    auto s = clean;
                    Gaussians<float>::fields(
                        [&](const std::string& n, Columns<float>& c) {
                            if (n == name) c(row, 17) = x;
                        },
                        s.gaussians);
                    const auto r = draw<B>(s, NonFinite::trust);
                    CHECK(r.trace.non_finite == 0);
                    // A non-finite colour is blended; a non-finite shape has no extent.
                    if (name == "feature") CHECK(!r.feature.pixels.allFinite());
                    if (name == "mean") CHECK(r.feature.pixels.allFinite());
                    const Columns<float> w = noise<float>(3, r.feature.pixels.cols(), 9);
                    Balanced rules;
                    rules.non_finite = NonFinite::trust;
                    const auto g =
                        Rasterizer<>{rules}.vjp(B{}, s.gaussians, s.camera, s.background, r, w);
                    CHECK(g.count() == 41);
                }
        },
        clean.gaussians);
}
