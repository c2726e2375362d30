// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/step_cases.hpp: whole training steps of stage 2 on a device against the host's in
/// double, for the emulated device and a real one.
#pragma once

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/train/cuda/avatar_trainer.hpp>

#include "../support/effect_sets.hpp"
#include "../support/hostile.hpp"
#include "avatar_cases.hpp"
#include "pictures.hpp"

namespace rye::test {

/// The parts of a training that a case turns on.
struct StepCase {
    bool measured = true; ///< losses as the preset `cpu` has them, else the paper's
    bool scaled = true;
    bool corrected = false;      ///< gazes of frames and cameras, and all corrections centred
    int width = 18, height = 14; ///< of the render [px]
    double gradient = 1e-5;      ///< relative error of the first one
};

/// A training of the tiny avatar on views of noise, on the host and ready for a device.
template <EffectSet E>
struct StepSceneOf {
    static constexpr int factor = 2;
    AvatarConfig config = tiny_config();
    AvatarTraining<> training;
    TwoStream<double, E> avatar = avatar_with_parts<E>();
    std::vector<TrainingView> views;
    std::vector<Drivers<double, E>> drivers;
    std::vector<StepDraw> draws;

    explicit StepSceneOf(const StepCase& c) {
        // Points on every part of the ramps, and none whose brightness is at a cut.
        config.exp_near = 0.02, config.exp_far = 0.3;
        config.gaze_near = 0.02, config.gaze_far = 0.5;
        training.config = config;
        training.roles = tiny_roles();
        AvatarLossConfig& w = training.objective.weights;
        if (c.measured) {
            w.dssim = 0.2, w.face_alone = 1;
            w.eye_smooth = 0.2, w.eye_high_every = 2;
            w.face_smooth = 0.5, w.face_mirror = 0.3;
            training.face_neighbours =
                face_neighbours(ScalarBackend<Serial>{}, avatar.face.position, w);
            training.bounds = {0.7, 0.1};
        }
        if constexpr (has_effect<E, Kappa>)
            if (c.corrected) {
                avatar.delta_gaze = 0.05 * noise<double>(4, avatar.delta_pose.cols(), 52);
                training.rates.delta_gaze = 1e-3;
                training.centred_corrections = true;
                if constexpr (has_effect<E, HeadPose>) {
                    avatar.delta_view = 0.05 * noise<double>(6, 2, 54);
                    training.view_directions.resize(3, 2);
                    training.view_directions << -0.6, 0.6, 0, 0, 0.8, 0.8;
                    training.rates.delta_view = 1e-3;
                    training.rates.delta_view_from = 2;
                }
            }
        for (std::uint64_t v = 0; v < 3; ++v) {
            TrainingView view;
            view.camera = tiny_camera(c.width, c.height).template cast<float>();
            view.camera.cx += static_cast<float>(v);
            view.frame = static_cast<Index>(v) - 1;
            view.view = {static_cast<Index>(v % 2), Vec3<float>(0.3F, -0.2F, 0.5F)};
            view.width = factor * c.width, view.height = factor * c.height;
            const auto bytes = [&](int channels, std::uint64_t seed) {
                const Image<float> p =
                    byte_picture(view.width, view.height, channels, 10 * v + seed);
                std::vector<std::uint8_t> r;
                for (Index i = 0; i < p.pixels.size(); ++i)
                    r.push_back(static_cast<std::uint8_t>(std::lround(p.pixels(i) * 255.0F)));
                return r;
            };
            view.mask = bytes(1, 1);
            view.rgb = bytes(3, 2);
            for (std::size_t i = 0; i < view.rgb.size(); ++i) // over black: no more than its mask
                view.rgb[i] = std::min(view.rgb[i], view.mask[i / 3]);
            view.visible.assign(view.mask.size(), 255);
            view.visible[7] = 0;
            view.eyes.assign(view.mask.size(), 0);
            for (std::size_t i = 200; i < 330; ++i) view.eyes[i] = i % 3 == 0 ? 100 : 255;
            views.push_back(view);
            Drivers<double, E> d = restricted<E>(drivers_of_all());
            d.expression *= 1.0 - 0.3 * static_cast<double>(v);
            // As the device has them.
            drivers.push_back(d.template cast<float>().template cast<double>());
        }
        for (Index k = 0; k < 6; ++k) {
            StepDraw d;
            d.view = (2 * k) % 3;
            d.eyes_high = k % 2 == 0 || !c.measured;
            d.scaled = c.scaled;
            const Random random = Random(4).fork(static_cast<std::uint64_t>(k));
            if (c.scaled) d.scale = detail::random_resizing(c.width, c.height, random);
            for (std::size_t i = 0; i < 3; ++i)
                d.blank[i] = static_cast<float>(random.uniform(5 + i));
            d.rate = 1.0 - 0.1 * static_cast<double>(k);
            draws.push_back(d);
        }
    }

    /// A draw's pictures as the host's trainer takes them.
    AvatarSample<double, E> sample(const StepDraw& d) const {
        const TrainingView& v = views[static_cast<std::size_t>(d.view)];
        const Index full = Index(v.width) * v.height;
        AvatarSample<double, E> s;
        s.drivers = drivers[static_cast<std::size_t>(d.view)];
        s.frame = v.frame;
        s.view = {v.view.column, v.view.pivot.template cast<double>()};
        s.camera = v.camera.template cast<double>();
        s.truth = Image<double>(v.width, v.height, 3);
        s.visible.resize(1, full), s.eyes.resize(1, full);
        Columns<double> mask(1, full);
        const auto share = [](std::uint8_t x) { return static_cast<double>(x) / 255.0; };
        for (Index i = 0; i < full; ++i) {
            const std::size_t at = static_cast<std::size_t>(i);
            mask(0, i) = share(v.mask[at]);
            s.visible(0, i) = share(v.visible[at]), s.eyes(0, i) = share(v.eyes[at]);
            for (Index c = 0; c < 3; ++c)
                s.truth.pixels(c, i) =
                    share(v.rgb[3 * at + static_cast<std::size_t>(c)]) + 1 - mask(0, i);
        }
        const int w = v.width / factor, h = v.height / factor;
        const auto small = [&](const Columns<double>& from) {
            Columns<double> r = Columns<double>::Zero(from.rows(), Index(w) * h);
            for (int y = 0; y < v.height; ++y)
                for (int x = 0; x < v.width; ++x)
                    r.col(Index(y / factor) * w + x / factor) +=
                        from.col(Index(y) * v.width + x) / (factor * factor);
            return r;
        };
        s.truth_small = Image<double>(w, h, 3);
        s.truth_small.pixels = small(s.truth.pixels);
        s.visible_small = small(s.visible), s.eyes_small = small(s.eyes),
        s.mask_small = small(mask);
        s.eyes_high = d.eyes_high;
        if (d.scaled)
            s.scale = {detail::resized_map(d.scale), detail::resized_map(d.scale * factor)};
        s.background = VecX<double>::Ones(config.channels);
        s.blank = s.background;
        for (Index c = 0; c < 3; ++c)
            s.blank(c) = static_cast<double>(d.blank[static_cast<std::size_t>(c)]);
        return s;
    }
};
using StepScene = StepSceneOf<AllEffects>;

/// A trainer of such a scene on a device, as it is at first or as another left off.
template <class Device, class Policy, EffectSet E = AllEffects>
struct StepsOnDevice {
    using Avatar = TwoStream<float, E>;
    const CudaQueue& queue;
    Avatar avatar;
    Adam<Avatar> adam;
    DevicePyramidLoss<Device> pyramid;
    std::unique_ptr<DeviceAvatarTrainer<E, Device, Policy>> trainer;

    StepsOnDevice(const Device& device, const CudaQueue& q, const StepSceneOf<E>& scene)
        : queue(q),
          avatar(lifted<float>(scene.avatar)),
          adam(avatar),
          pyramid(device) {
        begin(device, scene);
    }
    /// With so many of the views on the device, and the rest in this memory of the host.
    StepsOnDevice(const Device& device, const CudaQueue& q, const StepSceneOf<E>& scene,
                  Index on_device, const DeviceArena& host)
        : queue(q),
          avatar(lifted<float>(scene.avatar)),
          adam(avatar),
          pyramid(device) {
        make(device, scene);
        trainer->views().keep_beyond(on_device, host);
        add_views(scene);
    }
    StepsOnDevice(const Device& device, const StepSceneOf<E>& scene, const StepsOnDevice& from)
        : queue(from.queue),
          avatar(from.avatar),
          adam(from.adam),
          pyramid(device) {
        begin(device, scene);
    }
    DeviceStepsReport run(const std::vector<StepDraw>& draws) {
        const DeviceStepsReport r = trainer->run(queue, draws);
        trainer->fetch(queue, avatar, adam);
        return r;
    }
    /// The trainer made again of what was fetched, with the views of the one before.
    void renew(const Device& device, const StepSceneOf<E>& scene) {
        DeviceViews<Device> views(device, trainer->views().factor());
        views.take(trainer->views());
        trainer.reset();
        make(device, scene);
        trainer->views().take(views);
    }
    /// The fields that differ in a bit, in words.
    std::string differs(const StepsOnDevice& other) const {
        std::string names;
        Avatar::fields(
            [&](const std::string& name, const auto& a, const auto& b, const auto& m,
                const auto& m2, const auto& v, const auto& v2) {
                if (!(a == b && m == m2 && v == v2)) names += name + " ";
            },
            avatar, other.avatar, adam.m, other.adam.m, adam.v, other.adam.v);
        if (adam.step != other.adam.step || adam.field_steps != other.adam.field_steps)
            names += "counts";
        return names;
    }

  private:
    void make(const Device& device, const StepSceneOf<E>& scene) {
        trainer = std::make_unique<DeviceAvatarTrainer<E, Device, Policy>>(
            device, queue, AvatarAndAdam<E>{avatar, adam}, scene.training, pyramid);
    }
    void begin(const Device& device, const StepSceneOf<E>& scene) {
        make(device, scene);
        add_views(scene);
    }
    void add_views(const StepSceneOf<E>& scene) {
        for (std::size_t v = 0; v < scene.views.size(); ++v)
            trainer->add(queue, scene.views[v], scene.drivers[v].template cast<float>());
    }
};

inline AvatarLosses<double> as_double(const AvatarLosses<float>& l) {
    AvatarLosses<double> r;
    std::vector<double> all;
    AvatarLosses<float>::fields([&](const char*, float x) { all.push_back(x); }, l);
    auto at = all.begin();
    AvatarLosses<double>::fields([&](const char*, double& x) { x = *at++; }, r);
    return r;
}

/// Losses of every step, and the means of gradients after the first, are the host's in double.
template <class Policy, EffectSet E = AllEffects, class Device>
void steps_against_host(const Device& device, const CudaQueue& queue, const StepCase& c) {
    CAPTURE(c.measured);
    const StepSceneOf<E> scene(c);
    TwoStream<double, E> avatar = lifted<double>(lifted<float>(scene.avatar));
    Adam<TwoStream<double, E>> adam(avatar);
    AvatarTrainer host{ScalarBackend<Serial>{}, avatar, adam, scene.training};
    StepsOnDevice<Device, Policy, E> own(device, queue, scene);
    for (std::size_t k = 0; k < scene.draws.size(); ++k) {
        CAPTURE(k);
        const AvatarLosses<double> l =
            host.step(scene.sample(scene.draws[k]), scene.draws[k].rate).losses;
        const DeviceStepsReport r = own.run({scene.draws[k]});
        const auto same = [&](const char* name, float x, double y) {
            CAPTURE(name);
            CHECK(std::abs(static_cast<double>(x) - y) <= 1e-4 * std::abs(y));
        };
        same("high_resolution", r.losses.high_resolution, l.high_resolution);
        same("low_resolution", r.losses.low_resolution, l.low_resolution);
        same("perceptual", r.losses.perceptual, l.perceptual);
        same("dssim", r.losses.dssim, l.dssim);
        same("eye_low", r.losses.eye_low, l.eye_low);
        same("eye_high", r.losses.eye_high, l.eye_high);
        same("blank", r.losses.blank, l.blank);
        same("face_alone", r.losses.face_alone, l.face_alone);
        same("eye_smooth", r.losses.eye_smooth, l.eye_smooth);
        same("face_smooth", r.losses.face_smooth, l.face_smooth);
        same("face_mirror", r.losses.face_mirror, l.face_mirror);
        CHECK(((l.face_smooth > 0) == c.measured && (l.face_mirror > 0) == c.measured));
        same("total", r.losses.total, l.total);
        CHECK(r.losses.total > 0);
        CHECK(r.bad_field == "");
        CHECK(r.steps == static_cast<Index>(k) + 1);
        CHECK(own.adam.step == adam.step);
        if (k == 0) CHECK(gradients_apart(own.adam.m, adam.m, c.gradient) == "");
    }
    if constexpr (has_effect<E, Kappa>)
        if (c.corrected) {
            const auto centred = [](const auto& a) {
                return a.rowwise().mean().cwiseAbs().maxCoeff() <= 1e-8;
            };
            CHECK((centred(own.avatar.delta_gaze) && centred(own.avatar.delta_pose)));
            CHECK((centred(avatar.delta_gaze) && centred(avatar.delta_pose)));
            CHECK(!own.avatar.delta_gaze.isZero(1e-3F));
            CHECK(relative(own.avatar.delta_gaze, avatar.delta_gaze) <= 1e-3);
            CHECK(relative(own.avatar.delta_pose, avatar.delta_pose) <= 1e-3);
            if constexpr (has_effect<E, HeadPose>) {
                const Columns<double> gauge = detail::view_gauge(scene.training.view_directions);
                Columns<double> centred_views = avatar.delta_view;
                detail::centre_views(gauge, centred_views);
                CHECK((centred_views - avatar.delta_view).cwiseAbs().maxCoeff() <= 1e-8);
                CHECK(!own.avatar.delta_view.isZero(1e-3F));
                CHECK(relative(own.avatar.delta_view, avatar.delta_view) <= 1e-3);
            }
        }
}

/// Steps of several pictures are the host's in double.
template <class Policy, class Device>
void steps_of_pictures(const Device& device, const CudaQueue& queue, Index pictures) {
    using E = AllEffects;
    const StepScene scene({});
    TwoStream<double, E> avatar = lifted<double>(lifted<float>(scene.avatar));
    Adam<TwoStream<double, E>> adam(avatar);
    AvatarTrainer host{ScalarBackend<Serial>{}, avatar, adam, scene.training};
    StepsOnDevice<Device, Policy, E> own(device, queue, scene);
    own.trainer->share_steps(queue, {{0, pictures, pictures}});
    for (std::size_t k = 0; k < scene.draws.size(); k += static_cast<std::size_t>(pictures)) {
        CAPTURE(k);
        std::vector<StepDraw> draws;
        for (std::size_t i = k; i < k + static_cast<std::size_t>(pictures); ++i) {
            draws.push_back(scene.draws[i]);
            draws.back().rate = scene.draws[k].rate;
            const AvatarSample<double, E> sample = scene.sample(draws.back());
            host.add(sample.drivers, sample, pictures);
        }
        const AvatarLosses<double> l = host.take(Alone{}, draws[0].rate).losses;
        const DeviceStepsReport r = own.run(draws);
        AvatarLosses<double>::fields(
            [](const char* name, double x, double y) {
                CAPTURE(name);
                CHECK(std::abs(x - y) <= 1e-4 * std::abs(y));
            },
            as_double(r.losses), l);
        CHECK((r.losses.total > 0 && r.bad_field == "" && !r.asked));
        CHECK(own.adam.step == adam.step);
        if (k == 0) CHECK(gradients_apart(own.adam.m, adam.m, 1e-5) == "");
    }
    CHECK_THROWS_WITH(own.run({scene.draws[0]}),
                      ("DeviceAvatarTrainer: got 1 draws, expected a multiple of " +
                       std::to_string(pictures)).c_str());
}

/// Rows are centred with the host's bits, but not by a step that Adam has not applied.
template <class Device>
void rows_centred(const Device& device, const CudaQueue& queue) {
    for (const Index cols : {1, 2, 1001}) {
        const Columns<float> before = noise<float>(6, cols, 53).array() + 0.3F;
        Columns<float> expected = before;
        detail::centre_rows(expected);
        CHECK(expected.rowwise().mean().cwiseAbs().maxCoeff() <= 1e-6F);
        const DeviceArray<Device> array(device, queue, before);
        DeviceBuffer<DeviceAdamState> adam;
        adam.reserve(queue, 1);
        const auto centre = [&](std::uint32_t bad) {
            const DeviceAdamState state{bad, DeviceAdamState::none_bad, 1};
            device.send(queue, adam.data(), &state, sizeof state);
            device.launch(queue, 1, detail::CentreRowsKernel{adam.data(), array.view()});
            return array.get();
        };
        CHECK(same_bits(centre(DeviceAdamState::stopped), before));
        CHECK(same_bits(centre(0), expected));
    }
}

/// However many steps a run takes, resumed from what was fetched, and by a trainer that takes the
/// views of another one, the bits are the same.
template <class Policy, class Device>
void steps_again(const Device& device, const CudaQueue& queue) {
    StepScene scene({.corrected = true});
    scene.draws.resize(4);
    StepsOnDevice<Device, Policy> whole(device, queue, scene), parts(device, queue, scene);
    const float last = whole.run(scene.draws).losses.total;
    const auto cut = scene.draws.begin() + 2;
    parts.run({scene.draws.begin(), cut});
    StepsOnDevice<Device, Policy> resumed(device, scene, parts);
    parts.renew(device, scene);
    parts.run({cut, scene.draws.end()});
    CHECK(whole.differs(parts) == "");
    CHECK(resumed.run({cut, scene.draws.end()}).losses.total == last);
    CHECK(whole.differs(resumed) == "");
    // Twice the same: a graph, where there are some, after steps that were not.
    whole.run(scene.draws), parts.run(scene.draws);
    CHECK(whole.differs(parts) == "");
    CHECK(whole.differs(resumed) != "");
}

/// Views in the host's memory, all of them or what does not fit, give the bits of those in the
/// device's, also where lists lack room and by a trainer that takes them over.
template <class Policy, class Device>
void steps_from_host(const Device& device, const CudaQueue& queue, const DeviceArena& page_locked) {
    StepScene scene({});
    scene.draws.resize(4); // more than there are places
    StepsOnDevice<Device, Policy> resident(device, queue, scene);
    resident.run(scene.draws);
    CHECK(resident.trainer->views().bytes_on_host() == 0);
    for (const Index most : {0, 1}) { // of three
        CAPTURE(most);
        StepsOnDevice<Device, Policy> own(device, queue, scene, most, page_locked);
        CHECK(own.trainer->views().on_host(1));
        CHECK(own.trainer->views().on_host(0) == (most == 0));
        CHECK(own.trainer->views().bytes_on_host() > 0);
        if (most > 0) {
            own.run(scene.draws);
        } else {
            own.trainer->frame(0).entry_capacity = 5;
            const auto cut = scene.draws.begin() + 1;
            own.run({scene.draws.begin(), cut});
            own.renew(device, scene);
            own.run({cut, scene.draws.end()});
        }
        CHECK(resident.differs(own) == "");
    }
}

/// A trainer holds what it says, and an idle one of the same avatar says the same.
template <class Policy, class Device>
void steps_counted(const Device& device, const CudaQueue& queue, const DeviceArena& page_locked) {
    const StepScene scene({.corrected = true});
    for (const Index pictures : {1, 2}) {
        CAPTURE(pictures);
        constexpr std::size_t all = std::size_t(1) << 40U;
        LimitedMemory memory{queue.memory, all};
        IdleMemory nowhere;
        const CudaQueue counted{queue.stream, memory}, idle{queue.stream, nowhere, true};
        StepsOnDevice<Device, Policy> own(device, counted, scene, 1, page_locked),
            would(device, idle, scene, 1, nowhere);
        const DeviceTwoStream<AllEffects, Device, typename Policy::Networks> avatar(
            device, queue, {own.avatar, scene.config, scene.training.roles});
        would.trainer->make_room(avatar.listed(queue));
        for (auto* const steps : {&own, &would}) {
            steps->trainer->share_steps(steps->queue, {{0, pictures, pictures}});
            steps->run(scene.draws);
        }
        const DeviceStepsMemory held = own.trainer->memory(), said = would.trainer->memory();
        CHECK(held.sum() + own.pyramid.bytes() == all - memory.left);
        CHECK(own.pyramid.bytes() == would.pyramid.bytes());
        CHECK(said.parameters == held.parameters);
        CHECK(said.pictures == held.pictures);
        CHECK(said.networks == held.networks);
        CHECK(said.renders == held.renders);
        CHECK(said.upsampler == held.upsampler);
        CHECK(said.losses == held.losses);
    }
}

/// Checks that steps whose lists have no room wait for it and are taken then, with the bits of a
/// trainer that has had room from the beginning.
template <class Policy, class Device>
void steps_make_room(const Device& device, const CudaQueue& queue) {
    StepScene scene({});
    scene.draws.resize(2);
    StepsOnDevice<Device, Policy> roomy(device, queue, scene), tight(device, queue, scene);
    for (std::size_t k = 0; k < step_renders; ++k) {
        tight.trainer->frame(k).entry_capacity = k == 2 ? 1000 : 5;
        tight.trainer->frame(k).group_capacity = k == 1 ? 1000 : 2;
    }
    roomy.run(scene.draws);
    const DeviceStepsReport r = tight.run(scene.draws);
    CHECK(r.steps == static_cast<Index>(scene.draws.size()));
    CHECK(tight.adam.step == static_cast<std::int64_t>(scene.draws.size()));
    CHECK(roomy.differs(tight) == "");
    for (std::size_t k = 0; k < step_renders; ++k)
        CHECK((tight.trainer->frame(k).entry_capacity > 5 &&
               tight.trainer->frame(k).group_capacity > 2));
}

/// A gradient that is not finite changes nothing, and is named; bad input is refused.
template <class Policy, class Device>
void steps_refused(const Device& device, const CudaQueue& queue) {
    StepScene scene({.corrected = true});
    StepsOnDevice<Device, Policy> own(device, queue, scene);
    own.run({scene.draws[0]});
    StepScene bad = scene;
    bad.avatar.upsampler.out_bias(1, 0) = std::numeric_limits<double>::quiet_NaN();
    StepsOnDevice<Device, Policy> broken(device, queue, bad);
    const auto before = broken.avatar;
    const DeviceStepsReport r = broken.run({scene.draws[0], scene.draws[1], scene.draws[2]});
    CHECK(r.refused_in_a_row == 3);
    CHECK(r.steps == 3);
    CHECK(r.bad_field != "");
    CHECK(broken.adam.step == 0);
    CHECK(broken.avatar.face.feature == before.face.feature);
    CHECK(broken.avatar.delta_gaze == before.delta_gaze); // not centred either

    std::vector<StepDraw> draws = {scene.draws[0]};
    draws[0].view = 3;
    CHECK_FAULT(own.run(draws), "step 0 shows view 3, there are 3");
    TrainingView v = scene.views[0];
    const Drivers<float, AllEffects> d = scene.drivers[0].template cast<float>();
    v.frame = 2;
    CHECK_FAULT(own.trainer->add(queue, v, d), "view 3: frame is 2, expected -1 to 1");
    v = scene.views[0];
    v.width = 33;
    CHECK_FAULT(own.trainer->add(queue, v, d),
                "view 3: width is 33, expected a positive multiple of 2");
    v = scene.views[0];
    v.eyes.pop_back();
    CHECK_FAULT(own.trainer->add(queue, v, d), "view 3: eyes has 1007 bytes, expected 1008");
    v = scene.views[0];
    v.camera.width = 17;
    CHECK_FAULT(own.trainer->add(queue, v, d),
                "view 3: its camera has 17 x 14 pixels, expected 18 x 14");
}

} // namespace rye::test
