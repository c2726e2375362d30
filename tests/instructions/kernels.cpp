// SPDX-License-Identifier: Apache-2.0
// kernels.cpp KERNEL: runs one kernel once on a fixed scene, within a function of that name, whose
// instructions instructions.sh counts.
#include <cstring>

#include <rye/nn/mlp.hpp>
#include <rye/splat/lanes.hpp>

#include "../../benchmarks/scenes/head_scene.hpp"

using namespace rye;
using namespace rye::bench;

namespace {

using Lanes = XsimdBackend<DefaultArch, Serial>;

struct Job {
    HeadScene scene;
    Rasterizer<HeadRules> rasterizer = {};
    Raster<float, HeadRules::outputs> raster = {};
    RasterScratch<float> scratch = {};
    Gaussians<float> gradient = {};
};
Job* job = nullptr;

/// The colours of a small avatar: 32 numbers a point, 20 a frame.
struct Network {
    Mlp<float> mlp = Mlp<float>::init({{52, 64, 64, 8}, 20}, Random{1, 1});
    Mlp<float> gradient{mlp.shape};
    Columns<float> points = Columns<float>::Constant(32, 2000, 0.1F), g_points;
    VecX<float> frame = VecX<float>::Constant(20, 0.2F);
    MlpTrace<float> trace;
    Columns<float> out;
};
Network* network = nullptr;

} // namespace

extern "C" {

[[gnu::noinline]] void splat_forward() {
    job->rasterizer.forward_into(Lanes{}, job->scene.gaussians, job->scene.camera,
                                 job->scene.background, job->raster, &job->scratch);
}
[[gnu::noinline]] void splat_backward() {
    job->rasterizer.vjp_into(
        Lanes{}, job->scene.gaussians, job->scene.camera, job->scene.background, job->raster,
        RasterCotangent<float>{job->scene.cotangent}, job->gradient, &job->scratch);
}

[[gnu::noinline]] void mlp_forward() {
    network->out =
        rye::mlp_forward(Lanes{}, network->mlp, network->points, network->frame, &network->trace);
}
[[gnu::noinline]] void mlp_backward() {
    mlp_vjp(Lanes{}, network->mlp, {network->points, network->frame, network->trace}, network->out,
            {network->gradient, &network->g_points});
}

} // extern "C"

int main(int argc, char** argv) {
    if (argc != 2) return 2;
    if (std::strstr(argv[1], "mlp") != nullptr) {
        Network mine;
        network = &mine;
        ::mlp_forward();
        ::mlp_backward();
        return 0;
    }
    Job mine{head_scene(4000, std::strstr(argv[1], "32") != nullptr ? 32 : 3, 192)};
    job = &mine;
    splat_forward();
    splat_backward();
    return 0;
}
