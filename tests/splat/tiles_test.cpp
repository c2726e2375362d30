// SPDX-License-Identifier: Apache-2.0
// Bounds against brute force: no pixel within a Gaussian's footprint is missed, for ellipses of
// every size and needles.
#include <rye/splat/tiles.hpp>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>
#include <rye/splat/tile_lists.hpp>

using namespace rye;

TEST_CASE("tiles: depth keys order as depths do, in float and in double") {
    const Random random{2, 1};
    const double special[] = {-1e30, -1.0, -1e-45, -0.0, 0.0, 1e-45, 1e-38, 0.9, 1.0, 1e30};
    for (const double a : special)
        for (const double b : special) {
            if (a < b && float(a) < float(b))
                CHECK(detail::depth_key(float(a)) < detail::depth_key(float(b)));
            if (a < b) CHECK(detail::depth_key(a) < detail::depth_key(b));
        }
    for (std::uint64_t i = 0; i < 100000; ++i) {
        const double a = random.normal(2 * i), b = random.normal(2 * i + 1);
        if ((a < b) != (detail::depth_key(a) < detail::depth_key(b))) FAIL("order");
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
        f.covariance = detail::gram(x, y, 0.3F);
        f.determinant = detail::gram_determinant(x, y, 0.3F);
        const detail::PrecisionFactor<float> form = detail::precision_factor(x, y, 0.3F);

        const Cover<Support::ellipse, float> cover{f, width, height};
        const Span rows = cover.rows();
        TileLists lists;
        detail::BinScratch<std::uint32_t> scratch;
        lists.build<Support::ellipse, float>(
            Serial{}, {width, height},
            detail::BinInput{rows.begin < rows.end ? 1 : 0, [&](Index) {
            return rows; },
                     [](Index) {
            return 0U; }, [](Index m) {
            return m; },
                     [&](Index) -> const auto& { return f;
    }
},
            1000000, scratch);
        listed += lists.entries();
        for (Index t = 0; t < lists.tiles(); ++t) {
            const bool in_list = lists.begin[std::size_t(t)] < lists.begin[std::size_t(t) + 1];
            bool hit = false;
            for (int p = 0; p < detail::tile_pixels; ++p) {
                const int px = int(t % lists.columns) * detail::tile_edge + p % detail::tile_edge;
                const int py = int(t / lists.columns) * detail::tile_edge + p / detail::tile_edge;
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
