// SPDX-License-Identifier: Apache-2.0
// A render without depth has no image of it.
// expect: Without<.*rye::DepthImage
#include <rye/splat/rasterizer.hpp>

struct Lean : rye::Balanced {
#if REJECT
    static constexpr rye::Outputs outputs = {.depth = false, .contributor = false};
#endif
};

float farthest(const rye::Rasterizer<Lean>::Drawn<float>& picture) {
    return picture.depth.pixels.maxCoeff();
}
