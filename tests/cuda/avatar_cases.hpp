// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/avatar_cases.hpp: a whole avatar on a device against the host's in double: the driven
/// cloud and the gradients of every array, for the emulated device and a real one.
#pragma once

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <map>
#include <string>
#include <utility>

#include <rye/avatar/cuda/two_stream.hpp>
#include <rye/core/bits.hpp>

#include "../support/effect_sets.hpp"
#include "../support/hostile.hpp"
#include "../support/scenes.hpp"
#include "device_render.hpp"

namespace rye::test {

/// Relative errors: of the cloud, of gradients.
struct AvatarBounds {
    double cloud = 1e-5, gradient = 1e-5;
};

/// An avatar of floats, the same in double, and what drives both.
template <EffectSet E>
struct AvatarCase {
    AvatarConfig config = tiny_config();
    LandmarkRoles roles = tiny_roles();
    TwoStream<float, E> avatar;
    Drivers<float, E> drivers;
    Index column = -1; ///< of delta_pose
    SeenBy<float> view = {};

    AvatarCase(const TwoStream<double, E>& a, const Drivers<double, E>& d)
        : avatar(lifted<float>(a)),
          drivers(d.template cast<float>()) {
        // Points on every part of the ramps.
        config.exp_near = 0.02, config.exp_far = 0.3;
        config.gaze_near = 0.02, config.gaze_far = 0.5;
    }
};

/// The arrays of a gradient that are farther from the truth than `bound`, in words.
template <class T, EffectSet E>
std::string gradients_apart(const TwoStream<float, E>& found, const TwoStream<T, E>& truth,
                            double bound) {
    std::string apart;
    TwoStream<float, E>::fields(
        [&](const std::string& name, const auto& x, const auto& y) {
            const double gap = relative(x, y);
            if (!(gap <= bound)) apart += name + " by " + std::to_string(gap) + "\n";
        },
        found, truth);
    return apart;
}

/// Numbers in [-1, 1) in the shape of a cloud.
inline Gaussians<float> noise_like(Index count, Index channels) {
    return noise_like<float>(Gaussians<float>(count, channels), 50);
}

/// Copies a cloud into device memory.
template <class Device>
void send_cloud(const Device& device, const CudaQueue& queue, const Gaussians<float>& from,
                const DeviceGaussians<float>& to) {
    const auto send = [&](const Columns<float>& a, const DeviceColumns<float>& b) {
        REQUIRE(a.rows() == b.rows);
        REQUIRE(a.cols() == b.cols);
        device.send(queue, b.data, a.data(), static_cast<std::size_t>(a.size()) * sizeof(float));
    };
    send(from.mean, to.mean);
    send(from.rotation, to.rotation);
    send(from.scale, to.scale);
    send(from.opacity, to.opacity);
    send(from.feature, to.feature);
}
/// And out of it.
template <class Device>
Gaussians<float> fetch_cloud(const Device& device, const CudaQueue& queue,
                             const DeviceGaussians<float>& from) {
    Gaussians<float> g(from.count(), from.channels());
    const auto fetch = [&](Columns<float>& a, const DeviceColumns<float>& b) {
        device.fetch(queue, a.data(), b.data, static_cast<std::size_t>(a.size()) * sizeof(float));
    };
    fetch(g.mean, from.mean);
    fetch(g.rotation, from.rotation);
    fetch(g.scale, from.scale);
    fetch(g.opacity, from.opacity);
    fetch(g.feature, from.feature);
    return g;
}
inline bool same_cloud(const Gaussians<float>& a, const Gaussians<float>& b) {
    return same_bits(a.mean, b.mean) && same_bits(a.rotation, b.rotation) &&
           same_bits(a.scale, b.scale) && same_bits(a.opacity, b.opacity) &&
           same_bits(a.feature, b.feature);
}
inline Gaussians<float> nothing_yet(Index count, Index channels) {
    Gaussians<float> g(count, channels);
    Gaussians<float>::fields(
        [](const std::string&, auto& a) { a.setConstant(std::numeric_limits<float>::quiet_NaN()); },
        g);
    return g;
}

/// A cloud and the gradients that a device found.
template <EffectSet E>
struct DrivenOnDevice {
    Gaussians<float> cloud;
    TwoStream<float, E> gradient;
    Columns<float> pose;

    bool operator==(const DrivenOnDevice& o) const {
        bool same = same_cloud(cloud, o.cloud) && pose == o.pose;
        TwoStream<float, E>::fields(
            [&](const std::string&, const auto& x, const auto& y) { same = same && x == y; },
            gradient, o.gradient);
        return same;
    }
};

/// Drives the avatar and pulls a cotangent back, on a device, with everything poisoned before.
template <class Networks, EffectSet E, class Device>
DrivenOnDevice<E> drive_on(const Device& device, const CudaQueue& queue, const AvatarCase<E>& c,
                           const Gaussians<float>& cotangent) {
    DeviceTwoStream<E, Device, Networks> avatar(device, queue, {c.avatar, c.config, c.roles});
    send_cloud(device, queue, nothing_yet(avatar.cloud().count(), c.config.channels),
               avatar.cloud());
    avatar.set_drivers(queue, c.drivers, c.column, c.view);
    do {
        avatar.drive_into(queue);
    } while (!avatar.finish(queue));
    DrivenOnDevice<E> r{fetch_cloud(device, queue, avatar.cloud()), zeros_like(c.avatar), {}};
    Resident<TwoStream<float, E>, Device> gradient(device, queue, avatar.layout());
    send_cloud(device, queue, cotangent, avatar.g_cloud(queue));
    avatar.vjp_into(queue, gradient);
    gradient.fetch(queue, r.gradient);
    r.pose.resize(6, 1);
    device.fetch(queue, r.pose.data(), avatar.g_pose(), 6 * sizeof(float));
    TwoStream<float, E> back = zeros_like(c.avatar);
    avatar.download(queue, back);
    TwoStream<float, E>::fields(
        [&](const std::string&, const auto& x, const auto& y) { CHECK(x == y); }, back, c.avatar);
    return r;
}

/// All outputs and gradients against the host's in double.
template <class Networks, EffectSet E, class Device>
void avatar_against_host(const Device& device, const CudaQueue& queue, const AvatarCase<E>& c,
                         const AvatarBounds& bounds = {}) {
    const Index count = c.avatar.face.position.cols() + c.avatar.eyes.position.cols();
    const Gaussians<float> cotangent = noise_like(count, c.config.channels);
    const DrivenOnDevice<E> found = drive_on<Networks>(device, queue, c, cotangent);

    const TwoStream<double, E> avatar = lifted<double>(c.avatar);
    Drivers<double, E> drivers = c.drivers.template cast<double>();
    if constexpr (has_effect<E, ReadsHeadPose>)
        if (c.column >= 0) drivers.pose += avatar.delta_pose.col(c.column);
    [[maybe_unused]] bool gaze_corrected = false;
    if constexpr (has_effect<E, Kappa>) {
        gaze_corrected = c.column >= 0 && avatar.delta_gaze.size() > 0;
        if (gaze_corrected)
            for_eyes([&]<std::size_t eye>() {
                if constexpr (eye_turns<E, eye>) {
                    Vec3<double>& gaze = of_eye<eye>(drivers.gaze);
                    gaze =
                        detail::corrected_gaze(gaze, avatar.delta_gaze.col(c.column).data(), eye);
                }
            });
    }
    const ScalarBackend<Serial> host;
    TwoStreamTrace<double, E> trace;
    const SeenBy<double> view{c.view.column, c.view.pivot.template cast<double>()};
    drive(host, avatar, {c.config, c.roles, drivers, view}, trace);
    CHECK(relative(found.cloud, trace.gaussians) < bounds.cloud);
    TwoStream<double, E> gradient = zeros_like(avatar);
    Gaussians<double> g = converted<double>(cotangent);
    const Vec<double, 6> g_pose =
        drive_vjp(host, avatar, {c.config, c.roles, drivers, view}, trace, {g, gradient});
    if constexpr (has_effect<E, ReadsHeadPose>) {
        CHECK(relative(found.pose, Columns<double>(g_pose)) < bounds.gradient);
        if (c.column >= 0) gradient.delta_pose.col(c.column) += g_pose;
    }
    if constexpr (has_effect<E, Kappa>)
        if (gaze_corrected) {
            gradient.delta_gaze.col(c.column) = gradient.eyes.kappa.reshaped();
            CHECK(!gradient.delta_gaze.col(c.column).isZero(0));
        }
    if constexpr (has_effect<E, HeadPose>)
        if (view.column >= 0) CHECK(!gradient.delta_view.col(view.column).isZero(0));
    CHECK(gradients_apart(found.gradient, gradient, bounds.gradient) == "");
    if constexpr (has_effect<E, FaceDrivers>) { // some points move, and some do not
        bool some_rest = false;
        for_face_fields<E>([&](auto by) {
            const std::size_t moved = by.deform(trace.face).set.size();
            CHECK(moved > 0);
            some_rest =
                some_rest || moved < static_cast<std::size_t>(c.avatar.face.position.cols());
        });
        CHECK(some_rest);
    }
}

/// The case with corrections of the gazes of two frames, of which it shows the second, and of three
/// cameras, of which it is seen by the third.
template <EffectSet E>
AvatarCase<E> with_corrections(AvatarCase<E> c) {
    c.avatar.delta_gaze = 0.1F * noise<float>(4, 2, 51);
    c.column = 1;
    if constexpr (has_effect<E, HeadPose>) {
        c.avatar.delta_view = 0.05F * noise<float>(6, 3, 53);
        c.view = {2, Vec3<float>(0.3F, -0.2F, 0.5F)};
    }
    return c;
}

template <EffectSet E>
AvatarCase<E> case_with_parts() {
    return {avatar_with_parts<E>(), with_pupils(seen_drivers<E>(drivers_of_all()), {0.6, 1.5})};
}
/// Parts of the eyes, and shading, against the host's. Tiles have room for networks of 128.
template <class Networks, class Device>
void mechanisms_against_host(const Device& device, const CudaQueue& queue) {
    const auto check = [&](auto effects) {
        avatar_against_host<Networks>(device, queue, case_with_parts<decltype(effects)>());
    };
    using Still = More<PaperEffects, GazeBy<FixedEye>>;
    check(Still{});
    check(More<PaperEffects, GazeBy<LearnedQuaternion>>{});
    check(More<AllEffects, GazeBy<LearnedQuaternion>>{});
    check(More<Still, EyesBy<RotatedFeatures>>{});
    check(More<Still, EyesBy<ConditionedFeatures>>{});
    check(More<Still, EyesBy<RotatedCode>>{});
}
/// Driven features, refraction, pupils, shadows of lids, shading and colours by the view, with
/// kappa, a frame's correction of its pose and everything read.
using LitEffects = More<AllEffects, CornealRefraction, Glint, Pupil, LidShadow, HeadShading,
                        ViewColor, EyesBy<DrivenFeatures>>;

/// The same bits again, and in a cloud driven by other numbers before.
template <class Networks, EffectSet E, class Device>
void avatar_again(const Device& device, const CudaQueue& queue, const AvatarCase<E>& c) {
    const Index count = c.avatar.face.position.cols() + c.avatar.eyes.position.cols();
    const Gaussians<float> cotangent = noise_like(count, c.config.channels);
    const DrivenOnDevice<E> first = drive_on<Networks>(device, queue, c, cotangent);
    CHECK(first == drive_on<Networks>(device, queue, c, cotangent));
    AvatarCase<E> other = c;
    other.drivers.expression = -other.drivers.expression;
    other.drivers.pose = -other.drivers.pose;
    std::swap(other.drivers.gaze[0], other.drivers.gaze[1]);
    DeviceTwoStream<E, Device, Networks> avatar(device, queue, {c.avatar, c.config, c.roles});
    avatar.set_drivers(queue, other.drivers);
    avatar.drive_into(queue, false);
    CHECK(avatar.finish(queue));
    const Gaussians<float> before = fetch_cloud(device, queue, avatar.cloud());
    CHECK(!(before.mean == first.cloud.mean));
    avatar.set_drivers(queue, c.drivers, c.column, c.view);
    avatar.redrive_into(queue);
    CHECK(same_cloud(fetch_cloud(device, queue, avatar.cloud()), first.cloud));
}

/// The drivers with other gazes and pupils.
template <EffectSet E>
Drivers<float, E> gazing_elsewhere(Drivers<float, E> d, [[maybe_unused]] float aside) {
    for_eyes([&]<std::size_t eye>() {
        if constexpr (eye_turns<E, eye>) of_eye<eye>(d.gaze) += Vec3<float>(aside, -0.1F, 0);
        if constexpr (pupil_moves<E, eye>) of_eye<eye>(d.pupil) *= 1 + aside;
    });
    if constexpr (has_effect<E, ReadsCamera>) d.camera[0] += aside;
    return d;
}
/// The drivers with another expression and another head pose.
template <EffectSet E>
Drivers<float, E> of_another_face(Drivers<float, E> d) {
    if constexpr (has_effect<E, ReadsExpression>) d.expression = -d.expression;
    if constexpr (has_effect<E, ReadsHeadPose>) d.pose = -d.pose;
    return d;
}

/// Frames of which some differ in the gazes alone from the one before: redone as such they have the
/// bits of those that the drivers redo, whatever was driven before and differentiated.
template <class Networks, EffectSet E, class Device>
void avatar_by_gaze(const Device& device, const CudaQueue& queue, const AvatarCase<E>& c) {
    using Avatar = DeviceTwoStream<E, Device, Networks>;
    Avatar kept(device, queue, {c.avatar, c.config, c.roles}),
        plain(device, queue, {c.avatar, c.config, c.roles});
    const auto set = [&](const Drivers<float, E>& d) {
        kept.set_drivers(queue, d, c.column);
        plain.set_drivers(queue, d, c.column);
    };
    const auto cloud_of = [&](Avatar& avatar) {
        CHECK(avatar.finish(queue));
        return fetch_cloud(device, queue, avatar.cloud());
    };
    set(c.drivers);
    for (Avatar* avatar : {&kept, &plain}) do {
            avatar->drive_into(queue);
        } while (!avatar->finish(queue));
    Resident<TwoStream<float, E>, Device> gradient(device, queue, kept.layout());
    Gaussians<float> before = cloud_of(kept);
    send_cloud(device, queue, noise_like(before.count(), c.config.channels), kept.g_cloud(queue));
    kept.vjp_into(queue, gradient);
    const Drivers<float, E> other = of_another_face(c.drivers);
    struct Frame {
        Drivers<float, E> drivers;
        bool by_gaze;
    };
    const Frame frames[] = {{gazing_elsewhere(c.drivers, 0.2F), true},
                            {gazing_elsewhere(c.drivers, -0.3F), true},
                            {gazing_elsewhere(other, -0.3F), false},
                            {gazing_elsewhere(other, 0.2F), true},
                            {other, true},
                            {c.drivers, false},
                            {gazing_elsewhere(c.drivers, 0.2F), true}};
    for (const Frame& frame : frames) {
        set(frame.drivers);
        plain.redrive_into(queue);
        if (frame.by_gaze)
            kept.regaze_into(queue);
        else
            kept.redrive_into(queue);
        const Gaussians<float> found = cloud_of(kept);
        CHECK(same_cloud(found, cloud_of(plain)));
        CHECK(found.mean.allFinite());
        if constexpr (has_effect<E, AnyOf<LeftGaze, RightGaze>>)
            CHECK((!frame.by_gaze || !same_cloud(found, before)));
        before = found;
    }
}
/// The same for lists of effects and for parts. Tiles have room for networks of 128.
template <class Networks, class Device>
void variants_by_gaze(const Device& device, const CudaQueue& queue) {
    const auto check = [&](auto effects) {
        avatar_by_gaze<Networks>(device, queue, case_with_parts<decltype(effects)>());
    };
    check(AllEffects{});
    check(PaperEffects{});
    check(Effects<>{});
    check(Effects<LeftGaze>{});
    check(Effects<Expression, HeadPose, EyeOffset, RightGaze, Kappa>{});
    check(Effects<HeadPose, RightGaze, Periocular, Kappa>{});
    check(Effects<PoseResidual, LeftGaze, Periocular, HeadShading>{});
    using Still = More<PaperEffects, GazeBy<FixedEye>>;
    check(More<AllEffects, GazeBy<LearnedQuaternion>>{});
    check(More<Still, EyesBy<RotatedFeatures>>{});
    check(More<Still, EyesBy<ConditionedFeatures>>{});
    check(More<Still, EyesBy<RotatedCode>, HeadShading>{});
    AvatarCase<LitEffects> c = case_with_parts<LitEffects>();
    c.column = 1;
    avatar_by_gaze<Networks>(device, queue, c);
}

/// Points that wander: lists that have no room say so, their gradient is not a number, and the
/// frame driven again is right.
template <class Networks, EffectSet E, class Device>
void avatar_lists_grow(const Device& device, const CudaQueue& queue, AvatarCase<E> c) {
    c.config.exp_near = 0.001, c.config.exp_far = 0.002;
    c.avatar.face.position.array() += 3.0F; // far from all landmarks
    const auto near = [&](const AvatarCase<E>& of) {
        Columns<float> x = of.avatar.face.position;
        for (Index i = 0; i < x.cols(); ++i)
            x.col(i) = of.avatar.face.landmarks.col(i % of.avatar.face.landmarks.cols());
        return x;
    };
    DeviceTwoStream<E, Device, Networks> avatar(device, queue, {c.avatar, c.config, c.roles});
    avatar.set_drivers(queue, c.drivers);
    avatar.drive_into(queue);
    CHECK(avatar.finish(queue));
    AvatarCase<E> moved = c;
    moved.avatar.face.position = near(c);
    avatar.upload(queue, moved.avatar);
    avatar.drive_into(queue);
    Resident<TwoStream<float, E>, Device> gradient(device, queue, avatar.layout());
    const Gaussians<float> cotangent = noise_like(avatar.cloud().count(), c.config.channels);
    send_cloud(device, queue, cotangent, avatar.g_cloud(queue));
    avatar.vjp_into(queue, gradient);
    TwoStream<float, E> found = zeros_like(c.avatar);
    gradient.fetch(queue, found);
    CHECK(!found.face.opacity_logit.allFinite());
    CHECK(!avatar.finish(queue));
    avatar.drive_into(queue);
    CHECK(avatar.finish(queue));
    gradient.clear(queue);
    send_cloud(device, queue, cotangent, avatar.g_cloud(queue));
    avatar.vjp_into(queue, gradient);
    gradient.fetch(queue, found);
    const DrivenOnDevice<E> fresh = drive_on<Networks>(device, queue, moved, cotangent);
    const Gaussians<float> cloud = fetch_cloud(device, queue, avatar.cloud());
    CHECK(cloud.mean == fresh.cloud.mean);
    CHECK(cloud.feature == fresh.cloud.feature);
    CHECK(gradients_apart(found, fresh.gradient, 0.0) == "");
}

/// Checks what a device refuses.
template <class Networks, EffectSet E, class Device>
void avatar_bad_input(const Device& device, const CudaQueue& queue, const AvatarCase<E>& c) {
    using Avatar = DeviceTwoStream<E, Device, Networks>;
    Avatar avatar(device, queue, {c.avatar, c.config, c.roles});
    Drivers<float, E> drivers = c.drivers;
    drivers.expression = VecX<float>::Zero(7);
    CHECK_FAULT(avatar.set_drivers(queue, drivers), "expression has 7 numbers");
    drivers = c.drivers;
    drivers.pose[2] = std::nanf("");
    CHECK_FAULT(avatar.set_drivers(queue, drivers), "number 5 of the drivers");
    drivers = c.drivers;
    drivers.gaze[0].setZero();
    CHECK_FAULT(avatar.set_drivers(queue, drivers), "expected a finite direction");
    CHECK_FAULT(avatar.set_drivers(queue, c.drivers, 2), "column of delta_pose is 2");
    AvatarCase<E> corrected = with_corrections(c);
    Avatar views(device, queue, {corrected.avatar, corrected.config, corrected.roles});
    CHECK_FAULT(views.set_drivers(queue, c.drivers, 0, {3, {}}),
                "column of delta_view is 3, expected -1 to 2");
    // A gaze that a kernel wrote.
    avatar.set_drivers(queue, c.drivers);
    const float bad[3] = {0, std::numeric_limits<float>::quiet_NaN(), 1};
    device.send(queue, avatar.drivers() + detail::DriverPlaces<E>(c.config).gaze[1], bad,
                sizeof bad);
    avatar.drive_into(queue);
    CHECK_FAULT(avatar.finish(queue), "gaze of the right eye is not finite");
    AvatarCase<E> wrong = c;
    wrong.avatar.face.landmarks(1, 5) = std::numeric_limits<float>::infinity();
    CHECK_FAULT(Avatar(device, queue, {wrong.avatar, wrong.config, wrong.roles}),
                "a landmark is not finite");
    wrong = c;
    wrong.avatar.delta_gaze = Columns<float>::Zero(4, 3);
    CHECK_FAULT(Avatar(device, queue, {wrong.avatar, wrong.config, wrong.roles}),
                "delta_gaze is 4 x 3, expected 4 x 2");
    CHECK_FAULT(avatar.upload(queue, with_corrections(c).avatar), "not the layout's field");
    wrong = c;
    wrong.config.exp_near = 2;
    CHECK_FAULT(Avatar(device, queue, {wrong.avatar, wrong.config, wrong.roles}), "Ramp");
    const ResidentLayout<TwoStream<float, E>> elsewhere(c.avatar);
    const Resident<TwoStream<float, E>, Device> gradient(device, queue, elsewhere);
    CHECK_FAULT(avatar.vjp_into(queue, gradient), "of another layout");
}

/// A device that writes down what it launches.
template <class Device>
struct WritesDown {
    Device device;
    std::map<std::string, int>* launched = nullptr;

    template <class Kernel>
    void launch(const CudaQueue& queue, Index blocks, const Kernel& kernel) const {
        if (launched != nullptr && blocks > 0) ++(*launched)[Kernel::name];
        device.launch(queue, blocks, kernel);
    }
    void fill(const CudaQueue& q, void* p, int byte, std::size_t bytes) const {
        device.fill(q, p, byte, bytes);
    }
    void send(const CudaQueue& q, void* to, const void* from, std::size_t bytes) const {
        device.send(q, to, from, bytes);
    }
    void fetch(const CudaQueue& q, void* to, const void* from, std::size_t bytes) const {
        device.fetch(q, to, from, bytes);
    }
};

/// The kernels of a frame and its vjp, and how often each is launched; the memory beside the
/// parameters and clouds.
struct AvatarWork {
    std::map<std::string, int> launched;
    std::size_t bytes;
};
template <class Networks, EffectSet E, class Device>
AvatarWork avatar_work(const Device& on, const CudaQueue& queue, const AvatarCase<E>& c) {
    AvatarWork work{};
    const WritesDown<Device> device{on, &work.launched};
    DeviceTwoStream<E, WritesDown<Device>, Networks> avatar(device, queue,
                                                            {c.avatar, c.config, c.roles});
    Resident<TwoStream<float, E>, WritesDown<Device>> gradient(device, queue, avatar.layout());
    avatar.set_drivers(queue, c.drivers);
    const std::size_t clouds = avatar.parameters().bytes() + 2 * avatar.cloud_bytes();
    send_cloud(device, queue, noise_like(avatar.cloud().count(), c.config.channels),
               avatar.g_cloud(queue));
    work.launched.clear();
    avatar.drive_into(queue);
    avatar.vjp_into(queue, gradient);
    work.bytes = avatar.bytes() - clouds;
    return work;
}

/// Launches of a frame by what its drivers change.
struct WorkByDrivers {
    std::map<std::string, int> all, gaze;
};
template <class Networks, EffectSet E, class Device>
WorkByDrivers work_by_drivers(const Device& on, const CudaQueue& queue, const AvatarCase<E>& c) {
    WorkByDrivers work;
    WritesDown<Device> device{on, &work.all};
    DeviceTwoStream<E, WritesDown<Device>, Networks> avatar(device, queue,
                                                            {c.avatar, c.config, c.roles});
    avatar.set_drivers(queue, c.drivers);
    avatar.drive_into(queue, false);
    const std::size_t bytes = avatar.bytes();
    work.all.clear();
    avatar.redrive_into(queue);
    const std::map<std::string, int> before = work.all;
    avatar.regaze_into(queue);
    for (const auto& [name, times] : work.all)
        if (const auto at = before.find(name); at == before.end() || at->second < times)
            work.gaze[name] = times - (at == before.end() ? 0 : at->second);
    work.all = before;
    CHECK(avatar.bytes() == bytes);
    return work;
}

/// Drawn and differentiated: the image and all gradients against the host's in double.
template <class Networks, EffectSet E, class Device>
void avatar_drawn(const Device& device, const CudaQueue& queue, const AvatarCase<E>& c) {
    using A = FeaturesOnly<Exact32>;
    const Index channels = c.config.channels;
    DeviceTwoStream<E, Device, Networks> avatar(device, queue, {c.avatar, c.config, c.roles});
    avatar.set_drivers(queue, c.drivers);
    const DeviceRasterizer<A, Device, KernelChannels<8>> rasterizer{};
    const Pinhole<double> camera64 = tiny_camera(24, 20);
    const Pinhole<float> camera = camera64.cast<float>();
    const Index pixels = Index(camera.width) * camera.height;
    const Columns<float> background = noise<float>(channels, 1, 8),
                         weights = noise<float>(channels, pixels, 9);
    const DeviceArray<Device> of_background(device, queue, background),
        of_weights(device, queue, weights), feature(device, queue, channels, pixels),
        alpha(device, queue, 1, pixels);
    DeviceFrame<Device> frame(device);
    do {
        avatar.drive_into(queue);
        rasterizer.forward_into(queue, avatar.cloud(), camera, of_background.buffer.data(),
                                {feature.view(), alpha.view()}, frame);
    } while (!avatar.finish(queue) || !frame.finish(queue));
    rasterizer.vjp_into(queue, avatar.cloud(), camera, of_background.buffer.data(),
                        {of_weights.read()}, avatar.g_cloud(queue), frame);
    Resident<TwoStream<float, E>, Device> gradient(device, queue, avatar.layout());
    avatar.vjp_into(queue, gradient);
    TwoStream<float, E> found = zeros_like(c.avatar);
    gradient.fetch(queue, found);

    const ScalarBackend<Serial> host;
    const TwoStream<double, E> avatar64 = lifted<double>(c.avatar);
    const Drivers<double, E> drivers = c.drivers.template cast<double>();
    TwoStreamTrace<double, E> trace;
    drive(host, avatar64, {c.config, c.roles, drivers}, trace);
    const Rasterizer<A> plain{};
    const VecX<double> behind = background.template cast<double>();
    const auto truth = plain.forward(host, trace.gaussians, camera.template cast<double>(), behind);
    CHECK(truth.feature.pixels.allFinite());
    CHECK(relative(feature.get(), truth.feature.pixels) < 1e-5);
    Gaussians<double> g = plain.vjp(host, trace.gaussians, camera.template cast<double>(), behind,
                                    truth, Columns<double>(weights.template cast<double>()));
    TwoStream<double, E> expected = zeros_like(avatar64);
    drive_vjp(host, avatar64, {c.config, c.roles, drivers}, trace, {g, expected});
    CHECK(gradients_apart(found, expected, 1e-5) == "");
}

} // namespace rye::test
