// SPDX-License-Identifier: Apache-2.0
// Chains of products are all computed, for every kind of vector.
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>
#include <vector>

#include "products.hpp"

using namespace rye::bench;

namespace {

/// Checks that chains of vectors V end where plain loops do, each elsewhere.
template <class V, int N>
void check_ends() {
    using T = typename V::value_type;
    constexpr int rounds = 37;
    const double error = sizeof(T) == 4 ? 1e-5 : 1e-14;  // without fused products: other last bits
    const auto from = ChainValues<V, N>::different();
    const ChainStep<T> step;
    ChainValues<V, N> to{};
    run_chains(&from, &step, rounds, &to);
    double sum = 0, expected_sum = 0;
    for (std::size_t i = 0; i < to.value.size(); ++i) {
        T expected = from.value[i];
        for (int round = 0; round < rounds; ++round) expected = std::fma(expected, step.x, step.y);
        CHECK(std::abs(to.value[i] - expected) < error);
        sum += to.value[i];
        expected_sum += expected;
    }
    CHECK(std::abs(sum - expected_sum) < error * expected_sum);
    std::vector<T> ends(to.value.begin(), to.value.end());
    std::sort(ends.begin(), ends.end());
    for (std::size_t i = 1; i < ends.size(); ++i) CHECK(ends[i] - ends[i - 1] > T(1e-3));
}

} // namespace

TEST_CASE("roofline: chains of products end where plain loops do, each elsewhere") {
    each_vector_kind([]<class V>(VectorKind<V>) {
        check_ends<V, chains>();
        check_ends<V, 1>();
    });
}

TEST_CASE("roofline: the kernels' vectors are among the kinds, no kind is there twice") {
    std::set<std::pair<std::size_t, std::size_t>> kinds;     // bytes of a number, lanes
    int n = 0;
    each_vector_kind([&]<class V>(VectorKind<V>) {
        kinds.insert({sizeof(typename V::value_type), V::size});
        ++n;
    });
    CHECK(int(kinds.size()) == n);
    CHECK(kinds.count({sizeof(float), Floats::size}) == 1);
}

TEST_CASE("roofline: sums that wait for each other are all computed") {
    CHECK(dependent_sums(5, 3, 640) == 5 + 3 * 640);
}
