// SPDX-License-Identifier: Apache-2.0
// A user's own accuracy policy, one knob of which has the wrong type.
// expect: AccuracyPolicy
#include <rye/splat/rasterizer.hpp>

struct Preview : rye::Balanced {
#if REJECT
    const char* stop = "early";
#else
    double stop = 0.01;
#endif
};

rye::Raster<float> draw(const rye::Gaussians<float>& g, const rye::Pinhole<float>& camera,
                        const rye::VecX<float>& background) {
    return rye::Rasterizer<Preview>{}.forward(rye::ScalarBackend<>{}, g, camera, background);
}
