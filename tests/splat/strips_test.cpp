// SPDX-License-Identifier: Apache-2.0
// Division of a tile into strips, and the entries that each strip may intersect.
#include <rye/splat/lanes.hpp>

#include <memory>
#include <vector>

#include <doctest/doctest.h>

#include "../support/array_lanes.hpp"
#include "../support/scenes.hpp"

using namespace rye;
using namespace rye::test;

namespace {

template <class T>
using Batch = xsimd::batch<T, DefaultArch>;

/// Vectors of this machine, and of every width by arrays.
#define EVERY_VECTOR                                                                             \
    Batch<float>, Batch<double>, ArrayLanes<float, 4>, ArrayLanes<float, 8>,                     \
        ArrayLanes<float, 16>, ArrayLanes<double, 2>, ArrayLanes<double, 4>, ArrayLanes<double, 8>

struct Met {
    int needed = 0, said = 0;            ///< pairs of a strip and an entry: needed, and found
};

/// Every pixel within an entry's footprint must lie in a strip found to intersect it.
template <class V>
Met check_reach(const Scenery<typename V::value_type>& s) {
    using T = typename V::value_type;
    using Tile = detail::Strips<V>;
    using Group = detail::LaneGroup<V>;
    const Rasterizer<> rasterizer;
    const auto raster = rasterizer.forward(XsimdBackend<>{}, s.gaussians, s.camera, s.background);
    const auto scene = rasterizer.scene_of(s.gaussians, s.camera, s.background, raster.trace);
    const auto group = std::make_unique<Group>();
    Met met;
    int missed = 0;
    for (Index t = 0; t < raster.trace.lists.tiles(); ++t)
        for (Index first = scene.begin(t); first < scene.end(t); first += Group::most) {
            const Tile strips(scene, t);
            const Index last = std::min<Index>(scene.end(t), first + Group::most);
            group->template fill<0>(scene, strips, scene.top(t), first, last, [](Index) {});
            for (Index k = first; k < last; ++k) {
                const VisibleGaussian<T>& m = scene.member(k);
                std::vector<bool> reached(Tile::count);
                for (int y = 0; y < strips.height; ++y)
                    for (int x = 0; x < strips.width; ++x) {
                        const T px = T(scene.left(t) + x) + T(0.5) - scene.cx;
                        const T py = T(scene.top(t) + y) + T(0.5) - scene.cy;
                        const int row = scene.top(t) + y;
                        if (row < m.rows.begin || row >= m.rows.end) continue;
                        const T e = respond(m.splat, T(px - m.splat.x), T(py - m.splat.y)).exponent;
                        if (e >= m.splat.cut) reached[std::size_t(Tile::strip(x, y))] = true;
                    }
                for (int strip = 0; strip < Tile::count; ++strip) {
                    const bool says = (group->reaching[strip] >> (k - first) & 1U) != 0;
                    missed += reached[std::size_t(strip)] && !says ? 1 : 0;
                    met.needed += reached[std::size_t(strip)] ? 1 : 0;
                    met.said += says ? 1 : 0;
                }
            }
        }
    CHECK_MESSAGE(missed == 0, s.name);
    return met;
}

} // namespace

TEST_CASE_TEMPLATE("a tile's pixels are each a lane of one strip", V, EVERY_VECTOR) {
    using T = typename V::value_type;
    using Tile = detail::Strips<V>;
    const auto s = random_scene<T>(40, 3, 1);
    const Rasterizer<> rasterizer;
    const auto raster = rasterizer.forward(XsimdBackend<>{}, s.gaussians, s.camera, s.background);
    const auto scene = rasterizer.scene_of(s.gaussians, s.camera, s.background, raster.trace);
    for (const Index tile : {Index(0), raster.trace.lists.tiles() - 1}) {  // a whole one, a corner
        const Tile strips(scene, tile);
        const detail::StripMask inside = strips.inside(detail::all_strips);
        std::vector<T> start(detail::tile_pixels);
        strips.start(detail::all_strips, start.data(), Tile::lanes);
        std::vector<int> times(detail::tile_pixels);
        for (int y = 0; y < detail::tile_edge; ++y)
            for (int x = 0; x < detail::tile_edge; ++x) {
                const int strip = Tile::strip(x, y), lane = Tile::lane(x, y);
                const auto at = std::size_t(strip * Tile::lanes + lane);
                ++times[at];
                const bool drawn = x < strips.width && y < strips.height;
                CHECK(start[at] == (drawn ? T(1) : T(0)));
                if (drawn) CHECK(inside.has(strip));
                alignas(64) T px[Tile::lanes], py[Tile::lanes];
                Tile::along_rows(strips.x, Tile::side(strip)).store_aligned(px);
                Tile::down_rows(strips.y, Tile::row(strip)).store_aligned(py);
                CHECK(px[lane] == T(scene.left(tile) + x) + T(0.5) - s.camera.cx);
                CHECK(py[lane] == T(scene.top(tile) + y) + T(0.5) - s.camera.cy);
            }
        for (const int n : times) CHECK(n == 1);
        for (int strip = 0; strip < detail::StripMask::most; ++strip)
            if (inside.has(strip)) {
                REQUIRE(strip < Tile::count);
                CHECK(start[std::size_t(strip * Tile::lanes)] == T(1));
            }
    }
}

TEST_CASE_TEMPLATE("a mask's lanes are its bits", V, EVERY_VECTOR) {
    using T = typename V::value_type;
    constexpr int lanes = int(V::size);
    alignas(64) T x[lanes];
    for (int shown = 0; shown < (1 << lanes); shown += 1 + shown / 7) {
        for (int i = 0; i < lanes; ++i) x[i] = (shown >> i & 1) != 0 ? T(2) : T(-2);
        CHECK(detail::lane_bits(V::load_aligned(x) > V(T(0))) == std::uint64_t(shown));
    }
}

TEST_CASE_TEMPLATE("strips meet every entry that reaches a pixel, and few others", V,
                   EVERY_VECTOR) {
    using T = typename V::value_type;
    Met all;
    for (std::uint64_t seed = 0; seed < 4; ++seed)
        for (const double size : {0.01, 0.08, 0.4}) {
            const Met met = check_reach<V>(random_scene<T>(200, 1, seed, size));
            all.needed += met.needed;
            all.said += met.said;
        }
    // An entry may pass between the pixels of a strip.
    MESSAGE("strips named over strips reached: " << double(all.said) / all.needed);
    CHECK(all.said < 1.2 * all.needed);
    for (const auto& s : hard_scenes<T>(1)) check_reach<V>(s);
}
