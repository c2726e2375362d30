// SPDX-License-Identifier: Apache-2.0
// An accuracy policy that has one member of Balanced: the error names the first that is missing.
// expect: alpha_max
// lines: 13
#include <rye/splat/rasterizer.hpp>

#if REJECT
struct Own {
    double alpha_min = 1e-3;
};
#else
struct Own : rye::Balanced {};
#endif

rye::Raster<float> draw(const rye::Gaussians<float>& g, const rye::Pinhole<float>& camera,
                        const rye::VecX<float>& background) {
    return rye::Rasterizer<Own>{}.forward(rye::ScalarBackend<>{}, g, camera, background);
}
