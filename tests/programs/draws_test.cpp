// SPDX-License-Identifier: Apache-2.0
// What a step of stage 2 is shown: a function of configuration, seed and step; the same on the CPU
// and on a device.
#include "model/draws.hpp"

#include <algorithm>
#include <cmath>
#include <set>

#include <doctest/doctest.h>

#include "../support/hostile.hpp"
#include "tiny_capture.hpp"
#include "training/device_steps.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

TrainConfig settings(std::uint64_t seed = 7) {
    TrainConfig c = preset("tiny");
    c.seed = seed;
    c.gaussians.augment = true;
    c.gaussians.steps = 40;
    c.gaussians.weights.eye_high_every = 3;
    return c;
}

} // namespace

TEST_CASE("draws: frames, cameras, colours and scales by the run's streams of random numbers") {
    const TemporaryFolder folder;
    const TinyCapture files(folder.path);
    const Capture capture = read_capture(files.folder);
    const TrainConfig config = settings();
    const SampleDraws draws(capture, config);
    const Random random{config.seed, 0};
    CHECK(draws.total() == 40);
    for (Index step = 0; step < 12; ++step) {
        INFO(step);
        const std::uint64_t key = static_cast<std::uint64_t>(step);
        const SampleDraw d = draws(step);
        const std::vector<int> cameras = present_cameras(capture, d.frame);
        CHECK(d.frame == frame_of_step(capture.train, step, random.fork(5)));
        CHECK(d.camera == cameras[static_cast<std::size_t>(
                              random.fork(6).below(key, static_cast<Index>(cameras.size())))]);
        CHECK(d.eyes_high == (step % 3 == 0));
        CHECK(d.rate == std::pow(config.gaussians.rate_decay, static_cast<double>(step) / 40));
        const AvatarSample<float> s = sample_of(capture, config, d);
        const AvatarSample<float> plain = avatar_sample(capture, config, d.frame, d.camera);
        const Augmentation scale =
            random_scale(plain.camera.width, plain.camera.height, 2, random.fork(8).fork(key));
        CHECK(s.scale.small == scale.small);
        CHECK(s.scale.full == scale.full);
        CHECK(s.truth.pixels == plain.truth.pixels);
        CHECK(s.eyes_high == d.eyes_high);
        CHECK(s.frame == plain.frame);
        REQUIRE(s.blank.size() == config.avatar.channels);
        for (Index c = 0; c < s.blank.size(); ++c)
            CHECK(s.blank(c) == static_cast<float>(random.fork(7).fork(key).uniform(
                                    static_cast<std::uint64_t>(c))));
    }
}

TEST_CASE("draws: an epoch shows every frame once, in another order each time; seeds differ") {
    const TemporaryFolder folder;
    const TinyCapture files(folder.path);
    const Capture capture = read_capture(files.folder);
    const TrainConfig config = settings(), other = settings(8);
    const SampleDraws draws(capture, config), of_other(capture, other);
    const Index n = static_cast<Index>(capture.train.size());
    std::set<std::vector<int>> orders;
    bool differs = false;
    for (Index epoch = 0; epoch < 10; ++epoch) {
        std::vector<int> order;
        for (Index i = 0; i < n; ++i) {
            const SampleDraw d = draws(epoch * n + i);
            order.push_back(d.frame);
            differs = differs || d.blank != of_other(epoch * n + i).blank;
        }
        orders.insert(order);
        std::sort(order.begin(), order.end());
        CHECK(order == capture.train);
    }
    CHECK(orders.size() > 1);
    CHECK(differs);
}

TEST_CASE("draws: an epoch over pictures shows each once, in another order each time") {
    const TemporaryFolder folder;
    const TinyCapture files(folder.path);
    Capture capture = read_capture(files.folder);
    const std::size_t cameras = capture.camera_ids.size();
    REQUIRE(cameras > 1);
    capture.views[static_cast<std::size_t>(capture.train[0]) * cameras].present = false;
    const std::size_t n = capture.train.size() * cameras - 1;
    TrainConfig config = settings();
    config.gaussians.steps = 0;
    config.gaussians.epochs = 6;
    config.mesh.steps = 0;
    config.mesh.epochs = 6;
    config.mesh.views = 4;
    CHECK(total_steps(config.gaussians, capture) == 6 * Index(capture.train.size()));
    CHECK(total_steps(config.mesh, capture) == 6 * Index(capture.train.size()));
    config.gaussians.epochs_over = config.mesh.epochs_over = EpochsOver::pictures;
    CHECK(total_steps(config.mesh, capture) == (6 * Index(n) + 3) / 4);
    const SampleDraws draws(capture, config);
    CHECK(draws.total() == 6 * Index(n));
    std::set<std::vector<std::pair<int, int>>> orders;
    for (Index epoch = 0; epoch < 6; ++epoch) {
        std::vector<std::pair<int, int>> order;
        for (Index i = 0; i < Index(n); ++i) {
            const SampleDraw d = draws(epoch * Index(n) + i);
            CHECK(capture.view(d.frame, d.camera).present);
            order.emplace_back(d.frame, d.camera);
        }
        orders.insert(order);
        CHECK(std::set(order.begin(), order.end()).size() == n);
    }
    CHECK(orders.size() > 1);
    config.gaussians.steps = 7;
    CHECK(total_steps(config.gaussians, capture) == 7);
}

TEST_CASE("draws: no random scale where it is off") {
    const TemporaryFolder folder;
    const TinyCapture files(folder.path);
    const Capture capture = read_capture(files.folder);
    TrainConfig config = settings();
    config.gaussians.augment = false;
    const SampleDraw d = SampleDraws(capture, config)(5);
    CHECK_FALSE(d.scaled);
    CHECK_FALSE(sample_of(capture, config, d).scale.active());
}

TEST_CASE("draws: a chunk of steps ends where something reads the state") {
    AvatarTrainConfig g;
    g.panel_every = 50;
    g.checkpoint_every = 33;
    CHECK(chunk_end(0, 1000, g) == 20);
    CHECK(chunk_end(20, 1000, g) == 33);
    CHECK(chunk_end(33, 1000, g) == 40);
    CHECK(chunk_end(40, 1000, g) == 50);
    CHECK(chunk_end(50, 55, g) == 55);
    g.density.every = 7;
    g.density.first = 43;
    CHECK(chunk_end(40, 1000, g) == 49);
    CHECK(chunk_end(49, 1000, g) == 50);
    CHECK(chunk_end(50, 1000, g) == 56);
    g.density.every = 0;
    g.panel_every = 0;
    CHECK(chunk_end(40, 1000, g) == 60);
    Index step = 0;
    while (step < 200) {
        const Index end = chunk_end(step, 200, g);
        REQUIRE(end > step);
        for (Index k = step + 1; k < end; ++k) CHECK((k % 20 != 0 && k % 33 != 0));
        step = end;
    }
}

TEST_CASE("draws: a device's view has the bytes of the sample") {
    const TemporaryFolder folder;
    const TinyCapture files(folder.path);
    const Capture capture = read_capture(files.folder);
    const TrainConfig config = settings();
    for (const int frame : capture.train)
        for (const int camera : present_cameras(capture, frame)) {
            const TrainingView v = training_view(capture, config, frame, camera);
            const AvatarSample<float> s = avatar_sample(capture, config, frame, camera);
            REQUIRE(v.width == s.truth.width);
            REQUIRE(v.height == s.truth.height);
            REQUIRE(v.rgb.size() == 3 * v.mask.size());
            CHECK(v.frame == s.frame);
            CHECK(v.camera.width == s.camera.width);
            CHECK(v.camera.fx == s.camera.fx);
            bool same = true;
            for (std::size_t i = 0; i < v.mask.size(); ++i) {
                const Index at = static_cast<Index>(i);
                const float mask = static_cast<float>(v.mask[i]) / 255.0f;
                for (Index c = 0; c < 3; ++c)
                    same = same && s.truth.pixels(c, at) ==
                                       static_cast<float>(v.rgb[3 * i + std::size_t(c)]) / 255.0f +
                                           (1.0f - mask);
                same = same && s.visible(0, at) == static_cast<float>(v.visible[i]) / 255.0f &&
                       s.eyes(0, at) == static_cast<float>(v.eyes[i]) / 255.0f;
            }
            CHECK(same);
        }
}
