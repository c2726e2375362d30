// SPDX-License-Identifier: Apache-2.0
#include "policy.hpp"

namespace rye::bench {

std::vector<Policy> preset_policies() {
    // Tight has Balanced's rules; it is passed as numbers for that type, compiled once.
    return {policy<Lanes, float>("Tight", "preset", Balanced(Tight())),
            policy<Lanes, float>("Balanced", "preset", Balanced()),
            policy<Lanes, float>("Fast", "preset", Fast())};
}

} // namespace rye::bench
