// SPDX-License-Identifier: Apache-2.0
// The bound's sum, by hand, on a machine of round numbers.
#include <doctest/doctest.h>

#include "bound.hpp"

using namespace rye::bench;

namespace {

/// 10^9 products of vectors of 16 a second, caches of 1 MB, 10^9 byte/s from one and 10^8 from
/// memory.
Machine round_machine() {
    Machine m{32e9, 1e9, 16, 1e8, 1e9, {}};
    m.memory.speeds = {{{"L1", 5e5, 1e6}, 1e9, 1e9}, {{"memory", 1e9, 1e30}, 1e8, 1e8}};
    return m;
}

constexpr SplatWork few{.gaussians = 1000, .channels = 3, .pixels = 4096, .visible = 900,
                        .entries = 2000, .pairs = 80000, .blocks = 10000, .touched = 1500};

} // namespace

TEST_CASE("bound: lanes that are live") { CHECK(few.live(16) == 0.5); }

TEST_CASE("bound: traffic copies what is both read and written") {
    const MemorySpeed speed{{"L1", 1, 1}, 100, 50};
    CHECK(Traffic{100, 0}.seconds(speed) == 1);
    CHECK(Traffic{0, 100}.seconds(speed) == 2);
    CHECK(Traffic{100, 100}.seconds(speed) == 4);
    CHECK(Traffic{200, 100}.seconds(speed) == 5);
    CHECK(Traffic{100, 200}.seconds(speed) == 6);
}

TEST_CASE("bound: products of vectors, with pixels in the lanes or channels") {
    CHECK(few.blend_vectors(16) == 10000 * (8 + 3));
    CHECK(few.reverse_vectors(16) == 10000 * (21 + 6) + 1500 * 2 * (6 + 3));
    SplatWork many = few;
    many.channels = 64;
    many.pairs = 20000;                  // two pixels of a block: channels in the lanes are fewer
    CHECK(many.blend_vectors(16) == 10000 * 8 + 20000 * 4);
    CHECK(many.reverse_vectors(16) == 10000 * (21 + 64) + 20000 * 4 + 1500 * 2 * 6);
}

TEST_CASE("bound: stages follow each other, the longer of products and bytes each") {
    const Machine m = round_machine();
    const double bytes = 4.0 * 1000 * 14 + 4.0 * 4096 * 5;
    CHECK(few.forward_bytes() == bytes);
    // Projection reads 44 kB, longer than its 7.5 us of products; so do 81.92 kB of the picture,
    // of which as many are copied as features are read.
    const double project = 44e-6, sort = 900 / 1e8, lists = 2000 / 1e9;
    const double blend = 11 * 10000 / 1e9;
    CHECK(few.bounds(m).forward() == doctest::Approx(project + sort + lists + blend));
    const double reverse = (10000.0 * 27 + 1500 * 18) / 1e9;
    CHECK(few.bounds(m).both() ==
          doctest::Approx(few.bounds(m).forward() + reverse + 44e-6 + 56e-6));
}

TEST_CASE("bound: bytes that no cache holds take the time of memory") {
    Machine m = round_machine();
    SplatWork w = few;
    w.pixels = 1e6;
    const double in_memory = w.bounds(m).forward();
    CHECK(in_memory > 4 * 1e6 * 5 / 1e8);
    m.memory.speeds.front().set.holds = 1e9;
    CHECK(w.bounds(m).forward() < in_memory / 5);
}

// The design's figures for 100,000 Gaussians, 3 channels and 16 lanes: 1.9 ms on a core that does
// 267 GFLOP/s, sorts 295 million keys a second and writes an entry in 1.34 ns.
TEST_CASE("bound: of the timed head, as computed by hand for one processor") {
    Machine m{267e9, 4.2e9, 16, 295e6, 745e6, {}};
    m.memory.speeds = {{{"L3", 1.6e7, 3.2e7}, 72e9, 72e9}};
    const SplatWork w{.gaussians = 1e5, .channels = 3, .pixels = 512 * 512, .visible = 99866,
                      .entries = 298000, .pairs = 6.117e6, .blocks = 733000, .touched = 298000};
    CHECK(1e3 * w.bounds(m).forward() == doctest::Approx(1.9).epsilon(0.06));
    CHECK(1e3 * w.bounds(m).both() > 4.5);
    CHECK(1e3 * w.bounds(m).both() < 5.8);
}
