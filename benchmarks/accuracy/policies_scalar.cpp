// SPDX-License-Identifier: Apache-2.0
#include "policy.hpp"

namespace rye::bench {

std::vector<Policy> scalar_policies() {
    return {policy<Lanes, double>("Exact64", "preset", Exact64()),
            policy<Plain, float>("plain loops", "backend", Exact32())};
}

} // namespace rye::bench
