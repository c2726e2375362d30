// SPDX-License-Identifier: Apache-2.0
// Sizes of caches are read from the system's files, work gets the speed of the level that holds it,
// and the loops that measure speeds do what they are timed for.
#include <doctest/doctest.h>

#include <filesystem>
#include <fstream>
#include <numeric>
#include <string>
#include <vector>

#include <unistd.h>

#include "memory.hpp"
#include "rates.hpp"

using namespace rye::bench;

namespace {

/// A folder of files as Linux has them, for the length of a test.
struct CacheFiles {
    std::filesystem::path folder = std::filesystem::temp_directory_path() /
                                   ("rye_caches_" + std::to_string(getpid()));

    CacheFiles() { std::filesystem::create_directories(folder); }
    ~CacheFiles() { std::filesystem::remove_all(folder); }
    CacheFiles(const CacheFiles&) = delete;
    CacheFiles& operator=(const CacheFiles&) = delete;

    void add(int index, const std::string& type, const std::string& size) const {
        const auto here = folder / ("index" + std::to_string(index));
        std::filesystem::create_directories(here);
        std::ofstream(here / "type") << type << "\n";
        std::ofstream(here / "size") << size << "\n";
    }
};

} // namespace

TEST_CASE("roofline: sizes as the system's files state them") {
    CHECK(stated_bytes("48K") == 48 * 1024);
    CHECK(stated_bytes("32M") == 32 * 1024 * 1024);
    CHECK(stated_bytes("1G") == 1024.0 * 1024 * 1024);
    CHECK(stated_bytes("512") == 512);
    CHECK(stated_bytes("7 apples") == 0);
}

TEST_CASE("roofline: the data caches of the system's files, in order") {
    const CacheFiles files;
    files.add(0, "Data", "48K");
    files.add(1, "Instruction", "64K");
    files.add(2, "Unified", "2048K");
    files.add(3, "Unified", "30M");
    CHECK(cache_sizes(files.folder) == std::vector<double>{48 * 1024, 2048 * 1024, 30 * 0x1p20});
}

TEST_CASE("roofline: without those files, sizes that grow all the same") {
    for (const std::vector<double>& sizes : {cache_sizes("/nowhere"), cache_sizes()}) {
        REQUIRE(!sizes.empty());
        CHECK(sizes.front() >= 4096);
        for (std::size_t i = 1; i < sizes.size(); ++i) CHECK(sizes[i] > sizes[i - 1]);
    }
}

TEST_CASE("roofline: working sets grow, fill half a cache, and end with memory") {
    const auto sets = working_sets({0x1p15, 0x1p21, 0x1p29}, 0x1p30);
    for (std::size_t i = 1; i < sets.size(); ++i) {
        CHECK(sets[i].bytes > sets[i - 1].bytes);
        CHECK(sets[i].holds > sets[i - 1].holds);
    }
    CHECK(sets.front().level == "L1");
    CHECK(sets.front().bytes == 0x1p14);
    CHECK(sets.front().holds == 0x1p15);
    CHECK(sets.back().level == "memory");
    CHECK(sets.back().bytes == 0x1p30);
    CHECK(sets.size() == 6);             // L1, L2, 16 MiB, 64 MiB and all of L3, memory
    CHECK(working_sets({0x1p15, 0x1p20}, 0x1p30).back().bytes == 0x1p22);
}

TEST_CASE("roofline: work has the speed of the smallest level that holds it") {
    MemorySpeeds s;
    for (const WorkingSet& set : working_sets({0x1p15, 0x1p20, 0x1p25}, 0x1p30))
        s.speeds.push_back({set, 0, 0});
    CHECK(s.at(1000).set.level == "L1");
    CHECK(s.at(0x1p15).set.level == "L1");
    CHECK(s.at(0x1p15 + 1).set.level == "L2");
    CHECK(s.at(25e6).set.level == "L3");
    CHECK(s.at(1e9).set.level == "memory");
}

TEST_CASE("roofline: the loops read and copy every number") {
    rye::AlignedArray<float> memory;
    constexpr std::size_t n = 4 * memory_turn;
    float* const x = memory.reserve(2 * n);
    std::iota(x, x + n, 1.F);
    CHECK(read_all(x, n) == n * (n + 1) / 2);        // whole numbers: exact in any order
    CHECK(read_all(x, n, 3) == 3 * n * (n + 1) / 2);
    std::fill_n(x + n, n, 0.F);
    copy_all(x, x + n, n);
    CHECK(std::vector<float>(x, x + n) == std::vector<float>(x + n, x + 2 * n));
}

// A loop that the compiler removed would be faster than any processor.
TEST_CASE("roofline: the nearest cache moves what a core can, no more") {
    const auto core = ProductRates::measured<Floats>(20);
    const MemorySpeed near = measured_speed(working_sets(cache_sizes(), 0x1p30).front(), 20);
    const double vector = 4 * core.lanes();    // [byte]
    CHECK(near.read / core.cycles() < 4 * vector);             // loads a cycle
    CHECK(near.copy / core.cycles() < 2 * 3 * vector);         // loads and stores
    CHECK(near.read / core.cycles() > 1);
    CHECK(near.copy / core.cycles() > 1);
}
