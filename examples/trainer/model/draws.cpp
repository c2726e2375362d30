// SPDX-License-Identifier: Apache-2.0
#include "model/draws.hpp"

#include <algorithm>
#include <cmath>

#include <rye/core/error.hpp>

namespace rye::trainer {

namespace {

/// Returns the element of a step, of all of which an epoch has each once.
template <class X>
X element_of_step(std::vector<X> order, Index step, const Random& random) {
    const Index n = static_cast<Index>(order.size());
    const Random epoch = random.fork(static_cast<std::uint64_t>(step / n));
    for (Index i = n - 1; i > 0; --i)
        std::swap(
            order[static_cast<std::size_t>(i)],
            order[static_cast<std::size_t>(epoch.below(static_cast<std::uint64_t>(i), i + 1))]);
    return order[static_cast<std::size_t>(step % n)];
}

} // namespace

int frame_of_step(const std::vector<int>& frames, Index step, const Random& random) {
    return element_of_step(frames, step, random);
}

FrameCamera picture_of_step(const std::vector<FrameCamera>& pictures, Index step,
                            const Random& random) {
    return element_of_step(pictures, step, random);
}

std::vector<FrameCamera> training_pictures(const Capture& capture) {
    std::vector<FrameCamera> all;
    for (const int frame : capture.train)
        for (const int camera : present_cameras(capture, frame)) all.push_back({frame, camera});
    return all;
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

Index total_steps(const MeshTrainConfig& stage, const Capture& capture) {
    if (stage.steps > 0) return stage.steps;
    const Index epochs = stage.epochs;
    if (stage.epochs_over == EpochsOver::frames)
        return epochs * static_cast<Index>(capture.train.size());
    const Index pictures = epochs * static_cast<Index>(training_pictures(capture).size());
    return (pictures + stage.views - 1) / stage.views;
}

Index total_steps(const AvatarTrainConfig& stage, const Capture& capture) {
    if (stage.steps > 0) return stage.steps;
    const std::size_t size = stage.epochs_over == EpochsOver::frames
                                 ? capture.train.size()
                                 : training_pictures(capture).size();
    const Index pictures = static_cast<Index>(stage.epochs) * static_cast<Index>(size);
    return (pictures + stage.views - 1) / stage.views;
}

SampleDraws::SampleDraws(const Capture& capture, const TrainConfig& config)
    : capture_(&capture),
      config_(&config),
      random_{config.seed, 0},
      total_(total_steps(config.gaussians, capture)) {
    if (config.gaussians.epochs_over == EpochsOver::pictures)
        pictures_ = training_pictures(capture);
}

SampleDraw SampleDraws::operator()(Index step, Index view) const {
    const AvatarTrainConfig& g = config_->gaussians;
    const Index number = step * g.views + view; // of all pictures of the stage
    const std::uint64_t key = static_cast<std::uint64_t>(number);
    SampleDraw d;
    d.step = step;
    if (pictures_.empty()) {
        d.frame = frame_of_step(capture_->train, number, random_.fork(5));
        const std::vector<int> cameras = present_cameras(*capture_, d.frame);
        d.camera = cameras[static_cast<std::size_t>(
            random_.fork(6).below(key, static_cast<Index>(cameras.size())))];
    } else {
        const FrameCamera p = picture_of_step(pictures_, number, random_.fork(5));
        d.frame = p.frame;
        d.camera = p.camera;
    }
    d.eyes_high = number % g.weights.eye_high_every == 0;
    d.scaled = g.augment;
    if (d.scaled) {
        const Pinhole<double>& camera = capture_->camera(d.frame, d.camera);
        const int factor = 1 << g.upsampler.doublings;
        const Pinhole<float> small = reduced(camera.cast<float>(), factor);
        d.scale = rye::detail::random_resizing(small.width, small.height, random_.fork(8).fork(key));
    }
    const Random color = random_.fork(7).fork(key);
    d.blank.resize(config_->avatar.channels);
    for (Index c = 0; c < d.blank.size(); ++c)
        d.blank(c) = static_cast<float>(color.uniform(static_cast<std::uint64_t>(c)));
    d.rate = std::sqrt(static_cast<double>(g.views)) * decayed(g.rate_decay, step, total_);
    return d;
}

StepShare share_of(const TrainConfig& config, const Ranks* ranks) {
    const int views = config.gaussians.views, size = ranks == nullptr ? 1 : ranks->size();
    require(views >= size, "gaussians.views", "got ", views, " pictures a step, expected ", size,
            " or more: one for each of the --ranks");
    return step_share(views, ranks == nullptr ? 0 : ranks->rank(), size);
}

AvatarSample<float> sample_of(const Capture& capture, const TrainConfig& config,
                              const SampleDraw& draw) {
    AvatarSample<float> s = avatar_sample(capture, config, draw.frame, draw.camera);
    s.eyes_high = draw.eyes_high;
    if (draw.scaled) {
        const int factor = 1 << config.gaussians.upsampler.doublings;
        s.scale = {rye::detail::resized_map(draw.scale),
                   rye::detail::resized_map(draw.scale * factor)};
    }
    s.blank = draw.blank;
    return s;
}

} // namespace rye::trainer
