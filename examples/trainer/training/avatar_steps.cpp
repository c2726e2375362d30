// SPDX-License-Identifier: Apache-2.0
// Steps of stage 2. Drivers depend on an avatar's effects; the objective is compiled once.
#include <variant>

#include <rye/avatar/hold.hpp>
#include <rye/io/lpips_weights.hpp>

#include "training/avatar_training.hpp"
#include "training/steps.hpp"

namespace rye::trainer {
namespace {

/// LPIPS if its weights are given, else the loss without weights.
struct ChosenPerceptual {
    std::variant<PyramidGradientLoss, LpipsVgg<float>> loss;

    template <Backend B>
    LossGradient<float> operator()(const B& backend, const Image<float>& picture,
                                   const Image<float>& truth) const {
        return std::visit([&](const auto& l) { return l(backend, picture, truth); }, loss);
    }
};

AvatarTraining<Balanced, ChosenPerceptual> training_of(
    const TrainState& state, const std::filesystem::path& perceptual_weights) {
    AvatarTraining<Balanced, ChosenPerceptual> t =
        avatar_training<ChosenPerceptual>(state, first_neighbours(state));
    if (!perceptual_weights.empty())
        t.objective.perceptual.loss =
            LpipsVgg<float>{read_lpips_weights<float>(perceptual_weights)};
    return t;
}

template <EffectSet E>
class StepsOf : public AvatarSteps {
  public:
    StepsOf(TwoStream<float, E>& avatar, Adam<TwoStream<float, E>>& adam, const TrainState& state,
            const std::filesystem::path& perceptual_weights)
        : trainer_(train_backend(), avatar, adam, training_of(state, perceptual_weights)) {}

    StepReport step(TrainState& state, const AvatarSample<float>& sample, double rate,
                    const Probe& probe) override {
        return taken(state, trainer_.step(restricted<E>(sample.drivers), sample, rate, probe));
    }
    void add(const AvatarSample<float>& sample, Index all, const Probe& probe) override {
        trainer_.add(restricted<E>(sample.drivers), sample, all, probe);
    }
    StepReport take(TrainState& state, ThreadGroup* group, double rate,
                    const Probe& probe) override {
        if (group == nullptr) return taken(state, trainer_.take(Alone{}, rate, probe));
        return taken(state, trainer_.take(*group, rate, probe));
    }

  private:
    static StepReport taken(TrainState& state, const AvatarStepReport<float>& report) {
        ++state.step;
        return {names_of(report.losses), 0, report.adam.first_bad_field};
    }

    AvatarTrainer<TrainBackend, float, E, Balanced, ChosenPerceptual, AvatarRates> trainer_;
};

} // namespace

std::unique_ptr<AvatarSteps> avatar_steps(TrainState& state,
                                          const std::filesystem::path& perceptual_weights) {
    if (state.compared)
        return std::make_unique<StepsOf<ComparedEffects>>(
            state.compared->avatar, state.compared->adam, state, perceptual_weights);
    return std::make_unique<StepsOf<TrainEffects>>(state.avatar, state.avatar_adam, state,
                                                   perceptual_weights);
}

} // namespace rye::trainer
