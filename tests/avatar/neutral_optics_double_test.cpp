// SPDX-License-Identifier: Apache-2.0
#include <rye/avatar/neutral.hpp>

#include "../support/neutral_law.hpp"

using namespace rye;

TEST_CASE("refraction and glint, and each pair with one, at neutral: to the bit in double") {
    rye::test::check_optics_pairs<double>(0);
}
