// SPDX-License-Identifier: Apache-2.0
#include <rye/avatar/neutral.hpp>

#include "../support/neutral_law.hpp"

using namespace rye;

TEST_CASE("shading, and each pair with it, at neutral: to the bit in double") {
    rye::test::check_shading_pairs<double>(0);
}

TEST_CASE("shading at neutral: 2 ulps in float") {
    rye::test::check_neutral<float, rye::test::OpticsEffects, HeadShading>(2);
}
