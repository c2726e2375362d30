// SPDX-License-Identifier: Apache-2.0
// kernels.cpp KERNEL: runs one kernel once on a fixed scene, within a function of that name, whose
// instructions instructions.sh has counted.
#include <cstring>

#include <rye/splat/rasterizer.hpp>

#include "../../benchmarks/scenes/head_scene.hpp"

using namespace rye;
using namespace rye::bench;

namespace {

struct Job {
    HeadScene scene;
    Rasterizer<XsimdBackend<xsimd::default_arch, Serial>, HeadRules> rasterizer = {};
    Raster<float> raster = {};
    RasterScratch<float> scratch = {};
    Gaussians<float> gradient = {};
};
Job* job = nullptr;

} // namespace

extern "C" {

[[gnu::noinline]] void splat_forward() {
    job->rasterizer.forward_into(job->scene.gaussians, job->scene.camera, job->scene.background,
                                 job->raster, &job->scratch);
}
[[gnu::noinline]] void splat_backward() {
    job->rasterizer.vjp_into(job->scene.gaussians, job->scene.camera, job->scene.background,
                             job->raster, RasterCotangent<float>{job->scene.cotangent},
                             job->gradient, &job->scratch);
}

} // extern "C"

int main(int argc, char** argv) {
    if (argc != 2) return 2;
    Job mine{head_scene(4000, std::strstr(argv[1], "32") != nullptr ? 32 : 3, 192)};
    job = &mine;
    splat_forward();
    splat_backward();
    return 0;
}
