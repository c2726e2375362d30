// SPDX-License-Identifier: Apache-2.0
#include <rye/avatar/hold.hpp>

#include "training/avatar_steps.hpp"

namespace rye::trainer {
namespace {

class VisualSteps : public AvatarSteps {
  public:
    VisualSteps(const TrainState& state, const std::filesystem::path& perceptual_weights)
        : memory_(state.visual.value().avatar, state.config, perceptual_weights) {}

    StepReport step(TrainState& state, const AvatarSample<float>& s, double rate,
                    const Probe& probe) override {
        const AvatarSample<float, VisualEffects> sample{
            restricted<VisualEffects>(s.drivers), s.frame, s.camera, s.truth, s.truth_small,
            s.visible, s.visible_small, s.eyes, s.eyes_small, s.mask_small, s.eyes_high, s.scale,
            s.background, s.blank};
        VisualTraining& training = state.visual.value();
        const StepReport report =
            memory_.step(training.avatar, training.adam, state, sample, rate, probe);
        ++state.step;
        return report;
    }

  private:
    StepMemory<VisualEffects> memory_;
};

} // namespace

std::unique_ptr<AvatarSteps> visual_steps(const TrainState& state,
                                          const std::filesystem::path& perceptual_weights) {
    return std::make_unique<VisualSteps>(state, perceptual_weights);
}

} // namespace rye::trainer
