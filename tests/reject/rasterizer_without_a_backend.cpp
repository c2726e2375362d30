// SPDX-License-Identifier: Apache-2.0
// There is a default backend only where a header of lanes is included.
// expect: no default Backend, expected
// lines: 7
#include <rye/splat/rasterizer.hpp>

rye::Raster<float> draw(const rye::Gaussians<float>& g, const rye::Pinhole<float>& camera,
                        const rye::VecX<float>& background) {
    const rye::Rasterizer rasterizer;
#if REJECT
    return rasterizer.forward(g, camera, background);
#else
    return rasterizer.forward(rye::ScalarBackend{}, g, camera, background);
#endif
}
