// SPDX-License-Identifier: Apache-2.0
// Exact32, and each of its fields relaxed alone.
#include "policy.hpp"

namespace rye::bench {

std::vector<Policy> exact_policies() {
    std::vector<Policy> all{policy<Lanes, float>("Exact32", "preset", Exact32())};
    const auto add = [&](const std::string& name, const std::string& group, auto&& change) {
        Exact32 a;
        change(a);
        all.push_back(policy<Lanes, float>(name, group, a));
    };
    add("alpha_min 1/25500", "alpha_min", [](auto& a) { a.alpha_min = 1.0 / 25500; });
    add("alpha_min 1/2550", "alpha_min", [](auto& a) { a.alpha_min = 1.0 / 2550; });
    add("alpha_min 1/255", "alpha_min", [](auto& a) { a.alpha_min = 1.0 / 255; });
    add("alpha_max .999", "alpha_max", [](auto& a) { a.alpha_max = 0.999; });
    add("alpha_max .99", "alpha_max", [](auto& a) { a.alpha_max = 0.99; });
    add("stop 1e-6", "stop", [](auto& a) { a.stop = 1e-6; });
    add("stop 1e-5", "stop", [](auto& a) { a.stop = 1e-5; });
    add("stop 1e-4", "stop", [](auto& a) { a.stop = 1e-4; });
    add("non-finite not checked", "trust", [](auto& a) { a.non_finite = NonFinite::trust; });
    return all;
}

} // namespace rye::bench
