// SPDX-License-Identifier: Apache-2.0
// Gaussians in double and a camera in float would round silently somewhere in between.
// expect: camera and background have different scalars
#include <rye/splat/rasterizer.hpp>

rye::Raster<double> draw(const rye::Gaussians<double>& g, const rye::Pinhole<float>& camera,
                         const rye::VecX<double>& background) {
    const rye::Rasterizer<> rasterizer;
#if REJECT
    return rasterizer.forward(rye::ScalarBackend<>{}, g, camera, background);
#else
    return rasterizer.forward(rye::ScalarBackend<>{}, g, camera.cast<double>(), background);
#endif
}
