// SPDX-License-Identifier: Apache-2.0
#include "training/device_steps.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include <rye/io/lpips_weights.hpp>
#include <rye/train/density.hpp>

#include "data/threads.hpp"
#include "device/choice.hpp"
#include "training/avatar_training.hpp"

namespace rye::trainer {
namespace {

/// Returns numbers as bytes, 255 for 1, rounded; numbers that came from bytes return unchanged.
std::vector<std::uint8_t> bytes_of(const Image<float>& image) {
    std::vector<std::uint8_t> bytes;
    bytes.reserve(static_cast<std::size_t>(image.pixels.size()));
    for (Index i = 0; i < image.pixels.size(); ++i)
        bytes.push_back(static_cast<std::uint8_t>(
            std::lround(255 * std::clamp(image.pixels.data()[i], 0.0f, 1.0f))));
    return bytes;
}

template <EffectSet E>
class DeviceStepsOf final : public DeviceSteps {
  public:
    DeviceStepsOf(const TrainState& state, const Capture& capture, const DeviceTask& task)
        : engine_(device_engine<E>(own(state).first, own(state).second, task)),
          pictures_(task.share.count) {
        std::vector<std::pair<int, int>> views;
        for (const int frame : capture.train)
            for (const int camera : present_cameras(capture, frame))
                views.emplace_back(frame, camera);
        const auto at_once = static_cast<std::size_t>(4 * program_threads().size());
        for (std::size_t begin = 0; begin < views.size(); begin += at_once) {
            std::vector<TrainingView> read(std::min(at_once, views.size() - begin));
            program_threads().run(static_cast<Index>(read.size()), [&](Index i) {
                const auto k = static_cast<std::size_t>(i);
                const auto [frame, camera] = views[begin + k];
                read[k] = training_view(capture, state.config, frame, camera);
            });
            for (std::size_t k = 0; k < read.size(); ++k)
                view_[views[begin + k]] = engine_->add(
                    read[k],
                    frame_drivers(capture, views[begin + k].first, state.config.gaze_axis));
        }
    }

    StepReport run(TrainState& state, const std::vector<SampleDraw>& draws, bool ask) override {
        std::vector<StepDraw> steps;
        for (const SampleDraw& d : draws)
            steps.push_back({view_.at({d.frame, d.camera}),
                             d.eyes_high,
                             d.scaled,
                             d.scale,
                             {d.blank(0), d.blank(1), d.blank(2)},
                             d.rate});
        const DeviceStepsReport r = engine_->run(steps, ask);
        state.step += static_cast<Index>(draws.size()) / pictures_;
        return {names_of(r.losses), 0, r.bad_field, r.refused_in_a_row, r.asked};
    }
    void fetch(TrainState& state) const override {
        const auto to = own(state);
        engine_->fetch(to.first, to.second);
    }
    void restart(const TrainState& state) override {
        const auto from = own(state);
        engine_->restart(from.first, from.second);
    }
    DeviceStepsMemory memory() const override { return engine_->memory(); }

  private:
    /// Returns the avatar that a run with these effects trains, and its optimiser.
    template <class State>
    static auto own(State& state) {
        if constexpr (std::same_as<E, ComparedEffects>)
            return std::pair<decltype((state.compared->avatar)), decltype((state.compared->adam))>(
                state.compared->avatar, state.compared->adam);
        else
            return std::pair<decltype((state.avatar)), decltype((state.avatar_adam))>(
                state.avatar, state.avatar_adam);
    }

    std::unique_ptr<DeviceEngine<E>> engine_;
    Index pictures_;                            ///< of a step, of this rank
    std::map<std::pair<int, int>, Index> view_; ///< of a frame and a camera
};

} // namespace

TrainingView training_view(const Capture& capture, const TrainConfig& config, int frame,
                           int camera) {
    const int factor = 1 << config.gaussians.upsampler.doublings;
    const auto place = std::find(capture.train.begin(), capture.train.end(), frame);
    TrainingView v;
    v.camera = reduced(capture.camera(frame, camera).cast<float>(), factor);
    v.frame = place == capture.train.end() ? -1 : place - capture.train.begin();
    v.view = seen_by(capture, camera);
    const Image<float> rgb = extended(capture.image(frame, camera), factor);
    v.width = rgb.width;
    v.height = rgb.height;
    v.rgb = bytes_of(rgb);
    v.mask = bytes_of(extended(capture.mask(frame, camera), factor));
    v.visible = bytes_of(extended(capture.visible(frame, camera), factor, Border::zero));
    const Image<float> eyes = extended(capture.eye_mask(frame, camera), factor, Border::zero);
    Image<float> both(eyes.width, eyes.height, 1);
    both.pixels = eyes.pixels.colwise().maxCoeff();
    v.eyes = bytes_of(both);
    return v;
}

DeviceTask device_task(const TrainState& state, const FaceNeighbours& neighbours,
                       const DeviceStepSettings& settings) {
    DeviceTask task;
    task.share = share_of(state.config, settings.ranks);
    task.ranks = settings.ranks;
    task.by = settings.by;
    task.on_device = settings.on_device;
    task.training = avatar_training<PyramidGradientLoss>(state, neighbours);
    task.planes = state.config.gaussians.planes;
    task.narrow = beyond(state.config, narrow_tiles).empty();
    return task;
}

std::unique_ptr<DeviceSteps> device_steps(const TrainState& state, const Capture& capture,
                                          const std::filesystem::path& perceptual_weights,
                                          const DeviceStepSettings& settings) {
    DeviceTask task = device_task(state, first_neighbours(state), settings);
    if (!perceptual_weights.empty()) task.lpips = read_lpips_weights<float>(perceptual_weights);
    if (state.compared)
        return std::make_unique<DeviceStepsOf<ComparedEffects>>(state, capture, task);
    return std::make_unique<DeviceStepsOf<TrainEffects>>(state, capture, task);
}

Index chunk_end(Index step, Index total, const AvatarTrainConfig& config) {
    Index end = total;
    for (const Index every : {log_every, Index(config.panel_every), Index(config.checkpoint_every)})
        if (every > 0) end = std::min(end, (step / every + 1) * every);
    return std::min(end, next_density_step(config.density, step));
}

} // namespace rye::trainer
