// SPDX-License-Identifier: Apache-2.0
#include <rye/avatar/neutral.hpp>

#include "../support/neutral_law.hpp"

using namespace rye;

TEST_CASE("an effect, and each pair, at neutral is as if it were not there: to the bit, in double") {
    rye::test::check_all_pairs<double>(0);
}

TEST_CASE("an eyeball whose bulge is neutral is a sphere, to the bit") {
    EyeballShape bulge = EyeballShape{}.with_radius(0.13);
    const auto sphere = BasicEyeballShape<Less<PaperEffects, CornealBulge>>{}.with_radius(0.13);
    const auto points = [](const auto& shape) { return eyeball_template<double>(shape).points; };
    CHECK(points(bulge) != points(sphere));
    CHECK(points(bulge).colwise().norm().maxCoeff() > 0.131);
    make_neutral(bulge);
    CHECK(points(bulge) == points(sphere));
    CHECK(eyeball_template<double>(bulge).normals == eyeball_template<double>(sphere).normals);
    static_assert(sizeof(sphere) + 2 * sizeof(double) == sizeof(bulge));
}
