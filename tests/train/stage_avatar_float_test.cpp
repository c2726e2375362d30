// SPDX-License-Identifier: Apache-2.0
#include "../support/step_law.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("the two-stream step: its vjp is the transpose of its duals, in float") {
    CHECK(law_error<float>(SquaredDistance{}, 1) <= 1e-5);
    CHECK(law_error<float>(EuclideanDistance{}, 2) <= 1e-5);
}
