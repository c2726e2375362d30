// SPDX-License-Identifier: Apache-2.0
// rasterizer_device: the cases of cases.hpp on a device; where there is none it says so.
#include "on_device.hpp"

#include "cases.hpp"
#include "jvp_cases.hpp"

#include <rye/geometry/distortion.hpp>
#include <rye/splat/cuda/sh_color.hpp>

using namespace rye;
using namespace rye::test;

using Three = KernelChannels<3>;

TEST_CASE("device: any number of channels") {
    for (const Index c : {1, 2, 3, 4, 7, 8, 16, 31, 32, 33}) // from 5 on products of two planes
        against<double, detail::AnyChannels>(CudaDevice(), queue(), random_scene<float>(200, c, 5),
                                             Balanced(), {2e-6, c > 4 ? 2e-5 : 1e-5, 1e-5});
}
TEST_CASE("device: presets and rules") {
    const Scenery<float> s = random_scene<float>(200, 3, 5), wide = random_scene<float>(200, 32, 5);
    against<float, Three>(CudaDevice(), queue(), s, Fast());
    against<float, Three>(CudaDevice(), queue(), s, Compatible3dgsFloor());
    against<double, KernelChannels<3, 32>>(CudaDevice(), queue(), s, Exact32());
    against<double, KernelChannels<3, 32>>(CudaDevice(), queue(), wide, Exact32());
}
TEST_CASE("device: Fast where its rules decide clearly") {
    fast_where_decided<Three>(CudaDevice(), queue(), 3);
    fast_where_decided<KernelChannels<32>>(CudaDevice(), queue(), 32);
}
TEST_CASE("device: hard scenes") {
    for (const auto& s : hard_scenes<float>(3))
        against<float, Three>(CudaDevice(), queue(), s, Balanced(), {2e-6, 2e-5, 2e-2});
}
TEST_CASE("device: lists equal the host's") {
    for (const auto& s : hard_scenes<float>(3)) lists_equal<Balanced>(CudaDevice(), queue(), s);
    lists_equal<Balanced>(CudaDevice(), queue(), random_scene<float>(3000, 3, 5));
    lists_equal<Balanced>(CudaDevice(), queue(), crowded(5000, true));
}
TEST_CASE("device: derivatives in directions") {
    for (const Index c : {1, 2, 3, 4, 7, 16, 32, 33})
        jvp_against<double, detail::AnyChannels>(CudaDevice(), queue(),
                                                 random_scene<float>(200, c, 5), Balanced(), 5);
    jvp_against<float, Three>(CudaDevice(), queue(), random_scene<float>(200, 3, 5),
                              Compatible3dgsFloor(), 3);
    for (const auto& s : hard_scenes<float>(3))
        jvp_against<float, Three>(CudaDevice(), queue(), s, Balanced(), 2);
    bad_directions(CudaDevice(), queue());
}
TEST_CASE("device: crowded tiles") {
    against<double, Three>(CudaDevice(), queue(), crowded(5000, false), Balanced());
    against<double, Three>(CudaDevice(), queue(), crowded(5000, true), Balanced());
}
TEST_CASE("device: lists in several passes") {
    in_passes<Three>(CudaDevice(), queue(), random_scene<float>(5000, 3, 5));
    in_passes<Three>(CudaDevice(), queue(), tall(1000, 3));
}

TEST_CASE("device: tall Gaussians") {
    lists_equal<Balanced>(CudaDevice(), queue(), tall(1000, 3));
    against<double, Three>(CudaDevice(), queue(), tall(200, 3), Balanced());
}
TEST_CASE("device: features as halves") {
    halves_drawn<Three>(CudaDevice(), queue(), 3);
    halves_drawn<KernelChannels<16>>(CudaDevice(), queue(), 16);
    halves_drawn<KernelChannels<32>>(CudaDevice(), queue(), 27);
}
TEST_CASE("device: a frame without a vjp") {
    without_vjp<Three>(CudaDevice(), queue(), 3);
    without_vjp<KernelChannels<32>>(CudaDevice(), queue(), 32);
}
TEST_CASE("device: bad input") { bad_input(CudaDevice(), queue()); }
TEST_CASE("device: a tile of 1e5 entries, and of 1e5 equal depths") {
    // 1e5 in the plain loops' float: both take the nearest alone, by the stop rule.
    for (const bool tied : {false, true})
        against<float, Three>(CudaDevice(), queue(), crowded(100000, tied), Balanced(),
                              {1e-5, 1e-4, 1e-3});
    lists_equal<Balanced>(CudaDevice(), queue(), crowded(100000, true));
}
TEST_CASE("device: too little memory") { too_little_memory(CudaDevice(), queue()); }
TEST_CASE("device: too little room") { too_little_room(CudaDevice(), queue()); }
TEST_CASE("device: contributors") { contributors(CudaDevice(), queue()); }
TEST_CASE("device: equal colours have no gradient of shape") {
    equal_colours<Three>(CudaDevice(), queue(), 3);
    equal_colours<KernelChannels<32>>(CudaDevice(), queue(), 32);
}
TEST_CASE("device: a lens that bends") {
    const Scenery<float> s = random_scene<float>(150, 3, 71);
    BrownConrady<float> lens;
    lens.k1 = -0.1F;
    lens.p1 = 0.01F;
    const auto camera = with_lens(s.camera, lens);
    const Index pixels = Index(camera.width) * camera.height;
    const Cotangents w{noise<float>(3, pixels, 1), {}, {}};
    const auto r =
        render_on<Three>(CudaDevice(), queue(), Balanced(), s.gaussians, camera, s.background, &w);
    const Rasterizer<Balanced> plain;
    const auto truth = plain.forward(ScalarBackend<Serial>{}, s.gaussians, camera, s.background);
    CHECK(relative(r.feature, truth.feature.pixels) < 1e-5);
    CHECK(relative(r.gradient, plain.vjp(ScalarBackend<Serial>{}, s.gaussians, camera, s.background,
                                         truth, w.feature)) < 2e-5);
}
TEST_CASE_TEMPLATE("device: the same bits again, beside a busy stream, elsewhere in memory", Kernels,
                   Three, KernelChannels<32>) {
    const Index channels = Kernels::largest;
    const Scenery<float> s = random_scene<float>(3000, channels, 5);
    const Index pixels = Index(s.camera.width) * s.camera.height;
    const Cotangents w{noise<float>(channels, pixels, 1), noise<float>(1, pixels, 2), {}};
    const auto once = render_on<Kernels>(CudaDevice(), queue(), Balanced(), s.gaussians, s.camera,
                                         s.background, &w);
    cudaStream_t other;
    check_cuda(cudaStreamCreate(&other), "test");
    void* load = nullptr;
    check_cuda(cudaMalloc(&load, std::size_t(1) << 30U), "test");
    for (int k = 0; k < 100; ++k) {
        check_cuda(cudaMemsetAsync(load, k, (std::size_t(1) << 30U) - std::size_t(k) * 4096, other),
                   "test");
        void* moved = nullptr;
        check_cuda(cudaMallocAsync(&moved, std::size_t(k + 1) * 100000, queue().stream), "test");
        const auto r = render_on<Kernels>(CudaDevice(), queue(), Balanced(), s.gaussians,
                                          s.camera, s.background, &w);
        check_cuda(cudaFreeAsync(moved, queue().stream), "test");
        REQUIRE(r.feature == once.feature);
        REQUIRE(r.gradient.mean == once.gradient.mean);
        REQUIRE(r.gradient.rotation == once.gradient.rotation);
        REQUIRE(r.gradient.scale == once.gradient.scale);
        REQUIRE(r.gradient.opacity == once.gradient.opacity);
        REQUIRE(r.gradient.feature == once.gradient.feature);
    }
    check_cuda(cudaStreamSynchronize(other), "test");
    check_cuda(cudaFree(load), "test");
    check_cuda(cudaStreamDestroy(other), "test");
}
TEST_CASE("device: a graph gives the bits of single launches") {
    const Scenery<float> s = random_scene<float>(2000, 3, 5);
    const CudaDevice device;
    const DeviceRasterizer<Fast, CudaDevice, Three> rasterizer;
    const DeviceCloud<CudaDevice> cloud(device, queue(), s.gaussians),
        out(device, queue(), 2000, 3);
    const Index pixels = Index(s.camera.width) * s.camera.height;
    const DeviceArray<CudaDevice> bg(device, queue(), Columns<float>(s.background)),
        w(device, queue(), noise<float>(3, pixels, 1)), feature(device, queue(), 3, pixels),
        alpha(device, queue(), 1, pixels), depth(device, queue(), 1, pixels);
    DeviceFrame<CudaDevice> frame(device);
    const auto step = [&] {
        rasterizer.forward_into(queue(), cloud.view(), s.camera, bg.buffer.data(),
                                {feature.view(), alpha.view(), depth.view()}, frame);
        rasterizer.vjp_into(queue(), cloud.view(), s.camera, bg.buffer.data(), {w.read()},
                            out.view(), frame);
    };
    do step();
    while (!frame.finish(queue()));
    const Columns<float> image = feature.get();
    const Gaussians<float> gradient = out.get();
    cudaGraph_t graph;
    cudaGraphExec_t exec;
    check_cuda(cudaStreamBeginCapture(queue().stream, cudaStreamCaptureModeThreadLocal), "test");
    step();
    check_cuda(cudaStreamEndCapture(queue().stream, &graph), "test");
    check_cuda(cudaGraphInstantiate(&exec, graph, 0), "test");
    for (int k = 0; k < 10; ++k) check_cuda(cudaGraphLaunch(exec, queue().stream), "test");
    CHECK(feature.get() == image);
    CHECK(out.get().mean == gradient.mean);
    CHECK(out.get().feature == gradient.feature);
}

namespace {

__global__ void fault() { __trap(); }

/// Ends the context, and with it this process's use of the device.
int lose_context() {
    const Scenery<float> s = random_scene<float>(50, 3, 5);
    fault<<<1, 1, 0, queue().stream>>>();
    try {
        render_on<Three>(CudaDevice(), queue(), Balanced(), s.gaussians, s.camera, s.background);
    } catch (const Error& e) {
        std::puts(e.what());
        return std::string(e.what()).find("context is lost") != std::string::npos ? 0 : 1;
    }
    std::puts("a render after the fault raised no error");
    return 1;
}

} // namespace

// rasterizer_device [lost]: the second shows what a lost context raises.
int main(int argc, char** argv) {
    if (argc == 2 && std::string(argv[1]) == "lost")
        return on_device("rasterizer_device", lose_context);
    return cases_on_device("rasterizer_device", argc, argv);
}
