// SPDX-License-Identifier: Apache-2.0
// Ranks in processes, here on threads of one: they meet by files alone.
#include "training/process_ranks.hpp"

#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "../support/hostile.hpp"
#include "device/rank_watch.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

namespace fs = std::filesystem;

constexpr RankTimes quick{0.05, 1.5, 3};

/// Calls f(rank) on a thread for each rank, and returns what each ended with.
std::vector<std::string> on_threads(int size, const std::function<void(int)>& f) {
    std::vector<std::string> ended(static_cast<std::size_t>(size));
    std::vector<std::thread> threads;
    for (int r = 0; r < size; ++r)
        threads.emplace_back([&, r] {
            try {
                f(r);
            } catch (const std::exception& e) {
                ended[static_cast<std::size_t>(r)] = e.what();
            }
        });
    for (std::thread& t : threads) t.join();
    return ended;
}

} // namespace

TEST_CASE("ranks in processes: they meet, whatever an earlier start has left, and leave nothing") {
    const TemporaryFolder run;
    fs::create_directories(run.path / "ranks");
    for (const char* name : {"start", "came_0", "came_1", "came_2", "seen_1", "seen_2"})
        std::ofstream(run.path / "ranks" / name) << "0123456789abcdef 1:x 2:0123456789abcdef";
    std::vector<std::string> words(3);
    const auto ended = on_threads(3, [&](int r) {
        RanksInProcesses ranks(run.path, {r, 3, r}, quick);
        CHECK((ranks.rank() == r && ranks.size() == 3 && ranks.threads() == nullptr));
        auto& own = words[static_cast<std::size_t>(r)];
        own = ranks.given("first of " + std::to_string(r));
        own += ", " + ranks.given(std::string("a\0b", 3) + std::to_string(r));
        CHECK(ranks.ended() == "");
    });
    for (int r = 0; r < 3; ++r) {
        CHECK(ended[static_cast<std::size_t>(r)] == "");
        CHECK(words[static_cast<std::size_t>(r)] == "first of 0, " + std::string("a\0b0", 4));
    }
    CHECK(!fs::exists(run.path / "ranks"));
}

TEST_CASE("ranks in processes: one that does not come is named") {
    const TemporaryFolder run;
    RankTimes times = quick;
    times.arrival = 0.3;
    const auto ended = on_threads(2, [&](int r) {
        RanksInProcesses ranks(run.path, {2 * r, 4, 0}, times); // ranks 0 and 2 of 4
    });
    CHECK(ended[0] == (run.path / "ranks").string() + ": rank 1, 3 of 4 has not come for 0 s");
    CHECK(ended[1] == ""); // rank 0 has seen it
    const TemporaryFolder other;
    CHECK_THROWS_WITH(
        RanksInProcesses(other.path, {2, 4, 0}, times),
        ((other.path / "ranks").string() + ": rank 0 of 4 has not come for 0 s").c_str());
}

TEST_CASE("ranks in processes: a rank that ends, ends those that wait, with its reason") {
    const TemporaryFolder run;
    std::atomic<int> acted{0};
    const auto ended = on_threads(3, [&](int r) {
        RanksInProcesses ranks(run.path, {r, 3, r}, quick);
        try {
            if (r == 0) throw Error("a disk is full");
            const RankWatch watch(ranks, [&](const std::string& reason) {
                CHECK(reason == "rank 0 ended: a disk is full");
                ++acted;
            });
            try {
                ranks.given("");
            } catch (const Error&) {
                while (acted < 2) std::this_thread::yield();
                throw;
            }
        } catch (const Error& e) {
            ranks.leave(e.what());
            throw;
        }
    });
    CHECK(ended[0] == "a disk is full");
    CHECK(ended[1] == "rank 0 ended: a disk is full");
    CHECK(ended[2] == "rank 0 ended: a disk is full");
}

TEST_CASE("ranks: a wait that takes too long ends, though no rank has ended") {
    ThreadMeeting meeting(2);
    RanksInThreads ranks(ThreadGroup(meeting, 0));
    std::mutex mutex;
    std::string words;
    const auto told = [&] {
        const std::lock_guard<std::mutex> lock(mutex);
        return words;
    };
    const auto end = [&](const std::string& reason) {
        const std::lock_guard<std::mutex> lock(mutex);
        words = reason;
    };
    const auto act = [](const std::string&) { CHECK(false); };
    {
        const RankWatch watch(ranks, act, {std::chrono::minutes(5), "too long"}, end);
        std::this_thread::sleep_for(std::chrono::milliseconds(500));
    }
    CHECK(told().empty());
    const RankWatch watch(ranks, act, {std::chrono::milliseconds(300), "too long"}, end);
    while (told().empty()) std::this_thread::yield();
    CHECK(told() == "too long");
}

TEST_CASE("ranks in processes: one without signs of life has ended, one that is done has not") {
    const TemporaryFolder run;
    std::atomic<bool> over{false};
    const auto ended = on_threads(3, [&](int r) {
        RankTimes times = quick;
        if (r == 1) times.sign = 1000; // as one that was killed after its first
        RanksInProcesses ranks(run.path, {r, 3, r}, times);
        if (r == 2) return;
        if (r == 1) {
            while (!over) std::this_thread::yield();
            return;
        }
        std::string reason;
        while (reason.empty()) reason = ranks.ended();
        over = true;
        throw Error(reason);
    });
    CHECK(ended[0] == "rank 1 ended: no sign of life for 1 s");
    CHECK(ended[1] == "");
    CHECK(ended[2] == "");
}

TEST_CASE("ranks in processes: names of launchers and numbers of ranks") {
    for (const char* name : {"torchrun", "mpi", "slurm"}) CHECK(is_launcher(name));
    CHECK(!is_launcher("2"));
    CHECK(parsed_ranks("16", "--ranks") == 16);
    for (const char* text : {"", "0", "-1", "2x", "1025", "many"})
        CHECK_THROWS_WITH(parsed_ranks(text, "--ranks"),
                          ("--ranks: got '" + std::string(text) +
                           "', expected a number from 1 to 1024, torchrun, mpi or slurm")
                              .c_str());
}
