// SPDX-License-Identifier: Apache-2.0
// accuracy [--json FILE]: errors of renders on this device, relative L2: acc2k (2000 Gaussians,
// 128 x 128) of 3 and 32 channels, every preset against the same rules in double, and against the
// exact image and its gradient; cotangents of the image and of alpha are noise.
#include <rye/backend/cuda/device.hpp>

#include <cstdio>

#include "../../tests/cuda/device_render.hpp"
#include "../../tests/splat/scenes.hpp"
#include "scenes.hpp"

namespace {

using namespace rye;
using namespace rye::test;

std::string json;

template <class A, int C>
void row(const char* name, const CudaQueue& queue, const bench::DeviceScenery& s) {
    const Gaussians<float>& g = s.gaussians;
    const Pinhole<float>& camera = s.cameras[1];
    const Index pixels = Index(camera.width) * camera.height;
    const VecX<float> background = VecX<float>::Zero(C);
    const Cotangents w{noise<float>(C, pixels, 1), noise<float>(1, pixels, 2), {}};
    const auto r =
        render_on<KernelChannels<C>>(CudaDevice(), queue, A(), g, camera, background, &w);
    const auto g64 = converted<double>(g);
    const auto camera64 = camera.cast<double>();
    const VecX<double> background64 = VecX<double>::Zero(C);
    const Columns<double> wf = w.feature.cast<double>(), wa = w.alpha.cast<double>();
    const auto against = [&](const auto& rules, double(&e)[6]) {
        const Rasterizer<std::remove_cvref_t<decltype(rules)>> plain{rules};
        const auto truth = plain.forward(ScalarBackend<Serial>{}, g64, camera64, background64);
        const auto d =
            plain.vjp(ScalarBackend<Serial>{}, g64, camera64, background64, truth, wf, &wa);
        e[0] = relative(r.feature, truth.feature.pixels);
        e[1] = relative(r.gradient.mean, d.mean);
        e[2] = relative(r.gradient.rotation, d.rotation);
        e[3] = relative(r.gradient.scale, d.scale);
        e[4] = relative(r.gradient.opacity, d.opacity);
        e[5] = relative(r.gradient.feature, d.feature);
    };
    double same[6], exact[6];
    against(A(), same);
    against(FeaturesOnly<Exact64>(), exact);
    std::printf(
        "%-10s C=%-2d planes %d | same rules: image %.1e, mean %.1e rotation %.1e scale %.1e "
        "opacity %.1e feature %.1e | exact: image %.1e, mean %.1e rotation %.1e scale %.1e\n",
        name, C, C > 4 ? planes_of<A> : 0, same[0], same[1], same[2], same[3], same[4], same[5],
        exact[0], exact[1], exact[2], exact[3]);
    char text[512];
    std::snprintf(text, sizeof text,
                  "%s  {\"name\": \"cuda_accuracy/%s/c:%d\", \"image\": %.3g, \"mean\": %.3g, "
                  "\"rotation\": %.3g, \"scale\": %.3g, \"opacity\": %.3g, \"feature\": %.3g, "
                  "\"image_exact\": %.3g, \"mean_exact\": %.3g}",
                  json.empty() ? "" : ",\n", name, C, same[0], same[1], same[2], same[3], same[4],
                  same[5], exact[0], exact[1]);
    json += text;
}

} // namespace

int main(int argc, char** argv) {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
        std::puts("cuda_accuracy: skipped, no device is there");
        return 0;
    }
    try {
        cudaStream_t stream;
        check_cuda(cudaStreamCreate(&stream), "stream");
        StreamMemory memory;
        const CudaQueue queue{stream, memory};
        const auto few = bench::head(2000, 3, 128, 215, 3003, 0.05);
        const auto many = bench::head(2000, 32, 128, 215, 3003, 0.05);
        row<FeaturesOnly<Exact32>, 3>("Exact32", queue, few);
        row<FeaturesOnly<Balanced>, 3>("Balanced", queue, few);
        row<FeaturesOnly<Fast>, 3>("Fast", queue, few);
        row<FeaturesOnly<Exact32>, 32>("Exact32", queue, many);
        row<FeaturesOnly<Balanced>, 32>("Balanced", queue, many);
        row<FeaturesOnly<Fast>, 32>("Fast", queue, many);
    } catch (const std::exception& e) {
        std::printf("failed: %s\n", e.what());
        return 1;
    }
    if (argc == 3 && std::string(argv[1]) == "--json") {
        std::FILE* const f = std::fopen(argv[2], "w");
        std::fprintf(f, "{\"benchmarks\": [\n%s\n]}\n", json.c_str());
        std::fclose(f);
    }
    return 0;
}
