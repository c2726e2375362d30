// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/drawer_cases.hpp: pictures that a device draws of an avatar against the host's in
/// float, for the emulated device and a real one.
#pragma once

#include <doctest/doctest.h>

#include <rye/avatar/cuda/drawer.hpp>
#include <rye/splat/rasterizer.hpp>

#include "../support/effect_sets.hpp"
#include "../support/hostile.hpp"
#include "avatar_cases.hpp"

namespace rye::test {

/// Tiles with room for networks of gaze mechanisms, channels of the tiny avatar's renders.
using DrawnWide = DeviceDrawingPolicy<DeviceNetworks<3, 128, 64, 64>, KernelChannels<8>>;

/// Views of an avatar: its picture, and each eye's share of the pixels.
struct DrawnViews {
    Image<float> picture, eyes;

    bool operator==(const DrawnViews& o) const {
        return picture.pixels == o.picture.pixels && eyes.pixels == o.eyes.pixels;
    }
};

/// The largest difference of two pictures' numbers.
inline double apart(const Image<float>& a, const Image<float>& b) {
    REQUIRE(a.width == b.width);
    REQUIRE(a.height == b.height);
    REQUIRE(a.channels() == b.channels());
    return static_cast<double>((a.pixels - b.pixels).cwiseAbs().maxCoeff());
}

/// By the host, as its programs draw.
template <EffectSet E>
DrawnViews drawn_on_host(const AvatarCase<E>& c, const Drivers<float, E>& drivers,
                         const Pinhole<float>& camera, const Pinhole<float>& eyes_camera) {
    const ScalarBackend<Serial> host;
    const Rasterizer<FeaturesOnly<Balanced>> rasterizer;
    TwoStreamTrace<float, E> trace;
    drive(host, c.avatar, {c.config, c.roles, drivers}, trace);
    const VecX<float> white = VecX<float>::Ones(c.config.channels), black = VecX<float>::Zero(2);
    DrawnViews r;
    r.picture = upsampler_forward(host, c.avatar.upsampler,
                                  rasterizer.forward(host, trace.gaussians, camera, white).feature,
                                  nullptr);
    Gaussians<float>& both = trace.gaussians;
    both.feature = Columns<float>::Zero(2, both.count());
    for (Index e = 0; e < 2; ++e)
        both.feature.row(e)
            .segment(trace.face_count + c.avatar.eyes.first_point(e), c.avatar.eyes.points_of(e))
            .setOnes();
    r.eyes = rasterizer.forward(host, both, eyes_camera, black).feature;
    return r;
}

/// Pictures of two frames by one drawer against the host's, and the first frame's bits again.
template <class Policy = DrawnWide, EffectSet E, class Device>
void drawn_as_on_host(const Device& device, const CudaQueue& queue, const AvatarCase<E>& c,
                      double bound) {
    DeviceAvatarDrawer<E, Device, Policy> drawer(device, queue, {c.avatar, c.config, c.roles});
    const Pinhole<float> camera = tiny_camera(24, 20).cast<float>();
    const Pinhole<float> large = tiny_camera(50, 38).cast<float>();
    const auto draw = [&](const Drivers<float, E>& drivers) {
        drawer.drive(queue, drivers);
        return DrawnViews{drawer.picture(queue, camera), drawer.eyes(queue, large)};
    };
    Drivers<float, E> other = c.drivers;
    other.expression = -other.expression;
    std::swap(other.gaze[0], other.gaze[1]);
    const DrawnViews first = draw(c.drivers);
    CHECK(first.picture.width == drawer.factor() * camera.width);
    const Drivers<float, E> frames[] = {c.drivers, other};
    for (const Drivers<float, E>& d : frames) {
        const DrawnViews found = draw(d), host = drawn_on_host(c, d, camera, large);
        CHECK(apart(found.picture, host.picture) < bound);
        CHECK(apart(found.eyes, host.eyes) < bound);
        CHECK(host.eyes.pixels.row(0).maxCoeff() > 0.1F);
        CHECK(host.eyes.pixels.row(1).maxCoeff() > 0.1F);
        MESSAGE("largest difference of a picture "
                << apart(found.picture, host.picture) << ", of the eyes' shares "
                << apart(found.eyes, host.eyes) << ", between frames "
                << apart(found.picture, first.picture));
    }
    CHECK(draw(c.drivers) == first);
    CHECK(drawer.bytes() > 0);
    // Another gaze alone, then all that drivers change.
    const Drivers<float, E> gazing = gazing_elsewhere(c.drivers, 0.2F);
    const DrawnViews gazed = draw(gazing);
    CHECK(!(gazed == first));
    drawer.set_drivers(queue, gazing);
    drawer.drive_into(queue);
    CHECK(drawer.finish(queue));
    CHECK(DrawnViews{drawer.picture(queue, camera), drawer.eyes(queue, large)} == gazed);

    AvatarCase<E> brighter = c;
    brighter.avatar.upsampler.out_bias.array() += 0.25F;
    drawer.upload(queue, brighter.avatar);
    const DrawnViews found = draw(c.drivers);
    CHECK(apart(found.picture, drawn_on_host(brighter, c.drivers, camera, large).picture) < bound);
    CHECK(apart(found.picture, first.picture) > 0.01);
}

/// Two cameras of one driving, against each alone.
template <class Device>
void two_views_drawn(const Device& device, const CudaQueue& queue) {
    using E = PaperEffects;
    const AvatarCase<E> c = case_with_parts<E>();
    DeviceAvatarDrawer<E, Device, DrawnWide> drawer(device, queue, {c.avatar, c.config, c.roles});
    std::array<Pinhole<float>, 2> cameras{tiny_camera(24, 20).cast<float>(),
                                          tiny_camera(24, 20).cast<float>()};
    cameras[1].camera_from_world.translation.x() -= 0.05F;
    drawer.drive(queue, c.drivers);
    std::vector<Image<float>> alone;
    for (const Pinhole<float>& camera : cameras) alone.push_back(drawer.picture(queue, camera));
    CHECK(apart(alone[0], alone[1]) > 0.01);

    DeviceAvatarDrawer<E, Device, DrawnWide> stereo(device, queue, {c.avatar, c.config, c.roles});
    stereo.set_drivers(queue, c.drivers);
    const Index pixels = alone[0].size();
    DeviceBuffer<float> numbers;
    numbers.reserve(queue, static_cast<std::size_t>(6 * pixels));
    const auto picture_at = [&](std::size_t view) {
        return DevicePicture<float>{{numbers.data() + 3 * pixels * Index(view), 3, pixels},
                                    alone[0].width,
                                    alone[0].height};
    };
    int attempts = 0;
    do {
        stereo.drive_into(queue);
        for (std::size_t view = 0; view < 2; ++view)
            stereo.draw_into(queue, cameras[view], picture_at(view), view);
    } while (!stereo.finish(queue) && ++attempts < 4);
    CHECK(attempts < 4);
    for (std::size_t view = 0; view < 2; ++view) {
        Image<float> found = alone[view];
        device.fetch(queue, found.pixels.data(), picture_at(view).pixels.data,
                     static_cast<std::size_t>(3 * pixels) * sizeof(float));
        CHECK(found.pixels == alone[view].pixels);
    }
}

/// A drawer of kept frames beside one of single launches, two views each.
template <EffectSet E, class Device, class Plain>
struct KeptBeside {
    const Plain& plain;
    const CudaQueue& queue;
    DeviceAvatarDrawer<E, Device, DrawnWide> kept;
    DeviceAvatarDrawer<E, Plain, DrawnWide> single;
    DeviceBuffer<float> numbers[2] = {};
    Image<float> before{1, 1, 3};

    KeptBeside(const Device& device, const Plain& plain_, const CudaQueue& queue_,
               const AvatarCase<E>& c)
        : plain(plain_),
          queue(queue_),
          kept(device, queue, {c.avatar, c.config, c.roles}),
          single(plain, queue, {c.avatar, c.config, c.roles}) {
        for (auto& n : numbers) n.reserve(queue, 6 * 120 * 120);
    }
    std::array<DeviceView, 2> views(const Pinhole<float>& middle, std::size_t buffer) const {
        std::array<DeviceView, 2> r{};
        const Index pixels = Index(middle.width) * middle.height;
        for (std::size_t k = 0; k < 2; ++k) {
            r[k].camera = middle;
            r[k].camera.camera_from_world.translation.x() += k == 0 ? 0.03F : -0.03F;
            r[k].picture = {{numbers[buffer].data() + 3 * pixels * Index(k), 3, pixels},
                            middle.width,
                            middle.height};
        }
        return r;
    }
    Image<float> fetched(const Pinhole<float>& middle, std::size_t buffer) const {
        Image<float> r(middle.width, 2 * middle.height, 3);
        plain.fetch(queue, r.pixels.data(), numbers[buffer].data(),
                    static_cast<std::size_t>(r.pixels.size()) * sizeof(float));
        return r;
    }
    /// Draws a frame, unlike the one before, by both; returns how often the kept one was put on the
    /// stream.
    int show(const Drivers<float, E>& drivers, const Pinhole<float>& middle) {
        int attempts = 0;
        do {
            kept.frame_into(queue, drivers, views(middle, 0));
            REQUIRE(++attempts < 5);
        } while (!kept.finish(queue));
        single.set_drivers(queue, drivers);
        do {
            single.drive_into(queue);
            const auto to = views(middle, 1);
            for (std::size_t k = 0; k < 2; ++k)
                single.draw_into(queue, to[k].camera, to[k].picture, k);
        } while (!single.finish(queue));
        const Image<float> found = fetched(middle, 0);
        CHECK(found.pixels == fetched(middle, 1).pixels);
        if (found.width == before.width) CHECK(apart(found, before) > 1e-4);
        before = found;
        return attempts;
    }
};

/// An avatar of large Gaussians whose super-resolution doubles no size.
template <EffectSet E>
AvatarCase<E> large_at_its_size() {
    AvatarCase<E> c = case_with_parts<E>();
    UpsamplerShape shape = c.avatar.upsampler.shape;
    shape.doublings = 0;
    c.avatar.upsampler = Upsampler<float>::init(shape, Random{5, 0});
    c.avatar.face.log_scale.array() += 1.0F;
    return c;
}

/// Frames of kept work against the same frames by single launches: `device` may have graphs.
/// Returns the number of graphs when all kinds of frames were drawn.
template <class Device, class Plain>
std::size_t kept_frames_drawn(const Device& device, const Plain& plain, const CudaQueue& queue) {
    using E = PaperEffects;
    const AvatarCase<E> c = large_at_its_size<E>();
    KeptBeside<E, Device, Plain> both(device, plain, queue, c);
    const Pinhole<float> camera = tiny_camera(16, 14).cast<float>();
    Pinhole<float> moved = camera, longer = camera, shifted = camera;
    moved.camera_from_world.translation.z() += 0.5F;
    longer.fx *= 1.3F;
    shifted.cx += 2.5F;
    Drivers<float, E> drivers = c.drivers;
    const auto gazes = [&](int count, const Pinhole<float>& by) {
        for (int k = 0; k < count; ++k) {
            drivers = gazing_elsewhere(drivers, 0.1F);
            CHECK(both.show(drivers, by) == 1);
        }
    };
    const auto expressions = [&](int count, const Pinhole<float>& by) {
        for (int k = 0; k < count; ++k) {
            drivers.expression = (0.5F - static_cast<float>(k)) * c.drivers.expression;
            CHECK(both.show(drivers, by) == 1);
        }
    };
    both.show(drivers, camera);
    gazes(3, camera); // as it is, captured, launched
    expressions(3, camera);
    for (const Pinhole<float>& by : {moved, longer, camera, shifted})
        CHECK(both.show(drivers, by) == 1);
    gazes(1, moved);
    drivers.pose[0] += 0.1F;
    CHECK(both.show(drivers, longer) == 1);
    const std::size_t graphs = both.kept.graphs();
    gazes(1, camera);
    expressions(1, moved);
    for (const Pinhole<float>& by : {longer, shifted}) CHECK(both.show(drivers, by) == 1);
    CHECK(both.kept.graphs() == graphs);
    // Another size, from far, then so near that the kept frame has no room for its lists.
    Pinhole<float> large = tiny_camera(120, 120).cast<float>();
    large.fx *= 0.1F, large.fy *= 0.1F;
    both.show(drivers, large);
    for (int k = 0; k < 2; ++k) {
        large.fx *= 0.9F;
        CHECK(both.show(drivers, large) == 1);
    }
    large.fx *= 0.9F;
    expressions(3, large);
    large.fx = large.fy = 300;
    CHECK(both.show(drivers, large) == 2);
    gazes(3, camera);
    static_cast<void>(both.kept.eyes(queue, moved)); // with memory of its own
    gazes(3, camera);
    auto two = both.views(camera, 0);
    two[1].camera.width = 20;
    CHECK_FAULT(both.kept.frame_into(queue, drivers, two), "expected one size");
    drivers.gaze[0].setZero();
    CHECK_FAULT(both.kept.frame_into(queue, drivers, both.views(camera, 0)),
                "expected a finite direction");
    drivers = gazing_elsewhere(c.drivers, 0.4F);
    both.show(drivers, camera);
    return graphs;
}

/// The same of an avatar without a gaze, whose frames have none that could be bad.
template <class Device, class Plain>
void kept_frames_without_gaze(const Device& device, const Plain& plain, const CudaQueue& queue) {
    using E = Effects<Expression, HeadPose, CornealBulge>;
    const AvatarCase<E> c = large_at_its_size<E>();
    KeptBeside<E, Device, Plain> both(device, plain, queue, c);
    Pinhole<float> camera = tiny_camera(16, 14).cast<float>();
    Drivers<float, E> drivers = c.drivers;
    both.show(drivers, camera);
    for (int k = 0; k < 3; ++k) {
        drivers.expression = (0.5F - static_cast<float>(k)) * c.drivers.expression;
        CHECK(both.show(drivers, camera) == 1);
    }
    for (int k = 0; k < 3; ++k) {
        camera.camera_from_world.translation.z() += 0.2F;
        CHECK(both.show(drivers, camera) == 1);
    }
}

/// Effects and parts that `rye` trains.
template <class Device>
void variants_drawn(const Device& device, const CudaQueue& queue, double bound) {
    drawn_as_on_host(device, queue, case_with_parts<PaperEffects>(), bound);
    drawn_as_on_host(device, queue, case_with_parts<AllEffects>(), bound);
    using Still = More<PaperEffects, GazeBy<FixedEye>>;
    drawn_as_on_host(device, queue,
                     case_with_parts<More<PaperEffects, GazeBy<LearnedQuaternion>>>(), bound);
    drawn_as_on_host(device, queue, case_with_parts<More<Still, EyesBy<RotatedCode>>>(), bound);
    drawn_as_on_host(device, queue, case_with_parts<LitEffects>(), bound);
}

/// Super-resolution of no, one and two doublings.
template <class Device>
void sizes_drawn(const Device& device, const CudaQueue& queue, double bound) {
    for (const int doublings : {0, 2}) {
        AvatarCase<PaperEffects> c = case_with_parts<PaperEffects>();
        UpsamplerShape shape = c.avatar.upsampler.shape;
        shape.doublings = doublings;
        c.avatar.upsampler = Upsampler<float>::init(shape, Random{5, 0});
        drawn_as_on_host(device, queue, c, bound);
    }
}

/// Launches of a drawer for a frame, by how it differs from the one before.
template <class Device>
void drawer_by_difference(const Device& on, const CudaQueue& queue) {
    using E = PaperEffects;
    const AvatarCase<E> c = case_with_parts<E>();
    std::map<std::string, int> launched;
    DeviceAvatarDrawer<E, WritesDown<Device>, DrawnWide> drawer({on, &launched}, queue,
                                                                {c.avatar, c.config, c.roles});
    const auto networks = [&](const Drivers<float, E>& d) {
        launched.clear();
        drawer.drive(queue, d);
        return launched["network, forward"];
    };
    const Drivers<float, E> gazing = gazing_elsewhere(c.drivers, 0.2F);
    Drivers<float, E> larger = gazing;
    larger.scale *= 1.5F;
    CHECK(networks(c.drivers) == 10);
    CHECK(networks(gazing) == 4);
    CHECK(networks(gazing) == 0);
    CHECK(launched.size() == 1); // what this test asked for
    CHECK(networks(larger) == 10);
    CHECK(networks(of_another_face(larger)) == 10);
    CHECK(networks(larger) == 10);
    CHECK(networks(gazing_elsewhere(larger, -0.1F)) == 4);
    drawer.upload(queue, c.avatar);
    CHECK(networks(larger) == 10);
    CHECK(launched["network's operands"] > 0);
    drawer.set_drivers(queue, c.drivers); // and not driven
    CHECK(networks(larger) == 10);
    Drivers<float, E> bad = larger;
    bad.gaze[1].setZero();
    CHECK_FAULT(drawer.drive(queue, bad), "expected a finite direction");
    CHECK(networks(larger) == 0);
}

/// Checks what a drawer refuses, and that it goes on afterwards.
template <class Device>
void drawer_bad_input(const Device& device, const CudaQueue& queue) {
    using E = PaperEffects;
    using Drawer = DeviceAvatarDrawer<E, Device, DrawnWide>;
    const AvatarCase<E> c = case_with_parts<E>();
    const Pinhole<float> camera = tiny_camera(24, 20).cast<float>();
    Drawer drawer(device, queue, {c.avatar, c.config, c.roles});
    CHECK_FAULT(drawer.picture(queue, camera), "nothing was driven before the picture");
    Drivers<float, E> drivers = c.drivers;
    drivers.expression = VecX<float>::Zero(7);
    CHECK_FAULT(drawer.drive(queue, drivers), "expression has 7 numbers");
    drawer.drive(queue, c.drivers);
    const Image<float> picture = drawer.picture(queue, camera);

    const float bad = std::nanf("");
    AvatarCase<E> damaged = c;
    damaged.avatar.face.position(1, 3) = bad;
    drawer.upload(queue, damaged.avatar);
    drawer.drive(queue, c.drivers);
    CHECK_FAULT(drawer.picture(queue, camera), "of them are not finite everywhere");
    CHECK_FAULT(drawer.eyes(queue, camera), "of them are not finite everywhere");
    damaged = c;
    damaged.avatar.upsampler.out_bias(0) = bad;
    drawer.upload(queue, damaged.avatar);
    drawer.drive(queue, c.drivers);
    CHECK_FAULT(drawer.picture(queue, camera), "the picture is not finite everywhere");
    drawer.upload(queue, c.avatar);
    drawer.drive(queue, c.drivers);
    CHECK(drawer.picture(queue, camera).pixels == picture.pixels);
    AvatarCase<E> other = c;
    other.config.channels = 4;
    CHECK_FAULT(Drawer(device, queue, {other.avatar, other.config, other.roles}),
                "super-resolution reads 5 channels, renders have 4");
}

} // namespace rye::test
