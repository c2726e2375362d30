// SPDX-License-Identifier: Apache-2.0
// Tile lists against brute force: no pixel that a Gaussian can reach is missed, for ellipses of
// every size and needle, and the lists are in the order of depth.
#include <rye/splat/tiles.hpp>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>

using namespace rye;

TEST_CASE("tiles: the radix sort is stable and sorts") {
    const Random random{1, 1};
    for (const Index n : {0, 1, 2, 1000}) {
        std::vector<std::uint32_t> keys, values;
        for (Index i = 0; i < n; ++i) {
            const double z = i % 3 == 0 ? 1.0 : 0.9 + 0.2 * random.uniform(std::uint64_t(i));
            keys.push_back(depth_key(static_cast<float>(z)));
            values.push_back(static_cast<std::uint32_t>(i));
        }
        const auto before = keys;
        SortBuffer<std::uint32_t> buffer;
        sort_by_key(keys, values, buffer);
        bool sorted = true;
        for (std::size_t i = 1; i < values.size(); ++i)
            sorted &= keys[i - 1] < keys[i] ||
                      (keys[i - 1] == keys[i] && values[i - 1] < values[i]);
        for (std::size_t i = 0; i < values.size(); ++i) sorted &= keys[i] == before[values[i]];
        CHECK(sorted);
    }
}

TEST_CASE("tiles: depth keys order as depths do, in float and in double") {
    const Random random{2, 1};
    const double special[] = {-1e30, -1.0, -1e-45, -0.0, 0.0, 1e-45, 1e-38, 0.9, 1.0, 1e30};
    for (const double a : special)
        for (const double b : special) {
            if (a < b && float(a) < float(b)) CHECK(depth_key(float(a)) < depth_key(float(b)));
            if (a < b) CHECK(depth_key(a) < depth_key(b));
        }
    for (std::uint64_t i = 0; i < 100000; ++i) {
        const double a = random.normal(2 * i), b = random.normal(2 * i + 1);
        if ((a < b) != (depth_key(a) < depth_key(b))) FAIL("order");
    }
}

TEST_CASE("tiles: no pixel that an ellipse reaches is missed") {
    const Random random{3, 1};
    const int width = 61, height = 45;
    Index reached = 0, listed = 0;
    for (std::uint64_t trial = 0; trial < 3000; ++trial) {
        const auto u = [&](std::uint64_t k) { return random.uniform(trial * 8 + k); };
        const double long_axis = std::exp(std::log(0.3) + u(0) * std::log(1e4));
        const double short_axis = trial % 3 == 0 ? long_axis : 1e-3;
        const double angle = trial % 5 == 0 ? 0 : 3.2 * u(1);
        const double c = std::cos(angle), s = std::sin(angle);
        const Vec3<float> x(float(long_axis * c), float(-short_axis * s), 0);
        const Vec3<float> y(float(long_axis * s), float(short_axis * c), 0);
        Footprint<float> f;
        f.x = float(90 * u(2) - 15);
        f.y = float(70 * u(3) - 12);
        if (trial % 4 == 0) f.x = std::round(f.x / 8) * 8, f.y = std::round(f.y / 8) * 8;
        f.radius = float(0.1 + 4 * u(4));
        f.covariance = gram(x, y, 0.3F);
        f.determinant = gram_determinant(x, y, 0.3F);
        const PrecisionFactor<float> form = precision_factor(x, y, 0.3F);

        const Cover<Support::ellipse, float> cover{f, width, height};
        const Span rows = cover.rows();
        TileLists lists;
        std::vector<std::uint32_t> order;
        std::vector<Span> pixel_rows;
        if (rows.begin < rows.end) order = {0}, pixel_rows = {rows};
        lists.build<Serial, Support::ellipse, float>(
            width, height, [&](Index m) { return pixel_rows[std::size_t(m)]; }, order, 1000000, [&](Index) -> const auto& { return f; });
        listed += lists.entries();
        for (Index t = 0; t < lists.tiles(); ++t) {
            const bool in_list = lists.begin[std::size_t(t)] < lists.begin[std::size_t(t) + 1];
            bool hit = false;
            for (int p = 0; p < tile_pixels; ++p) {
                const int px = int(t % lists.columns) * tile_edge + p % tile_edge;
                const int py = int(t / lists.columns) * tile_edge + p / tile_edge;
                if (px >= width || py >= height) continue;
                const float q =
                    form.quadratic(float(px) + 0.5F - f.x, float(py) + 0.5F - f.y);
                if (!(q <= f.radius * f.radius)) continue;
                hit = true;
                if (!in_list || py < rows.begin || py >= rows.end)
                    FAIL("missed pixel " << px << ", " << py << " in trial " << trial);
            }
            reached += hit ? 1 : 0;
        }
    }
    CHECK(reached > 10000);
    CHECK(double(listed) < 1.15 * double(reached));  // exact but for tiles between pixel centres
}

TEST_CASE("tiles: numbers that no int holds are clamped first") {
    for (const float far : {1e20F, -1e20F, 3e38F}) {
        const Span s = pixels_between(-far, far, 100);
        CHECK(s.begin >= 0);
        CHECK(s.end <= 100);
    }
    CHECK(pixels_between(-1e30F, 1e30F, 100).begin == 0);
    CHECK(pixels_between(-1e30F, 1e30F, 100).end == 100);
}

TEST_CASE("tiles: each list is near to far, and members find their entries") {
    const Random random{4, 1};
    const Index n = 500;
    std::vector<Footprint<float>> f(static_cast<std::size_t>(n));
    std::vector<Span> rows;
    std::vector<std::uint32_t> order;
    for (Index i = 0; i < n; ++i) {
        const auto k = static_cast<std::uint64_t>(3 * i);
        auto& e = f[static_cast<std::size_t>(i)];
        e = {float(64 * random.uniform(k)), float(64 * random.uniform(k + 1)), 3, {4, 1, 2}, 7};
        rows.push_back(Cover<Support::ellipse, float>{e, 64, 64}.rows());
        order.push_back(static_cast<std::uint32_t>((i * 7) % n));
    }
    TileLists lists;
    lists.build<DefaultThreads, Support::ellipse, float>(
        64, 64, [&](Index m) { return rows[std::size_t(m)]; }, order, 1 << 30, [&](Index m) -> const auto& { return f[std::size_t(m)]; });
    std::vector<Index> rank(static_cast<std::size_t>(n));
    for (Index r = 0; r < n; ++r) rank[order[std::size_t(r)]] = r;
    bool sorted = true, found = true;
    for (std::size_t t = 0; t < std::size_t(lists.tiles()); ++t)
        for (Index k = lists.begin[t] + 1; k < lists.begin[t + 1]; ++k)
            sorted &= rank[lists.entry[std::size_t(k) - 1].member] <
                      rank[lists.entry[std::size_t(k)].member];
    // Each slot is one entry's, and one of those of the entry's member, tile after tile.
    std::vector<Index> entry_of(std::size_t(lists.entries()), -1);
    for (Index k = 0; k < lists.entries(); ++k) {
        const std::size_t m = lists.entry[std::size_t(k)].member;
        const std::size_t slot = lists.entry[std::size_t(k)].slot;
        found &= Index(slot) >= lists.first[m] && Index(slot) < lists.first[m + 1];
        found &= entry_of[slot] == -1;
        entry_of[slot] = k;
    }
    for (std::size_t m = 0; m < std::size_t(n); ++m)
        for (Index i = lists.first[m] + 1; i < lists.first[m + 1]; ++i)
            found &= entry_of[std::size_t(i) - 1] < entry_of[std::size_t(i)];
    CHECK(sorted);
    CHECK(found);
    CHECK(lists.first.back() == lists.entries());
}
