// SPDX-License-Identifier: Apache-2.0
// accuracy [--json FILE]: errors of renders on this device, relative L2: acc2k (2000 Gaussians,
// 128 x 128) of 3 and 32 channels, every preset against the same rules in double, and against the
// exact image and its gradient; cotangents of the image and of alpha are noise. `decided` leaves
// out the pixels at which a rule decides between numbers that are within 2e-4 of each other. Then
// what each preset costs: milliseconds of a head of 100,000 Gaussians at 512 x 512, one camera, as
// a CUDA graph, and its time relative to Exact32.
#include <rye/backend/cuda/device.hpp>

#include <cstdio>

#include "../../tests/cuda/decisions.hpp"
#include "../../tests/cuda/device_render.hpp"
#include "../../tests/support/scenes.hpp"
#include "one_view.hpp"
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
    const auto g64 = converted<double>(g);
    const auto camera64 = camera.cast<double>();
    const VecX<double> background64 = VecX<double>::Zero(C);
    Columns<float> clear = Columns<float>::Ones(1, pixels);
    const auto errors = [&](const auto& rules, double(&e)[6]) {
        Cotangents w{noise<float>(C, pixels, 1), noise<float>(1, pixels, 2), {}};
        w.feature = w.feature * clear.row(0).asDiagonal();
        w.alpha = w.alpha.cwiseProduct(clear);
        const auto r =
            render_on<KernelChannels<C>>(CudaDevice(), queue, A(), g, camera, background, &w);
        const Rasterizer<std::remove_cvref_t<decltype(rules)>> plain{rules};
        const auto truth = plain.forward(ScalarBackend<Serial>{}, g64, camera64, background64);
        const Columns<double> wf = w.feature.template cast<double>(),
                              wa = w.alpha.template cast<double>();
        const auto d =
            plain.vjp(ScalarBackend<Serial>{}, g64, camera64, background64, truth, wf, &wa);
        const Columns<double> drawn =
            truth.feature.pixels * clear.template cast<double>().row(0).asDiagonal();
        e[0] = relative(Columns<float>(r.feature * clear.row(0).asDiagonal()), drawn);
        e[1] = relative(r.gradient.mean, d.mean);
        e[2] = relative(r.gradient.rotation, d.rotation);
        e[3] = relative(r.gradient.scale, d.scale);
        e[4] = relative(r.gradient.opacity, d.opacity);
        e[5] = relative(r.gradient.feature, d.feature);
    };
    const auto show = [&](const char* against, const double(&e)[6]) {
        std::printf(
            "  %-8s C=%-2d %-22s image %.1e | gradients: mean %.1e rotation %.1e scale "
            "%.1e opacity %.1e feature %.1e\n",
            name, C, against, e[0], e[1], e[2], e[3], e[4], e[5]);
        char text[512];
        std::snprintf(
            text, sizeof text,
            "%s  {\"name\": \"cuda_accuracy/%s/c:%d/%s\", \"planes\": %d, \"image\": %.3g, "
            "\"mean\": %.3g, \"rotation\": %.3g, \"scale\": %.3g, \"opacity\": %.3g, "
            "\"feature\": %.3g}",
            json.empty() ? "" : ",\n", name, C, against, C > 4 ? planes_of<A> : 0, e[0], e[1], e[2],
            e[3], e[4], e[5]);
        json += text;
    };
    double e[6];
    errors(FeaturesOnly<Exact64>(), e);
    show("exact", e);
    errors(A(), e);
    show("same rules", e);
    const auto lists =
        Rasterizer<A>().forward(ScalarBackend<Serial>{}, g64, camera64, background64);
    clear = undecided_left_out(A(), g64, camera64, lists.trace);
    errors(A(), e);
    show("same rules, decided", e);
    std::printf("  %-8s C=%-2d %.2f %% of the pixels left out\n", name, C,
                100 * (1 - double(clear.mean())));
}

/// Prints the prices of the presets.
template <int C>
void prices(cudaStream_t stream) {
    const auto scene = bench::head(100000, C);
    float exact[2] = {0, 0};
    const auto price = [&]<class A>(const char* name, A) {
        const bench::OneView v = bench::one_view<FeaturesOnly<A>, C>(stream, scene);
        const float own[2] = {v.forward.median, v.both.median};
        for (int k = 0; k < 2; ++k)
            if (exact[k] == 0) exact[k] = own[k];
        const double forward = double(own[0] / exact[0]), both = double(own[1] / exact[1]);
        std::printf("  %-14s C=%-2d forward %.3f ms (%.2f), both %.3f ms (%.2f)\n", name, C,
                    double(own[0]), forward, double(own[1]), both);
        char text[256];
        std::snprintf(text, sizeof text,
                      ",\n  {\"name\": \"cuda_price/%s/c:%d\", \"forward_ms\": %.5g, "
                      "\"graph_ms\": %.5g, \"forward_share\": %.3g, \"both_share\": %.3g}",
                      name, C, double(own[0]), double(own[1]), forward, both);
        json += text;
    };
    price("Exact32", Exact32());
    price("Tight", Tight());
    price("Balanced", Balanced());
    price("Fast", Fast());
    price("Compatible3dgs", Compatible3dgs());
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
        prices<3>(stream);
        prices<32>(stream);
    } catch (const std::exception& e) {
        std::printf("failed: %s\n", e.what());
        return 1;
    }
    return bench::write_rows(argc, argv, json);
}
