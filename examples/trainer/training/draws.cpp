// SPDX-License-Identifier: Apache-2.0
#include "training/draws.hpp"

#include <algorithm>
#include <cmath>

#include <rye/core/error.hpp>

namespace rye::trainer {

int frame_of_step(const std::vector<int>& frames, Index step, const Random& random) {
    const Index n = static_cast<Index>(frames.size());
    const Random epoch = random.fork(static_cast<std::uint64_t>(step / n));
    std::vector<int> order = frames;
    for (Index i = n - 1; i > 0; --i)
        std::swap(
            order[static_cast<std::size_t>(i)],
            order[static_cast<std::size_t>(epoch.below(static_cast<std::uint64_t>(i), i + 1))]);
    return order[static_cast<std::size_t>(step % n)];
}

std::vector<int> present_cameras(const Capture& capture, int frame) {
    std::vector<int> all;
    for (int c = 0; c < capture.camera_count(); ++c)
        if (capture.view(frame, c).present) all.push_back(c);
    require(
        !all.empty(),
        capture.folder.string() + ": frame " + capture.frames[static_cast<std::size_t>(frame)].id,
        "no camera has an image of it");
    return all;
}

double decayed(double decay, Index step, Index total) {
    return std::pow(decay,
                    static_cast<double>(step) / static_cast<double>(std::max<Index>(total, 1)));
}

Index total_steps(int steps, int epochs, const Capture& capture) {
    return steps > 0 ? steps
                     : static_cast<Index>(epochs) * static_cast<Index>(capture.train.size());
}

SampleDraws::SampleDraws(const Capture& capture, const TrainConfig& config)
    : capture_(&capture),
      config_(&config),
      random_{config.seed, 0},
      total_(total_steps(config.gaussians.steps, config.gaussians.epochs, capture)) {}

SampleDraw SampleDraws::operator()(Index step) const {
    const AvatarTrainConfig& g = config_->gaussians;
    const std::uint64_t key = static_cast<std::uint64_t>(step);
    SampleDraw d;
    d.step = step;
    d.frame = frame_of_step(capture_->train, step, random_.fork(5));
    const std::vector<int> cameras = present_cameras(*capture_, d.frame);
    d.camera = cameras[static_cast<std::size_t>(
        random_.fork(6).below(key, static_cast<Index>(cameras.size())))];
    d.eyes_high = step % g.weights.eye_high_every == 0;
    d.scaled = g.augment;
    if (d.scaled) {
        const Pinhole<double>& camera = capture_->camera(d.frame, d.camera);
        const int factor = 1 << g.upsampler.doublings;
        const Pinhole<float> small = reduced(camera.cast<float>(), factor);
        d.scale = detail::random_resizing(small.width, small.height, random_.fork(8).fork(key));
    }
    const Random color = random_.fork(7).fork(key);
    d.blank.resize(config_->avatar.channels);
    for (Index c = 0; c < d.blank.size(); ++c)
        d.blank(c) = static_cast<float>(color.uniform(static_cast<std::uint64_t>(c)));
    d.rate = decayed(g.rate_decay, step, total_);
    return d;
}

AvatarSample<float> sample_of(const Capture& capture, const TrainConfig& config,
                              const SampleDraw& draw) {
    AvatarSample<float> s = avatar_sample(capture, config, draw.frame, draw.camera);
    s.eyes_high = draw.eyes_high;
    if (draw.scaled) {
        const int factor = 1 << config.gaussians.upsampler.doublings;
        s.scale = {detail::resized_map(draw.scale), detail::resized_map(draw.scale * factor)};
    }
    s.blank = draw.blank;
    return s;
}

} // namespace rye::trainer
