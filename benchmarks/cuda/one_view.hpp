// SPDX-License-Identifier: Apache-2.0
/// one_view.hpp: times of a render and of its vjp from one camera, its memory and its lists.
#pragma once

#include <map>

#include <rye/splat/cuda/rasterizer.hpp>

#include "../../tests/cuda/device_render.hpp"
#include "../../tests/support/scenes.hpp"
#include "scenes.hpp"
#include "timing.hpp"

namespace rye::bench {

/// Times of a scene's first camera; milliseconds of graphs.
struct OneView {
    Times forward, both;
    double entries = 0; ///< pairs of a tile and a Gaussian
    double held = 0;    ///< memory of the frame [bytes]
    double formula = 0; ///< what DeviceFrameShape::bytes() says of the room that it has
    double asked = 0;   ///< what was taken from the device's memory meanwhile [bytes]
};

/// CUDA's pool, which counts.
struct CountedMemory {
    StreamMemory pool;
    double held = 0;
    std::map<void*, std::size_t> sizes = {};

    void* allocate(std::size_t bytes, CudaStream stream) {
        void* const p = pool.allocate(bytes, stream);
        sizes[p] = bytes;
        held += static_cast<double>(bytes);
        return p;
    }
    void release(void* p, CudaStream stream) {
        held -= static_cast<double>(sizes[p]);
        sizes.erase(p);
        pool.release(p, stream);
    }
};

/// By the rules of A, C channels.
template <class A, int C>
OneView one_view(cudaStream_t stream, const DeviceScenery& scene) {
    CountedMemory memory;
    const CudaQueue queue{stream, memory};
    const CudaDevice device;
    const Gaussians<float>& g = scene.gaussians;
    const Pinhole<float>& camera = scene.cameras.front();
    const Index n = g.count(), pixels = Index(camera.width) * camera.height;
    const test::DeviceCloud<CudaDevice> cloud(device, queue, g), gradient(device, queue, n, C);
    const test::DeviceArray<CudaDevice> background(device, queue, Columns<float>::Zero(C, 1)),
        feature(device, queue, C, pixels), alpha(device, queue, 1, pixels),
        cotangent(device, queue, test::noise<float>(C, pixels, 1));
    const double before = memory.held;
    const DeviceRasterizer<A, CudaDevice, KernelChannels<C>> rasterizer{};
    DeviceFrame<CudaDevice> frame(device);
    const auto forward = [&] {
        rasterizer.forward_into(queue, cloud.view(), camera, background.buffer.data(),
                                {feature.view(), alpha.view()}, frame);
    };
    const auto both = [&] {
        forward();
        rasterizer.vjp_into(queue, cloud.view(), camera, background.buffer.data(),
                            {cotangent.read()}, gradient.view(), frame);
    };
    do forward();
    while (!frame.finish(queue));
    OneView r;
    r.entries = static_cast<double>(frame.cost.entries);
    r.both = graph_times(stream, both);
    r.held = static_cast<double>(frame.bytes());
    r.asked = memory.held - before;
    r.formula = static_cast<double>(DeviceFrameShape{
        static_cast<std::size_t>(n), frame.m.tiles, static_cast<std::size_t>(frame.entry_capacity),
        static_cast<std::size_t>(frame.group_capacity),
        static_cast<std::size_t>(rye::detail::ChannelLayout<C>::stride)}
                                        .bytes());
    frame.for_vjp = false;
    r.forward = graph_times(stream, forward);
    check_cuda(cudaStreamSynchronize(stream), "one view");
    return r;
}

} // namespace rye::bench
