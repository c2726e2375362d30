// SPDX-License-Identifier: Apache-2.0
#include <rye/interactive/frame_cache.hpp>
#include <rye/core/thread_pool.hpp>

#include <limits>
#include <doctest/doctest.h>

#include <rye/avatar/trained.hpp>

#include "../support/effect_sets.hpp"

using namespace rye;
using namespace rye::test;

namespace {

/// An avatar of several tiles, with eyes far enough apart to move alone.
template <class T, EffectSet E = PaperEffects>
struct Stage {
    AvatarConfig config;
    LandmarkRoles roles = tiny_roles();
    TwoStream<T, E> avatar;
    Drivers<T, E> drivers = restricted<E>(tiny_drivers<T>());
    double dilation = 0.3;
    Pinhole<T> camera = tiny_camera(85, 69).template cast<T>();
    VecX<T> background;

    explicit Stage(const UpsamplerShape& upsampler) : config(tiny_config()) {
        config.gaze_near = 0.02;
        config.gaze_far = 0.06;
        TwoStream<double, E> a = avatar_with_parts<E>();
        Draw draw{{7, 2}};
        UpsamplerShape shape = upsampler;
        shape.in_channels = config.channels;
        a.upsampler = Upsampler<double>::init(shape, Random{6, 0});
        a.upsampler.out_weight = draw.columns(3, shape.capacity);
        avatar = lifted<T>(a);
        background = VecX<T>::Constant(config.channels, T(0.75));
    }
};

inline UpsamplerShape local_shape(int capacity, bool skip) {
    return {.capacity = capacity, .doublings = 0, .norm = Normalization::none, .skip = skip};
}

/// The full frame by the ordinary functions.
template <class B, class A, class T, class E>
void check_frame(const B& backend, FrameCache<B, A, T, E>& cache, const Stage<T, E>& s) {
    TwoStreamTrace<T, E> trace;
    drive(backend, s.avatar, {s.config, s.roles, seen_from(s.drivers, s.camera)}, trace);
    const Gaussians<T>& g = trace.gaussians;
    Rasterizer<A> rasterizer;
    rasterizer.accuracy.dilation = s.dilation;
    const Raster<T> whole = rasterizer.forward(backend, g, s.camera, s.background);
    cache.set_dilation(s.dilation);
    const Raster<T>& kept = cache.update(s.drivers, s.camera, s.background);
    Gaussians<T>::fields([](const std::string& name, const auto& a, const auto& b) {
        INFO(name);
        CHECK(same_bits(a, b));
    }, cache.drive().gaussians(), g);
    CHECK(same_bits(kept.feature.pixels, whole.feature.pixels));
    CHECK(same_bits(kept.alpha.pixels, whole.alpha.pixels));
    CHECK(same_bits(kept.depth.pixels, whole.depth.pixels));
    CHECK(same_bits(cache.picture().pixels,
                    upsampler_forward(backend, s.avatar.upsampler, whole.feature, nullptr).pixels));
}

/// Changes any of the drivers, the camera and the background, alone or together, or nothing.
template <class T, class E>
void change(Stage<T, E>& s, int step) {
    const Random random{static_cast<std::uint64_t>(step) + 90, 2};
    std::uint64_t k = 0;
    const auto chance = [&](double p) { return random.uniform(k++) < p; };
    const auto any = [&] { return static_cast<T>(random.uniform(k++) - 0.5); };
    const bool all = chance(0.1);
    for (std::size_t e = 0; e < 2; ++e)
        if (all || chance(0.5)) s.drivers.gaze[e] = Vec3<T>(any(), any(), T(1)).normalized();
    if (all || chance(0.2)) s.drivers.expression[1] += any();
    if (all || chance(0.15)) s.drivers.pose[static_cast<Index>(random.below(k++, 6))] += T(0.2) * any();
    if (all || chance(0.1)) s.drivers.scale = T(1) + T(0.2) * any();
    if (all || chance(0.15)) s.background[1] = any();
    if (all || chance(0.1)) {
        s.camera.width = 40 + static_cast<int>(random.below(k++, 90));
        s.camera.height = 30 + static_cast<int>(random.below(k++, 70));
    }
    if (all || chance(0.1)) s.camera.cx += any();
    if (all || chance(0.1)) s.camera.camera_from_world.translation[0] += T(0.3) * any();
    if (all || chance(0.1)) s.dilation = 0.1 + random.uniform(k++);
}

template <class T, EffectSet E = PaperEffects, class B>
void follow(const B& backend, const UpsamplerShape& shape, int steps) {
    Stage<T, E> s(shape);
    FrameCache<B, Balanced, T, E> cache(backend, s.avatar, s.config, s.roles);
    check_frame(backend, cache, s);
    for (int step = 0; step < steps; ++step) {
        INFO(step);
        change(s, step);
        check_frame(backend, cache, s);
    }
}

} // namespace

TEST_CASE_TEMPLATE("frame cache: the bits of the whole frame over random drivers", T, float,
                   double) {
    const XsimdBackend lanes;
    follow<T>(lanes, local_shape(8, true), 25);
    follow<T>(lanes, local_shape(16, false), 8);
    follow<T>(lanes, local_shape(3, true), 8);                      // not in lanes
    follow<T>(lanes, {.capacity = 4, .doublings = 1}, 6);           // InstanceNorm
    follow<T>(lanes, {.capacity = 8, .doublings = 1, .norm = Normalization::none}, 6);
    follow<T>(ScalarBackend{}, local_shape(8, true), 5);
}

TEST_CASE("frame cache: the bits of the whole frame of an avatar of all that is trained") {
    follow<float, TrainedEffects>(XsimdBackend{}, local_shape(8, true), 25);
}

TEST_CASE("frame cache: the bits do not depend on the number of threads") {
    for (const int threads : {1, 2}) {
        ThreadPool pool(threads);
        follow<float>(XsimdBackend{pool.threads()}, local_shape(8, true), 12);
    }
}

TEST_CASE("frame cache: what is done is what changed") {
    Stage<float> s(local_shape(8, true));
    FrameCache<XsimdBackend<>, Balanced, float> cache({}, s.avatar, s.config, s.roles);
    const auto update = [&] {
        cache.update(s.drivers, s.camera, s.background);
        return cache.drive().work();
    };
    CHECK_THROWS_AS(cache.picture(), Error);
    const DriveWork all = update();
    const Index eyes = s.avatar.eyes.position.cols(), points = s.avatar.face.position.cols();
    CHECK(all.networks == 11);
    CHECK(all.eyes == 2);
    cache.picture();

    // Nothing.
    DriveWork w = update();
    cache.picture();
    CHECK(w.networks == 0);
    CHECK(cache.drive().changed().empty());
    CHECK(cache.render().work().projected == 0);
    CHECK(cache.render().work().blended == 0);
    CHECK(cache.upsampler().pixels() == 0);

    // One eye.
    const RestPose<float>& rest = cache.drive().rest();
    const auto around = [&](std::size_t eye) {
        return static_cast<Index>(rest.moved[2 + eye].points.size());
    };
    REQUIRE(around(0) > 0);
    REQUIRE(around(1) > 0);
    s.drivers.gaze[1] = Vec3<float>(0.1f, 0.2f, 0.9f).normalized();
    w = update();
    CHECK(w.networks == 2);
    CHECK(w.points == 2 * around(1));
    CHECK(w.summed == around(1));
    CHECK(w.eyes == 1);
    CHECK(cache.render().work().projected == around(1) + s.avatar.eyes.points_of(1));
    CHECK(cache.render().work().blended < cache.render().raster().trace.lists.tiles());
    cache.picture();
    CHECK(cache.upsampler().pixels() > 0);

    // Another camera: no deformation.
    s.camera.fx *= 1.01f;
    w = update();
    CHECK(w.networks == 0);
    CHECK(cache.drive().changed().empty());
    CHECK(cache.render().work().projected == points + eyes);

    // Another background: nothing is projected.
    s.background[0] = 0.25f;
    w = update();
    CHECK(w.networks == 0);
    CHECK(cache.render().work().projected == 0);

    // The scale: all Gaussians, and no network.
    s.drivers.scale = 1.05f;
    w = update();
    CHECK(w.networks == 0);
    CHECK(static_cast<Index>(cache.drive().changed().size()) == points + eyes);

    // The sign of a zero is a change; an unchanged NaN is none.
    s.drivers.expression[0] = 0.0f;
    update();
    s.drivers.expression[0] = -0.0f;
    CHECK(update().networks == 4);
    s.drivers.expression[0] = std::numeric_limits<float>::quiet_NaN();
    CHECK(update().networks == 4);
    CHECK(update().networks == 0);
    CHECK(cache.bytes() > 0);
}

TEST_CASE("frame cache: after a step of training, reset") {
    Stage<float> s(local_shape(8, true));
    FrameCache<XsimdBackend<>, Balanced, float> cache({}, s.avatar, s.config, s.roles);
    check_frame(XsimdBackend{}, cache, s);
    s.avatar.face.position.array() += 0.01f;
    s.avatar.eyes.opacity_logit.array() -= 0.5f;
    s.avatar.eyes.feature.array() *= 0.9f;
    cache.reset();
    check_frame(XsimdBackend{}, cache, s);
}

TEST_CASE("frame cache: a gaze that is none is refused, and the next frame is right") {
    Stage<float> s(local_shape(8, true));
    FrameCache<XsimdBackend<>, Balanced, float> cache({}, s.avatar, s.config, s.roles);
    check_frame(XsimdBackend{}, cache, s);
    const Vec3<float> before = s.drivers.gaze[0];
    s.drivers.gaze[0].setZero();
    CHECK_THROWS_AS(cache.update(s.drivers, s.camera, s.background), Error);
    s.drivers.gaze[0] = before;
    check_frame(XsimdBackend{}, cache, s);
}
