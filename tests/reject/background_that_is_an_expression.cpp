// SPDX-License-Identifier: Apache-2.0
// Eigen's Zero(3) is an expression: no scalar can be deduced from it.
// expect: the background is no VecX, expected
// lines: 7
#include <rye/splat/rasterizer.hpp>

rye::Raster<float> draw(const rye::Gaussians<float>& g, const rye::Pinhole<float>& camera) {
    const rye::Rasterizer rasterizer;
#if REJECT
    return rasterizer.forward(rye::ScalarBackend{}, g, camera, rye::VecX<float>::Zero(3));
#else
    const rye::VecX<float> black = rye::VecX<float>::Zero(3);
    return rasterizer.forward(rye::ScalarBackend{}, g, camera, black);
#endif
}
