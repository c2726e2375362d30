// SPDX-License-Identifier: Apache-2.0
#include "policy.hpp"

namespace rye::bench {
namespace {

struct ByPeak : Exact32 {
    static constexpr BlendOrder order = BlendOrder::by_peak;
};

} // namespace

std::vector<Policy> scalar_policies() {
    return {policy<Lanes, double>("Exact64", "preset", Exact64()),
            policy<Plain, float>("plain loops", "backend", Exact32()),
            policy<Plain, float>("order by pixel, plain loops", "order", ByPeak())};
}

} // namespace rye::bench
