// SPDX-License-Identifier: Apache-2.0
// Ranks on devices by NCCL's interface, with tests/support/fake_nccl.cpp in NCCL's place.
#if !defined(_WIN32)

#include <rye/train/cuda/nccl_ranks.hpp>

#include <chrono>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "../cuda/emulated.hpp"

using namespace rye;
using namespace rye::test;

namespace {

/// Returns true if the library that programs find is the tests' own.
bool is_fake() {
    void* const library = dlopen("libnccl.so.2", RTLD_NOW);
    const bool fake = library != nullptr && dlsym(library, "rye_fake_nccl") != nullptr;
    if (!fake) MESSAGE("skipped: libnccl.so.2 is not the tests' own");
    return fake;
}

/// Calls f(group, ranks) on a thread for each rank, joined by one id.
template <class F>
void joined(int size, const F& f) {
    run_ranks(size, [&](ThreadGroup& group) {
        NcclId own;
        if (group.rank() == 0) own = NcclRanks::new_id();
        NcclRanks ranks(group.given(own), group.rank(), size);
        f(group, ranks);
        group.meet();
    });
}

} // namespace

TEST_CASE("NCCL: sums over ranks are the tree's, or the library's") {
    if (!is_fake()) return;
    for (const int size : {1, 2, 3, 4})
        for (const RankSum by : {RankSum::tree, RankSum::library})
            joined(size, [&](ThreadGroup& group, NcclRanks& ranks) {
                const Index n = 21;
                const auto number = [](int rank, Index i) {
                    return 1.0F / static_cast<float>(1 + 3 * i + 7 * rank);
                };
                std::vector<float> x(
                    static_cast<std::size_t>(DeviceRankSum<EmulatedDevice>::room(n, size)));
                for (Index i = 0; i < n; ++i)
                    x[static_cast<std::size_t>(i)] = number(group.rank(), i);
                DeviceRankSum<EmulatedDevice>(EmulatedDevice{})
                    .into(host_queue, ranks, x.data(), n, by);
                ranks.check();
                for (Index i = 0; i < n; ++i) {
                    std::vector<float> terms;
                    for (int r = 0; r < size; ++r) terms.push_back(number(r, i));
                    float expected = 0;
                    for (const float t : terms) expected += t;
                    if (by == RankSum::tree) {
                        tree_sum(size, [&](int to, int from) {
                            terms[static_cast<std::size_t>(to)] +=
                                terms[static_cast<std::size_t>(from)];
                        });
                        expected = terms[0];
                    }
                    REQUIRE(x[static_cast<std::size_t>(i)] == expected);
                }
            });
}

TEST_CASE("NCCL: a rank that waits ends with the reason") {
    if (!is_fake()) return;
    joined(2, [&](ThreadGroup& group, NcclRanks& ranks) {
        if (group.rank() == 1) return; // never sends its part
        std::thread watch([&] {
            std::this_thread::sleep_for(std::chrono::milliseconds(50));
            ranks.end("rank 1 ended: a disk is full");
        });
        std::vector<float> x(8), parts(8);
        CHECK_THROWS_WITH(ranks.exchange(host_queue, x.data(), parts.data(), 4),
                          "rank 1 ended: a disk is full");
        watch.join();
        CHECK_THROWS_WITH(ranks.check(), "rank 1 ended: a disk is full");
        CHECK_THROWS_WITH(ranks.gather(host_queue, x.data(), parts.data(), 4),
                          "rank 1 ended: a disk is full");
    });
}

#endif
