// SPDX-License-Identifier: Apache-2.0
#include <rye/avatar/neutral.hpp>

#include "../support/neutral_law.hpp"

TEST_CASE("an effect, and each pair, at neutral is as if it were not there: to 2 ulps, in float") {
    rye::test::check_all_pairs<float>(2);
}
