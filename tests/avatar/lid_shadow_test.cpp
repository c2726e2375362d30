// SPDX-License-Identifier: Apache-2.0
// Avatars whose upper lids cast shadows on the eyeballs.
#include <rye/avatar/trained.hpp>

#include <cmath>
#include <limits>

#include <doctest/doctest.h>

#include "../support/avatar_law.hpp"
#include "../support/hostile.hpp"
#include "../support/neutral_law.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using All = More<PaperEffects, Kappa, CornealRefraction, Glint, Pupil, LidShadow, HeadShading,
                 EyesBy<DrivenFeatures>>;
using Lids = Effects<Expression, HeadPose, LeftGaze, RightGaze, Kappa, EyeOffset, LidShadow>;
using Headless = Effects<Expression, RightGaze, LidShadow>;
using Still = Effects<LidShadow>;

template <EffectSet E>
Drivers<double, E> drivers_of() {
    return with_pupils(seen_drivers<E>(tiny_drivers<double>()), {0.6, 1.5});
}

static_assert(std::is_empty_v<detail::Slot<Effects<LeftGaze>, LidShadow, int>>);
static_assert(sizeof(EyeTrace<float, TrainedEffects>) >
              sizeof(EyeTrace<float, Less<TrainedEffects, LidShadow>>));
static_assert(has_effect<TrainedEffects, LidShadow>);

} // namespace

TEST_CASE_TEMPLATE("lid shadow: the vjp of an avatar is the transpose of its duals", E, All, Lids,
                   Headless, Still) {
    CHECK(law_error<E>(avatar_with_parts<E>(), drivers_of<E>(), 2) <= 1e-11);
}

TEST_CASE("lid shadow: colours of the eyes alone darken, by the line that the driven face has") {
    const TwoStream<double, Lids> avatar = avatar_with_parts<Lids>();
    TwoStream<double, Lids> none = avatar;
    none.eyes.lid_shadow = none.eyes.lid_line = {};
    const auto with = driven(avatar, drivers_of<Lids>()),
               without = driven(none, drivers_of<Lids>());
    const Gaussians<double>&a = with.gaussians, &b = without.gaussians;
    CHECK(a.mean == b.mean);
    CHECK(a.scale == b.scale);
    CHECK(a.rotation == b.rotation);
    CHECK(a.opacity == b.opacity);
    const Index n = with.face_count, left = avatar.eyes.points_of(0);
    CHECK(a.feature.leftCols(n) == b.feature.leftCols(n));
    CHECK(a.feature.bottomRows(2) == b.feature.bottomRows(2));
    // The same by means in the world, taken to the head's frame and about each eye's centre.
    int shaded = 0, carried = 0;
    for (Index i = 0; i < avatar.eyes.position.cols(); ++i) {
        const std::size_t eye = i < left ? 0 : 1;
        const double radius = detail::eyeball_radius(avatar.eyes, Index(eye));
        const auto into_head = [&](const Vec3<double>& world) -> Vec3<double> {
            return with.head.rotation.transpose() * (world - with.head.translation) /
                   with.head.scale;
        };
        const Vec3<double> centre = with.eyes.lids.centre[eye];
        Columns<double> at(2, 5);
        for (Index k = 0; k < 5; ++k) {
            const Vec3<double> line = avatar.eyes.lid_line.col(5 * Index(eye) + k);
            const Index of = static_cast<Index>(line[0]);
            const Vec3<double> moved = into_head(a.mean.col(of)) - avatar.face.position.col(of);
            carried += moved.norm() > 1e-3;
            at.col(k) = (line.tail<2>() + (moved - centre).head<2>()) / radius;
        }
        LidOfEye<double> lid;
        for (int node = 0; node < lid_nodes; ++node)
            lid.height[std::size_t(node)] = detail::LidArc<double>{at.data(), 5}.mean(node).height;
        set_lid_turn(Mat3<double>(Mat3<double>::Identity()), radius, lid);
        set_lid_numbers(avatar.eyes.lid_shadow.col(Index(eye)).data(), lid);
        const Vec3<double> point = into_head(a.mean.col(n + i)) - centre;
        const double factor = LidShade<double>(lid, point).factor;
        CHECK((a.feature.col(n + i).head<3>() - factor * b.feature.col(n + i).head<3>()).norm() <
              1e-13);
        shaded += factor < 0.99;
    }
    CHECK(shaded > 5);
    CHECK(carried > 60);
}

TEST_CASE("lid shadow: neutral, it changes no bit of an avatar without it") {
    const auto check = [&]<class T>(T) {
        using E = Less<All, CornealRefraction>;
        using Rest = Less<E, LidShadow>;
        TwoStream<T, E> avatar = lifted<T>(avatar_with_parts<E>());
        Drivers<T, E> drivers = drivers_of<E>().template cast<T>();
        const auto apart = [&] {
            return ulps(driven(avatar, drivers).gaussians,
                        driven(restricted<Rest>(avatar), restricted<Rest>(drivers)).gaussians);
        };
        CHECK(apart() > 1000);
        make_neutral<LidShadow>(avatar, drivers);
        CHECK(apart() == 0);
        TwoStream<T, E> off = lifted<T>(avatar_with_parts<E>());
        off.eyes.lid_shadow = off.eyes.lid_line = {};
        avatar = off;
        CHECK(apart() == 0);
    };
    check(double());
    check(float());
}

TEST_CASE("lid shadow: without lids an avatar has no tensor of it") {
    TwoStream<float, TrainedEffects> avatar =
        lifted<float>(restricted<TrainedEffects>(avatar_of_all()));
    const auto tensors = [&] {
        int found = 0;
        const auto count = [&](const std::string& name, const auto&) {
            found += name.find("lid") != std::string::npos;
        };
        TwoStream<float, TrainedEffects>::fields(count, avatar);
        TwoStream<float, TrainedEffects>::buffers(count, avatar);
        return found;
    };
    CHECK(tensors() == 0);
    set_tiny_lids(avatar);
    CHECK(tensors() == 2);
}

TEST_CASE("lid shadow: an avatar that leaves it out looks as it did at the frame it is held at") {
    using From = Less<All, CornealRefraction, HeadShading>;
    const TwoStream<double, From> all = avatar_with_parts<From>();
    const Drivers<double, From> at = drivers_of<From>();
    const Gaussians<double> seen = driven(all, at).gaussians;
    const auto apart = [&]<EffectSet Fewer>(Fewer) {
        const auto fewer = held<Fewer>(ScalarBackend<>{}, all, tiny_config(), tiny_roles(), at);
        const Gaussians<double> g = driven(fewer, restricted<Fewer>(at)).gaussians;
        double most = 0;
        Gaussians<double>::fields(
            [&](const std::string&, const auto& a, const auto& b) {
                most = std::max(most, (a - b).cwiseAbs().maxCoeff());
            },
            g, seen);
        return most;
    };
    CHECK(apart(Less<From, LidShadow>{}) < 1e-13);
    CHECK(apart(Less<From, LidShadow, Glint>{}) < 1e-13);
    CHECK(apart(Less<From, Glint>{}) < 1e-13);
    CHECK(apart(Effects<HeadPose, LidShadow>{}) < 1e-13);
    CHECK(apart(Effects<HeadPose, Glint>{}) < 1e-13);
    CHECK(apart(Less<From, Expression, EyeOffset>{}) < 1e-13);
    CHECK(apart(Effects<HeadPose, LeftGaze, RightGaze, Glint, LidShadow, Kappa>{}) < 1e-13);
    CHECK(apart(Effects<HeadPose, Glint, LidShadow>{}) < 1e-13);
}

TEST_CASE("lid shadow: closed lids, coincident points and ends of the numbers stay finite") {
    TwoStream<float, Lids> avatar = lifted<float>(avatar_with_parts<Lids>());
    const Drivers<float, Lids> drivers = drivers_of<Lids>().cast<float>();
    const float infinity = std::numeric_limits<float>::infinity();
    const auto check = [&] {
        const auto trace = driven(avatar, drivers);
        CHECK(trace.gaussians.feature.allFinite());
        Gaussians<float> g = trace.gaussians;
        TwoStream<float, Lids> grad = zeros_like(avatar);
        drive_vjp(ScalarBackend<>{}, avatar, {tiny_config(), tiny_roles(), drivers}, trace,
                  {g, grad});
        TwoStream<float, Lids>::fields(
            [](const std::string& name, const auto& a) {
                INFO(name);
                CHECK(a.allFinite());
            },
            grad);
    };
    avatar.eyes.lid_line.setConstant(7);
    check();
    for (const float y : {-30.0F, 30.0F, 1e10F}) {
        avatar.eyes.lid_line.row(2).setConstant(y);
        check();
    }
    for (const float a : {-infinity, -200.0F, 200.0F, infinity})
        for (const float s : {-1e9F, -40.0F, 40.0F, 1e9F}) {
            avatar.eyes.lid_shadow.row(0).setConstant(a);
            avatar.eyes.lid_shadow.row(1).setConstant(s);
            check();
        }
}

TEST_CASE("lid shadow: lids that no face has are refused") {
    TwoStream<float, Still> avatar = lifted<float>(avatar_with_parts<Still>());
    const auto drive_it = [&] { return driven(avatar, Drivers<float, Still>{}); };
    avatar.eyes.lid_line(0, 2) = 60;
    CHECK_FAULT(drive_it(),
                "eye_lids: number 2 of lid_line is 60, expected a Gaussian of the "
                "face, 0 to 59");
    avatar.eyes.lid_line(0, 2) = 1.5F;
    CHECK_FAULT(drive_it(), "eye_lids: number 2 of lid_line is 1.5, expected a Gaussian");
    set_tiny_lids(avatar);
    avatar.eyes.lid_shadow.resize(2, 2);
    CHECK_FAULT(drive_it(), "eye_lids: got lid_shadow of 2 x 2, expected 3 x 2");
}
