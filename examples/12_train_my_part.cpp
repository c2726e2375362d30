// SPDX-License-Identifier: Apache-2.0
// Lesson 12: a part of your own, trained on a capture, with the headers alone. Here it is an
// influence: how much a landmark moves a point. `rye capture --png` makes a capture of PNGs:
//     lesson_12_train_my_part CAPTURE
#include <rye/rye.hpp>

#include <cstdio>
using namespace rye;

struct Bell { // 1 / (1 + (d2 / near)^2), whatever `far` is
    template <Scalar T>
    T value(const Ramp<T>& ramp, const T& squared) const {
        const T x = squared / ramp.near;
        return T(1) / (T(1) + x * x);
    }
    template <Scalar T>
    T slope(const Ramp<T>& ramp, const T& squared) const {
        const T x = squared / ramp.near, v = value(ramp, squared);
        return T(-2) * x * v * v / ramp.near;
    }
};
using Mine = More<PaperEffects, ExpressionInfluence<Bell>>;

int main(int count, char** arguments) try {
    const auto capture = read_capture(count > 1 ? arguments[1] : "capture", PngFiles{});
    const CaptureSubject subject = describe_subject(capture);
    const XsimdBackend backend{};
    AvatarConfig config{.expression = capture.expression_width(), .feature = 16, .channels = 8};
    config.networks = {{32}, {32}, {32}, {32}, {32}, {32}, {32}, {32}, {32}, {32}};
    const Vec3<float> middle = subject.head_centre.cast<float>(), half(1.75F, 1.75F, 1.75F);
    const Columns<float> neutral = subject.neutral.cast<float>();
    auto mesh = GuidanceMesh<float, Mine>::init(config, neutral, Random{1, 0}); // stage 1: a sphere
    pretrain_sphere<float>(backend, mesh, config, {middle, half.x(), 100, 1e-2}, Random{2, 0});
    AvatarInit<float, Mine> init{.grid = bcc_grid<float>(middle - half, middle + half, 0.2F)};
    for (std::size_t e : {0, 1}) init.eyeball[e] = eyeball_shape<Mine>(subject.sizes(e));
    init.eye_centre = subject.eye_centres().cast<float>();
    init.upsampler = {.in_channels = config.channels, .capacity = 8, .doublings = 1};
    init.frames = Index(capture.train.size());
    auto avatar = initialize_avatar<float>(backend, mesh, config, init, Random{3, 0});
    Adam<decltype(avatar)> adam(avatar);
    AvatarTrainer trainer{backend, avatar, adam, AvatarTraining<>{config, subject.roles}};
    const auto loss = [&](int step, double rate) { // before a step on the next camera
        const FrameCamera view{capture.train[0], step % capture.camera_count()};
        const auto s = avatar_sample(capture, {1, config.channels}, view);
        return trainer.step(restricted<Mine>(s.drivers), s, rate).losses.total;
    };
    const float before = loss(0, 0);
    for (int step = 0; step < 60; ++step) loss(step, 5);
    const float after = loss(0, 0);
    std::printf("loss %.3f before, %.3f after\n", before, after);
    return after < before ? 0 : 1;
} catch (const Error& e) { return std::fprintf(stderr, "%s\n", e.what()), 1; }
