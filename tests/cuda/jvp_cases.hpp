// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/jvp_cases.hpp: derivatives in directions on a device, against the render on duals in
/// plain loops.
#pragma once

#include <doctest/doctest.h>

#include <algorithm>
#include <memory>
#include <span>
#include <vector>

#include <rye/splat/jvp.hpp>

#include "../support/directions.hpp"
#include "device_render.hpp"

namespace rye::test {

/// Errors [relative] of the tangents of the images.
struct TangentBounds {
    double feature = 1e-5, alpha = 1e-5, depth = 1e-5;
};

/// Derivatives by rules A in directions of all Gaussians' numbers, of the camera, of both, of
/// features alone and of nothing, the first `count` of them in one call: plain loops of T.
template <class T, class Kernels, class A, class Device>
void jvp_against(const Device& device, const CudaQueue& queue, const Scenery<float>& s,
                 const A& accuracy, std::size_t count, const TangentBounds& bounds = {}) {
    CAPTURE(s.name);
    CAPTURE(s.gaussians.channels());
    const DeviceRasterizer<A, Device, Kernels> rasterizer{accuracy};
    const Index pixels = Index(s.camera.width) * s.camera.height, c = s.gaussians.channels();
    const DeviceCloud<Device> cloud(device, queue, s.gaussians);
    const DeviceArray<Device> bg(device, queue, Columns<float>(s.background));
    DeviceFrame<Device> frame(device);
    struct Images {
        DeviceArray<Device> feature, alpha, depth;
        Images(const Device& d, const CudaQueue& q, Index channels, Index n)
            : feature(d, q, channels, n),
              alpha(d, q, 1, n),
              depth(d, q, 1, n) {}
        DeviceImages view() const {
            DeviceImages r{feature.view(), alpha.view()};
            if constexpr (A::outputs.depth) r.depth = depth.view();
            return r;
        }
    };
    const Images value(device, queue, c, pixels);
    do
        rasterizer.forward_into(queue, cloud.view(), s.camera, bg.buffer.data(), value.view(),
                                frame);
    while (!frame.finish(queue));

    const Gaussians<float> v = direction(s, 7);
    const Pinhole<float> camera = camera_direction<float>(8);
    const DeviceCloud<Device> along(device, queue, v);
    const DeviceGaussians<const float> moved = along.view();
    DeviceGaussians<const float> colours{};
    colours.feature = moved.feature;
    const detail::DeviceDirection<NoDistortion> kinds[] = {
        {moved, nullptr, {}}, {{}, &camera, {}}, {moved, &camera, {}}, {colours, nullptr, {}}, {}};
    std::vector<detail::DeviceDirection<NoDistortion>> directions(kinds, kinds + count);
    std::vector<std::unique_ptr<Images>> images;
    for (auto& d : directions) {
        images.push_back(std::make_unique<Images>(device, queue, c, pixels));
        d.images = images.back()->view();
    }
    DeviceBuffer<detail::SplatRecord> splats;
    rasterizer.template jvp_into<NoDistortion>(queue, cloud.view(), directions, s.camera,
                                               bg.buffer.data(), splats, frame);

    const Gaussians<T> g = converted<T>(s.gaussians), dg = converted<T>(v);
    Gaussians<T> features = converted<T>(v);
    Gaussians<T>::fields([](const std::string& name, auto& a) {
        if (name != "feature") a.setZero();
    }, features);
    const Pinhole<T> lens = s.camera.template cast<T>(), dlens = camera.template cast<T>();
    const RasterTangents<T> tangents[] = {
        {&dg, nullptr}, {nullptr, &dlens}, {&dg, &dlens}, {&features, nullptr}, {}};
    for (std::size_t k = 0; k < count; ++k) {
        CAPTURE(k);
        const auto truth = Rasterizer<A>{accuracy}.jvp(
            ScalarBackend<Serial>{}, g, tangents[k], lens,
            VecX<T>(s.background.template cast<T>()));
        CHECK(relative(images[k]->feature.get(), truth.feature) < bounds.feature);
        CHECK(relative(images[k]->alpha.get(), truth.alpha) < bounds.alpha);
        if constexpr (A::outputs.depth)
            CHECK(relative(images[k]->depth.get(), truth.depth) < bounds.depth);
    }
}

/// A direction whose shapes are not those of the Gaussians, and a frame that keeps nothing.
template <class Device>
void bad_directions(const Device& device, const CudaQueue& queue) {
    const Scenery<float> s = random_scene<float>(20, 3, 5);
    const DeviceRasterizer<Balanced, Device, KernelChannels<3>> rasterizer{Balanced()};
    const Index pixels = Index(s.camera.width) * s.camera.height;
    const DeviceCloud<Device> cloud(device, queue, s.gaussians),
        other(device, queue, random_scene<float>(21, 3, 5).gaussians);
    const DeviceArray<Device> bg(device, queue, Columns<float>(s.background)),
        feature(device, queue, 3, pixels), alpha(device, queue, 1, pixels);
    const DeviceImages images{feature.view(), alpha.view()};
    DeviceBuffer<detail::SplatRecord> splats;
    DeviceFrame<Device> frame(device);
    const auto run = [&](const DeviceGaussians<const float>& tangent) {
        const detail::DeviceDirection<NoDistortion> one[] = {{tangent, nullptr, images}};
        rasterizer.template jvp_into<NoDistortion>(queue, cloud.view(), one, s.camera,
                                                   bg.buffer.data(), splats, frame);
    };
    CHECK_THROWS_WITH_AS(run(other.view()),
                         doctest::Contains("tangent of mean of 3 x 21, expected 3 x 20"), Error);
    frame.for_vjp = false;
    CHECK_THROWS_WITH_AS(run(cloud.view()), doctest::Contains("keeps nothing for a jvp"), Error);
}

} // namespace rye::test
