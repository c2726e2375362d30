// SPDX-License-Identifier: Apache-2.0
// Counts of what a render blends: by pixels, by tiles, and as the yardstick counts it.
#include <doctest/doctest.h>

#include <vector>

#include <rye/splat/rasterizer.hpp>

#include "../naive/adapter.hpp"
#include "../scenes/head_scene.hpp"
#include "count.hpp"

using namespace rye;
using namespace rye::bench;

TEST_CASE("count: blocks are as square as their pixels allow") {
    const auto sides = [](int lanes) {
        const Block b = Block::of(lanes);
        return std::vector<int>{b.wide, b.high};
    };
    CHECK(sides(1) == std::vector<int>{1, 1});
    CHECK(sides(4) == std::vector<int>{2, 2});
    CHECK(sides(8) == std::vector<int>{4, 2});
    CHECK(sides(16) == std::vector<int>{4, 4});
}

TEST_CASE("count: pairs, blocks and entries of the head") {
    const HeadScene head = head_scene(3000, 3, 120);    // the last tiles are cut
    const Rasterizer<HeadRules> rasterizer;
    const auto r =
        rasterizer.forward(ScalarBackend<Serial>{}, head.gaussians, head.camera, head.background);
    const Scene<float> scene{r.trace,        head.gaussians, head.background,    head.camera.cx,
                             head.camera.cy, head.camera.width, head.camera.height};
    const auto count = [&](Block b) { return count_blends(scene, rasterizer.accuracy, b); };
    const BlendCount pixels = count({1, 1}), squares = count({4, 4}), tiles = count({16, 16});

    CHECK(pixels.pairs > 10000);
    CHECK(pixels.blocks == pixels.pairs);
    CHECK(tiles.blocks == tiles.touched);
    CHECK(squares.pairs == pixels.pairs);
    CHECK(squares.touched == tiles.touched);
    CHECK(squares.blocks < pixels.blocks);
    CHECK(squares.blocks > pixels.pairs / 16);
    CHECK(squares.blocks > tiles.blocks);
    CHECK(tiles.touched <= static_cast<double>(r.trace.lists.entries()));

    naive::Rasterizer yardstick;
    std::vector<float> image;
    yardstick.forward(naive_cloud(head.gaussians), naive_camera(head.camera), 3, image);
    CHECK(pixels.pairs ==
          doctest::Approx(static_cast<double>(yardstick.blended)).epsilon(1e-3));
}
