// SPDX-License-Identifier: Apache-2.0
// The accuracy of a rasterizer is a policy, all of whose knobs are known; not a tolerance.
// expect: AccuracyPolicy
#include <rye/splat/rasterizer.hpp>

#if REJECT
using Accuracy = float;
#else
using Accuracy = rye::Tight;
#endif

rye::Raster<float> draw(const rye::Gaussians<float>& g, const rye::Pinhole<float>& camera,
                        const rye::VecX<float>& background) {
    return rye::Rasterizer<rye::ScalarBackend<>, Accuracy>{}.forward(g, camera, background);
}
