// SPDX-License-Identifier: Apache-2.0
// head.cpp: the timed head (benchmarks/scenes/head_scene.hpp) in WebAssembly, by the default policy
// on one thread, for times.js to call.
#include <memory>

#include <emscripten/emscripten.h>

#include <rye/splat/lanes.hpp>

#include "../../scenes/head_scene.hpp"

namespace {

using namespace rye;
using namespace rye::bench;
using OneThread = XsimdBackend<DefaultArch, Serial>;

struct Head {
    HeadScene scene;
    Rasterizer<FeaturesOnly<Balanced>> rasterizer = {};
    Raster<float, features_only> raster = {};
    RasterScratch<float> scratch = {};
    Gaussians<float> gradient = {};
};
std::unique_ptr<Head> head;

} // namespace

extern "C" {

EMSCRIPTEN_KEEPALIVE void head_make(int count, int channels) {
    head = std::make_unique<Head>(Head{head_scene(count, channels)});
}
EMSCRIPTEN_KEEPALIVE void head_forward() {
    const HeadScene& s = head->scene;
    head->rasterizer.forward_into(OneThread{}, s.gaussians, s.camera, s.background, head->raster,
                                  &head->scratch);
}
/// After head_forward.
EMSCRIPTEN_KEEPALIVE void head_backward() {
    const HeadScene& s = head->scene;
    head->rasterizer.vjp_into(OneThread{}, s.gaussians, s.camera, s.background, head->raster,
                              RasterCotangent<float>{s.cotangent}, head->gradient, &head->scratch);
}

} // extern "C"
