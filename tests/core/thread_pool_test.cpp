// SPDX-License-Identifier: Apache-2.0
#include <rye/core/thread_pool.hpp>

#include <atomic>
#include <chrono>
#include <string>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "../support/limited.hpp"

using namespace rye;

TEST_CASE("a pool runs each task once: from several threads, from within a task, asleep and awake") {
    std::atomic<int> wrong{0};
    for (int round = 0; round < 5; ++round) {
        ThreadPool pool(4);
        std::vector<std::thread> hosts;
        for (int host = 0; host < 3; ++host)
            hosts.emplace_back([&] {
                for (int k = 0; k < 200; ++k) {
                    std::vector<int> ran(37, 0);
                    const auto nested = [&](Index i) {
                        ++ran[static_cast<std::size_t>(i)];
                        const auto nothing = [](Index) {};
                        if (i == 5 && k % 7 == 0) pool.threads().run(3, nothing);
                    };
                    pool.threads().run(37, nested);
                    for (const int times : ran) wrong += times == 1 ? 0 : 1;
                    if (k % 50 == 0) std::this_thread::sleep_for(std::chrono::microseconds(200));
                }
            });
        for (std::thread& t : hosts) t.join();
    }
    CHECK(wrong == 0);
}

TEST_CASE("a pool throws the exception of the lowest task, and goes on working") {
    ThreadPool pool(3);
    for (int k = 0; k < 20; ++k) {
        int thrown = -1;
        try {
            pool.threads().run(10, [](Index i) {
                if (i > 3) throw static_cast<int>(i);
            });
        } catch (int i) {
            thrown = i;
        }
        CHECK(thrown == 4);
    }
}

TEST_CASE("bands: each task once, whoever takes them; all arrays' elements once, empty ones too") {
    for (const Index n : {0, 1, 3, 7, 100}) {
        detail::TaskBands bands(4);
        bands.deal(n);
        std::vector<int> ran(static_cast<std::size_t>(n), 0);
        for (const int thread : {2, 0})
            bands.take(thread, [&](Index i) { ++ran[static_cast<std::size_t>(i)]; });
        for (const int times : ran) CHECK(times == 1);
    }
    std::vector<std::vector<int>> seen{std::vector<int>(10), {}, std::vector<int>(1),
                                       std::vector<int>(8)};
    std::vector<detail::ArrayWork> arrays;
    for (auto& of : seen)
        arrays.push_back({static_cast<Index>(of.size()), [&of](Index b, Index e) {
                              CHECK(e - b <= 4);
                              for (Index i = b; i < e; ++i) ++of[static_cast<std::size_t>(i)];
                          }});
    for_chunks(Serial{}, arrays, 4);
    for (const auto& of : seen)
        for (const int times : of) CHECK(times == 1);
}

#ifdef RYE_HAS_LIMITS
namespace {

/// Whether a pool that asks for `threads` has fewer and sums as one with all of them does.
bool works_with_fewer(int threads) {
    ThreadPool pool(threads);
    std::vector<int> ran(1000, 0);
    pool.threads().run(1000, [&](Index i) { ++ran[static_cast<std::size_t>(i)]; });
    for (const int times : ran)
        if (times != 1) return false;
    return pool.asked() == threads && pool.size() >= 1 && pool.size() < threads;
}

} // namespace

TEST_CASE("a pool goes on with the threads that the system starts") {
    CHECK(test::in_child(20, [] { return test::limit_threads(5) && works_with_fewer(64); }) == "");
    CHECK(test::in_child(20, [] { return test::limit_threads(1) && works_with_fewer(64); }) == "");
    if (test::limits_memory())
        CHECK(test::in_child(20, [] {
            return test::limit_memory(64 << 20) && works_with_fewer(300);
        }) == "");
    else
        MESSAGE("not run: with little memory, which is not limited here");
}
#endif
