// SPDX-License-Identifier: Apache-2.0
/// benchmarks/splatting/count.hpp: what a render blends, counted by plain loops.
#pragma once

#include <cstddef>
#include <vector>

#include <rye/splat/plain/forward.hpp>

namespace rye::bench {

/// A rectangle of pixels that share a vector [px].
struct Block {
    int wide, high;

    /// Makes one of as many pixels as there are lanes, as square as they can be.
    static constexpr Block of(int lanes) {
        Block b{1, 1};
        while (b.wide * b.high < lanes) (b.wide > b.high ? b.high : b.wide) *= 2;
        return b;
    }
};

/// Counts of what a render blended.
struct BlendCount {
    double pairs = 0;        ///< of a pixel and a Gaussian
    double blocks = 0;       ///< of a block and an entry of its tile, with a blended pixel
    double touched = 0;      ///< entries with a blended pixel
};

/// Counts what `accuracy` blends of a scene whose lists are made; blocks are aligned within a tile.
template <class A>
BlendCount count_blends(const Scene<float>& scene, const A& accuracy, Block block) {
    BlendCount n;
    std::vector<int> last;   // of each entry of a tile: the block that blended it last
    for (Index t = 0; t < scene.trace.lists.tiles(); ++t) {
        const int left = scene.left(t), top = scene.top(t);
        const int right = scene.right(t), bottom = scene.bottom(t);
        last.assign(static_cast<std::size_t>(scene.end(t) - scene.begin(t)), -1);
        int here = 0;
        for (int y0 = top; y0 < bottom; y0 += block.high)
            for (int x0 = left; x0 < right; x0 += block.wide, ++here)
                for (int y = y0; y < std::min(bottom, y0 + block.high); ++y)
                    for (int x = x0; x < std::min(right, x0 + block.wide); ++x)
                        walk_pixel(scene, accuracy, {t, x, y}, [&](const auto& c) {
                            int& l = last[static_cast<std::size_t>(c.entry - scene.begin(t))];
                            ++n.pairs;
                            n.touched += l < 0;
                            n.blocks += l != here;
                            l = here;
                        });
    }
    return n;
}

} // namespace rye::bench
