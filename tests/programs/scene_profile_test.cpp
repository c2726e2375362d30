// SPDX-License-Identifier: Apache-2.0
#include "drawing/scene_profile.hpp"

#include <doctest/doctest.h>

#include <rye/core/random.hpp>
#include <rye/gaussian/sh_color.hpp>

using namespace rye;
using namespace rye::trainer;
using enum EffectName;

namespace {

struct NamedExpression {
    static constexpr std::string_view name = "expression";
};
struct NamedPose {
    static constexpr std::string_view name = "head pose";
};
static_assert(mask_of<NamedExpression, NamedPose>() == EffectMask{expression, head_pose});
static_assert(mask_of<>() == EffectMask{});

/// Two frames of a head with visible eyes.
SceneFacts still_head() {
    SceneFacts s;
    DriverFacts d;
    for (int f = 0; f < 2; ++f) {
        d.add({0.5, 0.25}, Vec<double, 6>::Zero(), 1);
        for (std::size_t e = 0; e < 2; ++e) d.add_gaze(e, Vec3<double>::UnitZ());
    }
    for (EyeFacts& e : d.eyes) e.views = 3, e.iris = 12;
    s.drivers = d;
    return s;
}

EffectMask called(const SceneFacts& s) { return profile(s, {}).effects; }

} // namespace

TEST_CASE("scene profile: refraction by a wide iris or from aside, glint by a light and an iris") {
    SceneFacts s = still_head();
    s.drivers->lights = 2;
    s.drivers->eyes[1].iris = 11;
    CHECK(called(s) == EffectMask{});
    s.drivers->eyes[1].iris = 13;
    CHECK(called(s) == EffectMask{glint});
    s.drivers->eyes[1].iris = 31;
    CHECK(called(s) == EffectMask{corneal_bulge, glint});
    s.drivers->eyes[1].iris = 61;
    CHECK(called(s) == EffectMask{corneal_bulge, corneal_refraction, glint});
    s.drivers->lights = 0;
    CHECK(called(s) == EffectMask{corneal_bulge, corneal_refraction});
    s = still_head();
    s.drivers->eyes[0].aside = 1.1;
    CHECK(called(s) == EffectMask{corneal_refraction});
    s.avatar = AvatarFacts{};  // which has no irises behind corneas
    CHECK(called(s) == EffectMask{});
    s.avatar->corneas = true;
    CHECK(called(s) == EffectMask{corneal_refraction});
}

TEST_CASE("scene profile: every effect is judged once, with a reason") {
    for (const SceneFacts& s : {SceneFacts{}, still_head()}) {
        const SceneProfile p = profile(s, {});
        REQUIRE(p.findings.size() == effect_count);
        EffectMask seen;
        for (const Finding& f : p.findings) {
            CHECK(!seen.has(f.effect));
            seen.add(f.effect);
            CHECK(p.effects.has(f.effect) == f.called);
        }
    }
    CHECK(called(SceneFacts{}) == EffectMask{});
}

TEST_CASE("scene profile: a still head calls for nothing; each thing that varies for its effect") {
    CHECK(called(still_head()) == EffectMask{});
    {
        SceneFacts s = still_head();
        s.drivers->add({0.5, 0.75}, Vec<double, 6>::Zero(), 1);
        CHECK(called(s) == EffectMask{expression, eye_offset});
        AvatarFacts a;
        a.moved_by_expression = 5;
        s.avatar = a;
        CHECK(called(s) == EffectMask{expression});
        s.avatar->eye_offset = 0.01;
        CHECK(called(s) == EffectMask{expression, eye_offset});
        s.avatar->moved_by_expression = 0;
        CHECK(called(s) == EffectMask{eye_offset});
    }
    {
        SceneFacts s = still_head();
        s.drivers->add({0.5, 0.25}, Vec<double, 6>::Constant(0.1), 1);
        CHECK(called(s) == EffectMask{head_pose, pose_residual, eye_offset});
    }
    {
        SceneFacts s = still_head();
        s.drivers->add_gaze(1, gaze_vector(0.1, 0.2));
        CHECK(called(s) == EffectMask{right_gaze, periocular});
        s.drivers->eyes[1].views = 0;
        CHECK(called(s) == EffectMask{periocular});
        s.drivers->eyes[0].views = 0;
        CHECK(called(s) == EffectMask{});
    }
    {
        SceneFacts s = still_head();
        s.drivers->kappa = 0.08;
        s.drivers->eyes[0].iris = 40;
        CHECK(called(s) == EffectMask{kappa, corneal_bulge});
    }
}

TEST_CASE("scene profile: pictures call for what draws them") {
    SceneFacts s;
    RenderFacts r;
    r.size = r.wanted = {100, 80};
    r.splats = 10;
    r.narrowest = 20;
    s.render = r;
    CHECK(called(s) == EffectMask{});
    s.render->narrowest = 3;     // wide, but the effect of a dilation is visible
    CHECK(called(s) == EffectMask{antialias});
    s.render->below_a_pixel = 1;
    s.render->narrowest = 0.5;
    CHECK(called(s) == EffectMask{antialias});
    s.render->splats = 0;
    CHECK(called(s) == EffectMask{});
    s.render->wanted = {200, 160};
    s.render->distortion = {0, 0, 1e-3};
    s.render->extra = "depth";
    CHECK(called(s) == EffectMask{super_resolution, lens_distortion, extra_outputs});
    s.render->distortion = {0, 0};
    CHECK(!called(s).has(lens_distortion));
    s.avatar = AvatarFacts{};
    s.avatar->channels = 8;
    CHECK(!called(s).has(feature_channels));
    s.avatar->refines = true;
    CHECK(called(s).has(feature_channels));
}

TEST_CASE("scene profile: bands of harmonics that are left out change no colour beyond the bound") {
    const Random random{5, 1};
    std::uint64_t k = 0;
    for (const double size : {1e-5, 5e-4, 2e-3, 0.05}) {
        GaussianCloud<double> cloud(40, 3);
        GaussianCloud<double>::fields([&](const std::string&, Columns<double>& a) {
            for (Index i = 0; i < a.size(); ++i) a(i) = random.normal(k++);
        }, cloud);
        for (Index i = 0; i < cloud.count(); ++i)
            for (Index c = 0; c < 3; ++c)  // the higher the band the less
                for (Index j = 0; j < 15; ++j)
                    cloud.sh_rest(15 * c + j, i) *= size * (j < 3 ? 20 : j < 8 ? 3 : 0.5);
        SceneFacts facts;
        add_sh(cloud, facts);
        const ProfileBounds bounds;
        const SceneProfile p = profile(facts, bounds);
        int degree = 0;
        for (const int l : {1, 2, 3})
            if (p.effects.has(static_cast<EffectName>(static_cast<int>(sh1) + l - 1))) degree = l;
        for (int l = 1; l <= degree; ++l)  // no band without those below it
            CHECK(p.effects.has(static_cast<EffectName>(static_cast<int>(sh1) + l - 1)));
        const GaussianCloud<double> less = truncated(cloud, degree);
        CHECK(less.degree() == degree);
        double worst = 0;
        for (int view = 0; view < 200; ++view) {
            Vec3<double> eye;
            for (Index j = 0; j < 3; ++j) eye[j] = random.normal(k++);
            worst = std::max(worst, (sh_colors(cloud, eye) - sh_colors(less, eye))
                                        .cwiseAbs().maxCoeff());
        }
        INFO(size);
        CHECK(worst <= bounds.color);
        // The bound is tight: with a band less it would be exceeded, or nearly.
        if (degree > 0) CHECK(facts.sh_rest[static_cast<std::size_t>(degree - 1)] > bounds.color);
    }
}
