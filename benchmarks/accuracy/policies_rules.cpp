// SPDX-License-Identifier: Apache-2.0
// The rules of the first implementation, together and one at a time.
#include "policy.hpp"

namespace rye::bench {
namespace {

struct ExclusiveStop : Exact32 {
    constexpr ExclusiveStop() { stop = 1e-4; }
    static constexpr Stop stop_rule = Stop::exclusive;
};
struct SquareSupport : Exact32 {
    static constexpr Support support = Support::square;
};
struct FineKeys : Exact32 {
    static constexpr int depth_bits = 64;
};

} // namespace

std::vector<Policy> rule_policies() {
    return {policy<Lanes, float>("Compatible3dgs", "preset", Compatible3dgs()),
            policy<Lanes, float>("exclusive stop 1e-4", "stop", ExclusiveStop()),
            policy<Lanes, float>("3 sigma squares", "support", SquareSupport()),
            policy<Lanes, float>("depth keys of 64 bits", "order", FineKeys())};
}

} // namespace rye::bench
