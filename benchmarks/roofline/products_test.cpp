// SPDX-License-Identifier: Apache-2.0
// The peak of products is one that the machine has: the chains are all computed, and do no more a
// cycle than there are units.
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "products.hpp"

using namespace rye::bench;

namespace {

/// Units of a core that take a fused product of a whole vector each cycle, at most.
#if defined(__x86_64__) || defined(__i386__)
constexpr double most_units = 2;
#else
constexpr double most_units = 4;         // of 128 bits
#endif

} // namespace

TEST_CASE("roofline: chains of products end where plain loops do, each elsewhere") {
    constexpr int rounds = 37;
    const ChainValues from = ChainValues::different();
    const ChainStep step;
    ChainValues to{};
    run_chains(&from, &step, rounds, &to);
    double sum = 0, expected_sum = 0;
    for (std::size_t i = 0; i < to.value.size(); ++i) {
        float expected = from.value[i];
        for (int round = 0; round < rounds; ++round) expected = std::fma(expected, step.x, step.y);
        CHECK(std::abs(to.value[i] - expected) < 1e-5F);  // without fused products: other last bits
        sum += to.value[i];
        expected_sum += expected;
    }
    CHECK(std::abs(sum - expected_sum) < 1e-5 * expected_sum);
    std::vector<float> ends(to.value.begin(), to.value.end());
    std::sort(ends.begin(), ends.end());
    for (std::size_t i = 1; i < ends.size(); ++i) CHECK(ends[i] - ends[i - 1] > 1e-3F);
}

TEST_CASE("roofline: sums that wait for each other are all computed") {
    CHECK(dependent_sums(5, 3, 640) == 5 + 3 * 640);
}

// Other load lowers both rates for a while, so short runs go on until one was undisturbed.
TEST_CASE("roofline: no more products a cycle than units, and no fewer than one has") {
    PeakTurns best;
    const auto plausible = [&] {
        return best.products_a_cycle() > 0.8 && best.products_a_cycle() < 1.1 * most_units;
    };
    for (const double begin = wall_seconds(); wall_seconds() < begin + 3;) {
        for (int i = 0; i < 20; ++i) best.turn();
        if (plausible()) break;
    }
    MESSAGE("products a cycle: " << best.products_a_cycle() << " of vectors of "
                                 << ChainValues::lanes << ", at " << 1e-9 * best.cycles << " GHz");
    CHECK(best.products_a_cycle() > 0.8);
    CHECK(best.products_a_cycle() < 1.1 * most_units);
}
