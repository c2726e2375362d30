// SPDX-License-Identifier: Apache-2.0
#include "policy.hpp"

namespace rye::bench {

std::vector<Policy> degree_policies() {
    return {policy<Lanes, float>("exp2 of the library", "exp2", ExactDegree<0>()),
            policy<Lanes, float>("exp2 degree 5", "exp2", ExactDegree<5>()),
            policy<Lanes, float>("exp2 degree 4", "exp2", ExactDegree<4>()),
            policy<Lanes, float>("exp2 degree 3", "exp2", ExactDegree<3>())};
}

} // namespace rye::bench
