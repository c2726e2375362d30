// SPDX-License-Identifier: Apache-2.0
#include "policy.hpp"

namespace rye::bench {

std::vector<Policy> preset_policies() {
    // Tight has Balanced's compile-time rules, so it is passed as fields of that type.
    return {policy<Lanes, float>("Tight", "preset", Balanced(Tight())),
            policy<Lanes, float>("Balanced", "preset", Balanced()),
            policy<Lanes, float>("Fast", "preset", Fast())};
}

} // namespace rye::bench
