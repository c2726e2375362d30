// SPDX-License-Identifier: Apache-2.0
// A render whose background was forgotten.
// expect: an argument is missing, expected .*background
// lines: 7
#include <rye/splat/rasterizer.hpp>

rye::Raster<float> draw(const rye::Gaussians<float>& g, const rye::Pinhole<float>& camera,
                        [[maybe_unused]] const rye::VecX<float>& background) {
    const rye::Rasterizer rasterizer;
#if REJECT
    return rasterizer.forward(rye::ScalarBackend<>{}, g, camera);
#else
    return rasterizer.forward(rye::ScalarBackend<>{}, g, camera, background);
#endif
}
