// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/device_render.hpp: renders of host arrays on a device, the real or the emulated one,
/// with everything that is written poisoned before.
#pragma once

#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <vector>

#include <rye/splat/cuda/rasterizer.hpp>
#include <rye/splat/rasterizer.hpp>

namespace rye::test {

/// Memory of an arena, up to a number of bytes.
struct LimitedMemory {
    DeviceArena arena;
    std::size_t left; ///< [bytes]
    std::map<void*, std::size_t> held = {};

    void* allocate(std::size_t bytes, CudaStream stream) {
        if (bytes > left) return nullptr;
        void* const p = arena.allocate(bytes, stream);
        left -= bytes;
        held[p] = bytes;
        return p;
    }
    void release(void* p, CudaStream stream) {
        left += held.at(p);
        held.erase(p);
        arena.release(p, stream);
    }
};

/// An array in device memory.
template <class Device>
struct DeviceArray {
    const Device& device;
    const CudaQueue& queue;
    DeviceBuffer<float> buffer;
    Index rows = 0, cols = 0;

    DeviceArray(const Device& d, const CudaQueue& q, const Columns<float>& from)
        : device(d),
          queue(q),
          rows(from.rows()),
          cols(from.cols()) {
        buffer.reserve(q, static_cast<std::size_t>(from.size()) + 1);
        device.send(q, buffer.data(), from.data(),
                    static_cast<std::size_t>(from.size()) * sizeof(float));
    }
    DeviceArray(const Device& d, const CudaQueue& q, Index r, Index c)
        : DeviceArray(d, q,
                      Columns<float>(Columns<float>::Constant(
                          r, c, std::numeric_limits<float>::quiet_NaN()))) {}

    DeviceColumns<float> view() const { return {buffer.data(), rows, cols}; }
    DeviceColumns<const float> read() const { return {buffer.data(), rows, cols}; }
    Columns<float> get() const {
        Columns<float> r(rows, cols);
        device.fetch(queue, r.data(), buffer.data(),
                     static_cast<std::size_t>(r.size()) * sizeof(float));
        return r;
    }
};

/// Gaussians in device memory.
template <class Device>
struct DeviceCloud {
    DeviceArray<Device> mean, rotation, scale, opacity, feature;

    DeviceCloud(const Device& d, const CudaQueue& q, const Gaussians<float>& g)
        : mean(d, q, g.mean),
          rotation(d, q, g.rotation),
          scale(d, q, g.scale),
          opacity(d, q, g.opacity),
          feature(d, q, g.feature) {}
    /// Makes n Gaussians, of no value yet.
    DeviceCloud(const Device& d, const CudaQueue& q, Index n, Index channels)
        : mean(d, q, 3, n),
          rotation(d, q, 4, n),
          scale(d, q, 3, n),
          opacity(d, q, 1, n),
          feature(d, q, channels, n) {}

    DeviceGaussians<float> view() const {
        return {mean.view(), rotation.view(), scale.view(), opacity.view(), feature.view()};
    }
    Gaussians<float> get() const {
        Gaussians<float> g;
        g.mean = mean.get();
        g.rotation = rotation.get();
        g.scale = scale.get();
        g.opacity = opacity.get();
        g.feature = feature.get();
        return g;
    }
};

/// A render on a device and, if asked for, its gradient, back on the host.
template <class A>
struct DeviceRender {
    Columns<float> feature, alpha, depth;
    Columns<std::uint32_t> contributor;
    Gaussians<float> gradient;
    Columns<float> g_background;
    DeviceFrameCost cost;
    int draws = 0; ///< until there was room
    std::size_t bytes = 0;

    /// Gaussians of each tile, near to far.
    std::vector<std::vector<std::uint32_t>> lists;
};

/// Cotangents of a render; empty ones are not given.
struct Cotangents {
    Columns<float> feature, alpha, depth;
};

template <class Device, class FrameAt>
std::vector<std::vector<std::uint32_t>> lists_of(const Device& device, const CudaQueue& queue,
                                                 const FrameAt& frame) {
    const detail::FrameMemory& m = frame.m;
    std::vector<std::uint32_t> begin(m.tiles + 1);
    device.fetch(queue, begin.data(), m.begin, begin.size() * 4);
    std::vector<std::uint64_t> key(begin.back());
    std::vector<std::uint32_t> owner(begin.back());
    device.fetch(queue, key.data(), m.key, key.size() * 8);
    device.fetch(queue, owner.data(), m.owner, owner.size() * 4);
    std::vector<std::vector<std::uint32_t>> r(m.tiles);
    for (std::size_t t = 0; t < r.size(); ++t) {
        std::sort(key.begin() + begin[t], key.begin() + begin[t + 1]);
        for (std::uint32_t k = begin[t]; k < begin[t + 1]; ++k)
            r[t].push_back(owner[static_cast<std::uint32_t>(key[k])]);
    }
    return r;
}

template <class Kernels, class A, class Device, class D>
DeviceRender<A> render_on(const Device& device, const CudaQueue& queue, const A& accuracy,
                          const Gaussians<float>& g, const Pinhole<float, D>& camera,
                          const VecX<float>& background, const Cotangents* cotangents = nullptr,
                          std::int64_t capacity = 0, std::uint32_t keys_of_pass = 0) {
    const DeviceRasterizer<A, Device, Kernels> rasterizer{accuracy};
    const Index pixels = Index(camera.width) * camera.height, channels = g.channels();
    const DeviceCloud<Device> cloud(device, queue, g);
    const DeviceArray<Device> bg(device, queue, Columns<float>(background));
    const DeviceArray<Device> feature(device, queue, channels, pixels),
        alpha(device, queue, 1, pixels), depth(device, queue, 1, pixels),
        who(device, queue, 1, pixels);
    DeviceImages images{feature.view(), alpha.view()};
    if constexpr (A::outputs.depth) images.depth = depth.view();
    if constexpr (A::outputs.contributor)
        images.contributor = {reinterpret_cast<std::uint32_t*>(who.buffer.data()), 1, pixels};
    DeviceFrame<Device> frame(device);
    frame.entry_capacity = frame.group_capacity = capacity;
    if (keys_of_pass > 0) frame.keys_of_pass = keys_of_pass;
    DeviceRender<A> r;
    do {
        rasterizer.forward_into(queue, cloud.view(), camera, bg.buffer.data(), images, frame);
        ++r.draws;
    } while (!frame.finish(queue, TileLists::most_entries(accuracy.max_memory), accuracy.non_finite));
    r.cost = frame.cost;
    r.bytes = frame.bytes();
    r.feature = feature.get();
    r.alpha = alpha.get();
    if constexpr (A::outputs.depth) r.depth = depth.get();
    if constexpr (A::outputs.contributor) {
        r.contributor.resize(1, pixels);
        const Columns<float> bits = who.get();
        if (pixels > 0) std::memcpy(r.contributor.data(), bits.data(), std::size_t(pixels) * 4);
    }
    r.lists = lists_of(device, queue, frame);
    if (cotangents == nullptr) return r;
    const DeviceArray<Device> gf(device, queue, cotangents->feature),
        ga(device, queue, cotangents->alpha), gd(device, queue, cotangents->depth);
    DeviceCotangent c{gf.read()};
    if (cotangents->alpha.size() > 0) c.alpha = ga.read();
    if (cotangents->depth.size() > 0) c.depth = gd.read();
    const DeviceCloud<Device> out(device, queue, g.count(), channels);
    rasterizer.vjp_into(queue, cloud.view(), camera, bg.buffer.data(), c, out.view(), frame);
    r.gradient = out.get();
    const DeviceArray<Device> partial(
        device, queue, 1,
        DeviceRasterizer<A, Device, Kernels>::background_numbers(channels, pixels));
    const DeviceArray<Device> g_background(device, queue, channels, 1);
    rasterizer.background_vjp_into(queue, gf.read(), alpha.read(), partial.buffer.data(),
                                   g_background.buffer.data(), frame);
    r.g_background = g_background.get();
    return r;
}

/// |a - b| / |b|, in double.
template <class T, class U>
double relative(const Columns<T>& a, const Columns<U>& b) {
    double gap = 0, size = 0;
    for (Index i = 0; i < b.size(); ++i) {
        const double x = static_cast<double>(b.data()[i]);
        const double d = static_cast<double>(a.data()[i]) - x;
        gap += d * d;
        size += x * x;
    }
    return gap == 0 ? 0 : std::sqrt(gap / (size + 1e-300));
}

/// The largest of the relative gaps of all arrays.
template <class T>
double relative(const Gaussians<float>& a, const Gaussians<T>& b) {
    double r = 0;
    const auto look = [&](const Columns<float>& x, const Columns<T>& y) {
        const double gap = relative(x, y);
        r = gap <= r ? r : gap; // a NaN is the largest
    };
    look(a.mean, b.mean);
    look(a.rotation, b.rotation);
    look(a.scale, b.scale);
    look(a.opacity, b.opacity);
    look(a.feature, b.feature);
    return r;
}

/// Gaussians of another scalar.
template <class To, class From>
Gaussians<To> converted(const Gaussians<From>& g) {
    Gaussians<To> r;
    r.mean = g.mean.template cast<To>();
    r.rotation = g.rotation.template cast<To>();
    r.scale = g.scale.template cast<To>();
    r.opacity = g.opacity.template cast<To>();
    r.feature = g.feature.template cast<To>();
    return r;
}

} // namespace rye::test
