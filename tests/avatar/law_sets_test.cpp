// SPDX-License-Identifier: Apache-2.0
// Derivatives of avatars of more sets of effects. Each set compiles an avatar of duals once more:
// check.sh --release.
#include <doctest/doctest.h>

#include "../support/driven_eyes.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("sets: the vjp is the transpose of the duals with refraction, glint or both") {
    CHECK(law_error<Less<OpticsEffects, Glint>>(2) <= 1e-11);
    CHECK(law_error<Less<OpticsEffects, CornealRefraction, HeadPose>>(3) <= 1e-11);
    CHECK(law_error<Effects<CornealRefraction, EyeOffset, HeadPose>>(4) <= 1e-11);
    CHECK(law_error<Effects<LeftGaze, Kappa, Glint, CornealRefraction>>(5) <= 1e-11);
    CHECK(law_error<Effects<Glint>>(6) <= 1e-11);
}

TEST_CASE("sets: the vjp is the transpose of the duals with driven features, whatever else is on") {
    CHECK(driven_law<More<PaperEffects, Driven>>(2) <= 1e-12);
    CHECK(driven_law<More<Less<AllEffects, Expression, LeftGaze>, Driven>>(3) <= 1e-12);
    CHECK(driven_law<Effects<LeftGaze, RightGaze, Kappa, Driven>>(4) <= 1e-12);
    CHECK(driven_law<Effects<PoseResidual, Driven>>(5) <= 1e-12);
    CHECK(driven_law<Effects<Driven>>(6) <= 1e-12);
}

TEST_CASE("sets: the vjp is the transpose of the duals with shading, whatever else is on") {
    CHECK(law_error<Less<OpticsEffects, HeadPose, CornealRefraction, Glint>>(3) <= 1e-12);
    CHECK(law_error<Effects<HeadShading>>(4) <= 1e-12);
}
