// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/cases.hpp: what is demanded of a device's renders, the same of the emulated one and
/// of a real one: images and gradients against the plain loops in double under the same rules,
/// lists against TileLists, bad input, too little room.
#pragma once

#include <doctest/doctest.h>

#include <cstdint>
#include <limits>
#include <string>

#include "../support/hostile.hpp"
#include "../support/scenes.hpp"
#include "decisions.hpp"
#include "device_render.hpp"

namespace rye::test {

/// Errors [relative]: of the image, of gradients, and of that of the background, which in float is
/// a sum of 1 - alpha.
struct Bounds {
    double image = 2e-6, gradient = 1e-5, background = 1e-5;
};

/// A scene by rules A on a device, against plain loops of T.
template <class T, class Kernels, class A, class Device>
void against(const Device& device, const CudaQueue& queue, const Scenery<float>& s,
             const A& accuracy = {}, const Bounds& bounds = {}) {
    CAPTURE(s.name);
    CAPTURE(s.gaussians.channels());
    const Index pixels = Index(s.camera.width) * s.camera.height, c = s.gaussians.channels();
    Cotangents w{noise<float>(c, pixels, 1), noise<float>(1, pixels, 2), {}};
    if constexpr (A::outputs.depth) w.depth = noise<float>(1, pixels, 3);
    const auto r =
        render_on<Kernels>(device, queue, accuracy, s.gaussians, s.camera, s.background, &w);
    const Rasterizer<A> plain{accuracy};
    const auto g = converted<T>(s.gaussians);
    const auto camera = s.camera.template cast<T>();
    const VecX<T> background = s.background.template cast<T>();
    const auto truth = plain.forward(ScalarBackend<Serial>{}, g, camera, background);
    CHECK(relative(r.feature, truth.feature.pixels) < bounds.image);
    CHECK(relative(r.alpha, truth.alpha.pixels) < bounds.image);
    if constexpr (A::outputs.depth) CHECK(relative(r.depth, truth.depth.pixels) < bounds.image);
    const Columns<T> wf = w.feature.cast<T>(), wa = w.alpha.cast<T>(), wd = w.depth.cast<T>();
    const auto gradient = plain.vjp(ScalarBackend<Serial>{}, g, camera, background, truth, wf, &wa,
                                    A::outputs.depth ? &wd : nullptr);
    CHECK(relative(r.gradient.mean, gradient.mean) < bounds.gradient);
    CHECK(relative(r.gradient.rotation, gradient.rotation) < bounds.gradient);
    CHECK(relative(r.gradient.scale, gradient.scale) < bounds.gradient);
    CHECK(relative(r.gradient.opacity, gradient.opacity) < bounds.gradient);
    CHECK(relative(r.gradient.feature, gradient.feature) < bounds.gradient);
    const VecX<T> gb = background_vjp(truth, wf);
    CHECK(relative(r.g_background, Columns<T>(gb)) < bounds.background);
}

/// Fast against the same rules in double: equal but for rounding where no rule decides between
/// numbers that rounding may swap.
template <class Kernels, class Device>
void fast_where_decided(const Device& device, const CudaQueue& queue, Index channels) {
    using A = FeaturesOnly<Fast>;
    const Scenery<float> s = random_scene<float>(300, channels, 5);
    const Index pixels = Index(s.camera.width) * s.camera.height;
    const auto g = converted<double>(s.gaussians);
    const auto camera = s.camera.template cast<double>();
    const VecX<double> background = s.background.template cast<double>();
    const Rasterizer<A> plain;
    const auto truth = plain.forward(ScalarBackend<Serial>{}, g, camera, background);
    const Columns<float> clear = undecided_left_out(A(), g, camera, truth.trace);
    CHECK(clear.mean() > 0.97);
    const Cotangents w{
        Columns<float>(noise<float>(channels, pixels, 1) * clear.row(0).asDiagonal()), {}, {}};
    const auto r = render_on<Kernels>(device, queue, A(), s.gaussians, s.camera, s.background, &w);
    const auto gradient = plain.vjp(ScalarBackend<Serial>{}, g, camera, background, truth,
                                    Columns<double>(w.feature.template cast<double>()));
    CHECK(relative(r.gradient, gradient) < 1e-5);
}

/// Lists equal TileLists', entry for entry.
template <class A, class Device>
void lists_equal(const Device& device, const CudaQueue& queue, const Scenery<float>& s) {
    CAPTURE(s.name);
    const A accuracy;
    const auto r =
        render_on<KernelChannels<3>>(device, queue, accuracy, s.gaussians, s.camera, s.background);
    const auto host = Rasterizer<A>{accuracy}.forward(ScalarBackend<Serial>{}, s.gaussians,
                                                      s.camera, s.background);
    const TileLists& lists = host.trace.lists;
    REQUIRE(Index(r.lists.size()) == lists.tiles());
    CHECK(r.cost.entries == lists.entries());
    int different = 0;
    for (std::size_t t = 0; t < r.lists.size(); ++t) {
        std::vector<std::uint32_t> of_host;
        for (Index k = lists.begin[t]; k < lists.begin[t + 1]; ++k)
            of_host.push_back(
                host.trace.members[lists.entry[static_cast<std::size_t>(k)].member].source);
        different += of_host != r.lists[t];
    }
    CHECK(different == 0);
}

/// More Gaussians in a tile than a block sorts at once, with many equal depths.
inline Scenery<float> crowded(Index n, bool tied) {
    Scenery<float> s = random_scene<float>(n, 3, 21, 0.02);
    s.name = tied ? "a crowded tile of equal depths" : "a crowded tile";
    for (Index i = 0; i < n; ++i) {
        s.gaussians.opacity(0, i) *= 0.02F;
        s.gaussians.mean.col(i).head(2) *= 0.2F;
        if (tied && i % 3 != 0) s.gaussians.mean(2, i) = 0.25F;
    }
    return s;
}

/// Gaussians in many rows of tiles: more than are kept, and more rows than a block has threads.
inline Scenery<float> tall(Index n, Index channels) {
    Scenery<float> s = random_scene<float>(n, channels, 81, 0.1);
    s.name = "tall Gaussians";
    for (Index i = 0; i < n; i += 3) s.gaussians.scale(1, i) *= 12;
    s.camera.fy = 350;
    s.camera.cy = 160;
    s.camera.height = 333;
    return s;
}

/// Lists that are made in several passes give the same pictures and gradients, to the bit.
template <class Kernels, class Device>
void in_passes(const Device& device, const CudaQueue& queue, const Scenery<float>& s) {
    CAPTURE(s.name);
    const Index pixels = Index(s.camera.width) * s.camera.height;
    const Cotangents w{noise<float>(s.gaussians.channels(), pixels, 1), {}, {}};
    const auto drawn = [&](std::uint32_t keys_of_pass) {
        return render_on<Kernels>(device, queue, Balanced(), s.gaussians, s.camera, s.background,
                                  &w, 0, keys_of_pass);
    };
    const auto one = drawn(0), several = drawn(1);
    CHECK(one.lists == several.lists);
    CHECK(one.feature == several.feature);
    CHECK(one.alpha == several.alpha);
    CHECK(one.gradient.mean == several.gradient.mean);
    CHECK(one.gradient.rotation == several.gradient.rotation);
    CHECK(one.gradient.scale == several.gradient.scale);
    CHECK(one.gradient.opacity == several.gradient.opacity);
    CHECK(one.gradient.feature == several.gradient.feature);
}

/// A frame that keeps nothing for a vjp has the same pictures, to the bit, in less memory.
template <class Kernels, class Device>
void without_vjp(const Device& device, const CudaQueue& queue, Index channels) {
    using A = Drawing<Balanced, Outputs{.depth = true, .contributor = true}>;
    const Scenery<float> s = random_scene<float>(200, channels, 5);
    const DeviceRasterizer<A, Device, Kernels> rasterizer{};
    const Index pixels = Index(s.camera.width) * s.camera.height;
    const DeviceCloud<Device> cloud(device, queue, s.gaussians);
    const DeviceArray<Device> bg(device, queue, Columns<float>(s.background));
    const auto drawn = [&](bool for_vjp) {
        const DeviceArray<Device> feature(device, queue, channels, pixels),
            alpha(device, queue, 1, pixels), depth(device, queue, 1, pixels),
            who(device, queue, 1, pixels);
        DeviceFrame<Device> frame(device);
        frame.for_vjp = for_vjp;
        do
            rasterizer.forward_into(
                queue, cloud.view(), s.camera, bg.buffer.data(),
                {feature.view(),
                 alpha.view(),
                 depth.view(),
                 {reinterpret_cast<std::uint32_t*>(who.buffer.data()), 1, pixels}},
                frame);
        while (!frame.finish(queue));
        struct {
            Columns<float> feature, alpha, depth;
            std::vector<std::uint32_t> who;
            std::size_t bytes;
        } r{feature.get(), alpha.get(), depth.get(), {}, frame.bytes()};
        r.who.resize(static_cast<std::size_t>(pixels));
        device.fetch(queue, r.who.data(), who.buffer.data(), r.who.size() * 4);
        return r;
    };
    const auto with = drawn(true), without = drawn(false);
    CHECK(with.feature == without.feature);
    CHECK(with.alpha == without.alpha);
    CHECK(with.depth == without.depth);
    CHECK(with.who == without.who);
    CHECK(without.bytes < with.bytes / 2);
}

/// Features as halves: against every Gaussian at every pixel in double, within the bound that
/// halves of features and weights have; alpha has the same bits. Up to 4 channels all has.
template <class Kernels, class Device>
void halves_drawn(const Device& device, const CudaQueue& queue, Index channels) {
    using A = FeaturesOnly<Exact32>;
    Scenery<float> s = random_scene<float>(300, channels, 5);
    const Index pixels = Index(s.camera.width) * s.camera.height;
    const DeviceArray<Device> bg(device, queue, Columns<float>(s.background));
    struct Drawn {
        Columns<float> feature, alpha;
    };
    const auto drawn = [&](const auto& rules) {
        const DeviceRasterizer<std::remove_cvref_t<decltype(rules)>, Device, Kernels> r{rules};
        const DeviceCloud<Device> cloud(device, queue, s.gaussians);
        const DeviceArray<Device> feature(device, queue, channels, pixels),
            alpha(device, queue, 1, pixels);
        DeviceFrame<Device> frame(device);
        frame.for_vjp = false;
        do
            r.forward_into(queue, cloud.view(), s.camera, bg.buffer.data(),
                           {feature.view(), alpha.view()}, frame);
        while (!frame.finish(queue));
        return Drawn{feature.get(), alpha.get()};
    };
    const double unit = 1.0 / 2048, visits = static_cast<double>(s.gaussians.count());
    const auto bound = [&](double largest) {
        return largest * (2 * unit + unit * unit + visits / (1 << 24) / 2 + 5e-5);
    };
    const auto within = [&](double most, double largest) {
        CHECK(most < bound(largest));
        CHECK(most > bound(largest) / 50);
        MESSAGE(channels << " channels, largest error " << most << ", bound " << bound(largest));
    };
    const Drawn found = drawn(WithHalves<A>());
    if (channels <= 4) {
        CHECK(found.feature == drawn(A()).feature);
        return;
    }
    const VecX<double> background = s.background.template cast<double>();
    const auto truth = Rasterizer<FeaturesOnly<Exact64>>{}.forward(
        ScalarBackend<Serial>{}, converted<double>(s.gaussians), s.camera.template cast<double>(),
        background);
    const double largest = static_cast<double>(s.gaussians.feature.cwiseAbs().maxCoeff());
    within((found.feature.template cast<double>() - truth.feature.pixels.template cast<double>())
               .cwiseAbs()
               .maxCoeff(),
           largest);
    CHECK(found.alpha == drawn(A()).alpha);
    // What halves cannot hold: as large as can be, or nothing.
    s.gaussians.feature *= 1e-9F;
    const double tiny = static_cast<double>(drawn(WithHalves<A>()).feature.cwiseAbs().maxCoeff());
    CHECK(tiny <= static_cast<double>(s.background.cwiseAbs().maxCoeff()) * 1.001);
    s.gaussians.feature.setConstant(1e9F);
    const Columns<float> huge = drawn(WithHalves<A>()).feature;
    CHECK(huge.allFinite());
    CHECK(huge.maxCoeff() > 60000.0F);
    CHECK(huge.maxCoeff() < 66000.0F);
    DeviceFrame<Device> frame(device);
    const DeviceRasterizer<WithHalves<A>, Device, Kernels> rasterizer{};
    const DeviceCloud<Device> cloud(device, queue, s.gaussians);
    const DeviceArray<Device> to(device, queue, channels, pixels), alpha(device, queue, 1, pixels);
    CHECK_FAULT(rasterizer.forward_into(queue, cloud.view(), s.camera, bg.buffer.data(),
                                        {to.view(), alpha.view()}, frame),
                "expected one without: features are halves");
}

template <class Device>
void bad_input(const Device& device, const CudaQueue& queue) {
    using A = Balanced;
    Scenery<float> s = random_scene<float>(90, 3, 31);
    constexpr float nan = std::numeric_limits<float>::quiet_NaN();
    s.gaussians.mean(1, 3) = nan;
    s.gaussians.rotation.col(7).setZero();
    s.gaussians.scale(2, 11) = std::numeric_limits<float>::infinity();
    s.gaussians.opacity(0, 13) = nan;
    s.gaussians.feature(0, 17) = nan;
    s.gaussians.opacity(0, 19) = 0;
    const Index pixels = Index(s.camera.width) * s.camera.height;
    const Cotangents w{noise<float>(3, pixels, 1), {}, {}};
    const auto r =
        render_on<KernelChannels<3>>(device, queue, A(), s.gaussians, s.camera, s.background, &w);
    CHECK(r.cost.non_finite == 4); // a quaternion of zeros is the identity
    CHECK(r.feature.allFinite());
    CHECK(r.gradient.mean.allFinite());
    CHECK(r.gradient.feature.col(17).isZero());
    const auto host =
        Rasterizer<A>{}.forward(ScalarBackend<Serial>{}, s.gaussians, s.camera, s.background);
    CHECK(host.trace.non_finite == 4);
    CHECK(relative(r.feature, host.feature.pixels) < 2e-6);
    A strict;
    strict.non_finite = NonFinite::fail;
    CHECK_THROWS_AS(
        render_on<KernelChannels<3>>(device, queue, strict, s.gaussians, s.camera, s.background),
        Error);
    A few;
    few.max_memory = 10 * TileLists::entry_bytes<>;
    CHECK_THROWS_AS(
        render_on<KernelChannels<3>>(device, queue, few, s.gaussians, s.camera, s.background),
        Error);
    // No pixels, one, odd sides; no Gaussians.
    for (const auto& [width, height] : {std::pair{0, 0}, {0, 5}, {1, 1}, {16, 16}, {33, 1}}) {
        Scenery<float> small = random_scene<float>(20, 3, 5);
        small.camera.width = width;
        small.camera.height = height;
        against<float, KernelChannels<3>>(device, queue, small, A());
    }
    Scenery<float> none = random_scene<float>(20, 3, 5);
    none.gaussians = Gaussians<float>(0, 3);
    const auto empty = render_on<KernelChannels<3>>(device, queue, A(), none.gaussians, none.camera,
                                                    none.background);
    CHECK(empty.alpha.isZero());
    CHECK(empty.feature.col(0) == none.background);
}

template <class Device>
void too_little_room(const Device& device, const CudaQueue& queue) {
    const Scenery<float> s = random_scene<float>(150, 3, 41);
    const Index pixels = Index(s.camera.width) * s.camera.height;
    const Cotangents w{noise<float>(3, pixels, 1), {}, {}};
    const auto whole = render_on<KernelChannels<3>>(device, queue, Balanced(), s.gaussians,
                                                    s.camera, s.background, &w);
    CHECK(whole.draws == 1);
    for (const std::int64_t capacity :
         {std::int64_t(1), std::int64_t(100), whole.cost.entries - 1, whole.cost.entries}) {
        CAPTURE(capacity);
        const auto r = render_on<KernelChannels<3>>(device, queue, Balanced(), s.gaussians,
                                                    s.camera, s.background, &w, capacity);
        CHECK(r.draws >= (capacity < whole.cost.entries ? 2 : 1));
        CHECK(r.feature == whole.feature);
        CHECK(r.alpha == whole.alpha);
        CHECK(r.gradient.mean == whole.gradient.mean);
        CHECK(r.gradient.feature == whole.gradient.feature);
    }
}

/// A frame's memory is what its shape says; where there is less, an Error says how much was
/// missing, and the same frame draws as soon as there is more.
template <class Device>
void too_little_memory(const Device& device, const CudaQueue& queue) {
    const Scenery<float> s = random_scene<float>(150, 3, 41);
    const Index pixels = Index(s.camera.width) * s.camera.height;
    const auto whole = render_on<KernelChannels<3>>(device, queue, Balanced(), s.gaussians,
                                                    s.camera, s.background);
    const DeviceCloud<Device> cloud(device, queue, s.gaussians);
    const DeviceArray<Device> bg(device, queue, Columns<float>(s.background)),
        feature(device, queue, 3, pixels), alpha(device, queue, 1, pixels),
        depth(device, queue, 1, pixels);
    LimitedMemory memory{queue.memory, 100000};
    const CudaQueue limited{queue.stream, memory};
    {
        DeviceFrame<Device> frame(device);
        const DeviceRasterizer<Balanced, Device, KernelChannels<3>> rasterizer;
        const auto draw = [&] {
            do
                rasterizer.forward_into(limited, cloud.view(), s.camera, bg.buffer.data(),
                                        {feature.view(), alpha.view(), depth.view()}, frame);
            while (!frame.finish(limited));
        };
        CHECK_FAULT(draw(), "device memory: no room for");
        memory.left += std::size_t(1) << 30U;
        draw();
        CHECK(feature.get() == whole.feature);
        std::size_t bytes = 0;
        for (const auto& [p, n] : memory.held) bytes += n;
        CHECK(bytes == frame.bytes());
        const DeviceFrameShape shape{static_cast<std::size_t>(s.gaussians.count()), frame.m.tiles,
                                     static_cast<std::size_t>(frame.entry_capacity),
                                     static_cast<std::size_t>(frame.group_capacity),
                                     detail::ChannelLayout<3>::stride};
        CHECK(bytes == shape.bytes());
    }
    CHECK(memory.held.empty());
}

template <class Device>
void contributors(const Device& device, const CudaQueue& queue) {
    using Who = Drawing<Balanced, Outputs{.depth = true, .contributor = true}>;
    const Scenery<float> s = random_scene<float>(120, 3, 51);
    const auto r =
        render_on<KernelChannels<3>>(device, queue, Who(), s.gaussians, s.camera, s.background);
    const auto host =
        Rasterizer<Who>{}.forward(ScalarBackend<Serial>{}, s.gaussians, s.camera, s.background);
    Index different = 0;
    for (Index p = 0; p < r.contributor.cols(); ++p)
        different += r.contributor(0, p) != host.contributor.pixels(0, p);
    CHECK(different <= r.contributor.cols() / 200); // weights that are equal but for rounding
}

/// Colours that are the same before and behind give no gradient of shape, exactly.
template <class Kernels, class Device>
void equal_colours(const Device& device, const CudaQueue& queue, Index channels) {
    Scenery<float> s = random_scene<float>(80, channels, 61);
    for (Index c = 0; c < channels; ++c) {
        const float same = 0.3F + 0.07F * static_cast<float>(c);
        s.gaussians.feature.row(c).setConstant(same);
        s.background[c] = same;
    }
    const Index pixels = Index(s.camera.width) * s.camera.height;
    const Cotangents w{noise<float>(channels, pixels, 1), {}, {}};
    const auto r = render_on<Kernels>(device, queue, FeaturesOnly<Balanced>(), s.gaussians,
                                      s.camera, s.background, &w);
    CHECK(r.gradient.mean.isZero(0));
    CHECK(r.gradient.scale.isZero(0));
    CHECK(r.gradient.rotation.isZero(0));
    CHECK(r.gradient.opacity.isZero(0));
    CHECK(!r.gradient.feature.isZero());
}

} // namespace rye::test
