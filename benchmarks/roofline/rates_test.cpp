// SPDX-License-Identifier: Apache-2.0
// The peak of products is one that the machine has: no more a cycle than there are units, and
// chains that run beside each other, as the compiler did not merge them.
#include <doctest/doctest.h>

#include <algorithm>
#include <string>

#include "rates.hpp"

using namespace rye::bench;

namespace {

/// Returns what so many turns show of a core of `hertz` whose products take `latency` cycles in
/// `units` units, with `n` chains of which `left` were not merged.
ProductRates shown(int n, int left, double latency, double units, double hertz = 4e9,
                   int turns = 10) {
    ProductRates r(8, n);
    for (int i = 0; i < turns; ++i) {
        const double sums = TurnTimes::sums / hertz;
        const double all = TurnTimes::rounds * std::max(latency, left / units) / hertz;
        r.add({sums, all, TurnTimes::rounds * latency / hertz, sums});
    }
    return r;
}

} // namespace

TEST_CASE("roofline: rates of turns, by hand") {
    const ProductRates r = shown(24, 24, 4, 2);
    CHECK(r.flops() == doctest::Approx(2 * 8 * 2 * 4e9));
    CHECK(r.cycles() == doctest::Approx(4e9));
    CHECK(r.a_cycle() == doctest::Approx(2));
    CHECK(r.under_way() == doctest::Approx(8));
    CHECK(r.latency() == doctest::Approx(4));
    CHECK(r.unmeasured() == "");
    CHECK(r.impossible() == "");
}

TEST_CASE("roofline: chains that were merged are refused, whatever a product takes") {
    for (const int n : {10, 14, 24})
        for (const double latency : {3., 4., 5.}) {
            INFO("chains: " << n << ", cycles of a product: " << latency);
            CHECK(shown(n, 1, latency, 2).impossible() != "");
        }
    // Ten of 4 cycles look like 2.5 units; of 5 cycles like the two units that there are.
    CHECK(shown(10, 1, 4, 1).a_cycle() == doctest::Approx(2.5));
    CHECK(shown(10, 1, 5, 2).a_cycle() == doctest::Approx(2));
}

TEST_CASE("roofline: chains that stay apart are not refused") {
    for (const int n : {14, 24})
        for (const double latency : {3., 4., 5., 6.})
            for (const double units : {1., 2.})
                CHECK(shown(n, n, latency, units).impossible() == "");
}

TEST_CASE("roofline: turns whose frequency changed do not count, nor do emulators") {
    ProductRates r = shown(24, 24, 4, 2);
    r.add({1e-4, 1e-9, 1e-9, 2e-4});
    CHECK(r.a_cycle() == doctest::Approx(2));
    CHECK(shown(24, 24, 4, 2, 4e9, 4).unmeasured() != "");
    CHECK(shown(24, 24, 4, 2, 4e7).unmeasured() != "");
    CHECK(shown(24, 24, 100, 0.01).unmeasured() != "");
}

// Other load lowers rates for a while, so short runs go on until some were undisturbed.
TEST_CASE("roofline: no more products a cycle than units, in chains that do not wait") {
    each_vector_kind([]<class V>(VectorKind<V>) {
        ProductRates r{double(V::size)};
        const double end = wall_seconds() + 3;
        for (int i = 1; wall_seconds() < end; ++i) {
            r.add(turn<V>());
            if (i % 40 == 0 && r.unmeasured().empty() && r.impossible().empty()) break;
        }
        const std::string kind = (sizeof(typename V::value_type) == 4 ? "float" : "double") +
                                 (" x " + std::to_string(V::size));
        MESSAGE(kind << ": " << r.a_cycle() << " products a cycle of " << 1e-9 * r.cycles()
                     << " GHz, each of " << r.latency() << " cycles");
        if (!r.unmeasured().empty()) {
            MESSAGE(kind << " skipped: " << r.unmeasured());
            return;
        }
        INFO(kind);
        CHECK(r.impossible() == "");
        CHECK(r.a_cycle() > 0.4);        // a unit that another thread of the core uses, too
    });
}
