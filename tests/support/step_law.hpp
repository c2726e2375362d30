// SPDX-License-Identifier: Apache-2.0
// A step of stage 2 on a tiny avatar, and the law of its derivatives.
#pragma once

#include <rye/train/avatar_trainer.hpp>

#include <doctest/doctest.h>

#include "tiny_sample.hpp"

namespace rye::test {

inline AvatarTraining<> training_of(const AvatarConfig& config) {
    AvatarTraining<> t;
    t.config = config;
    t.roles = tiny_roles();
    AvatarLossConfig& weights = t.objective.weights;
    weights.face_alone = 0.7;
    weights.dssim = 0.3;
    return t;
}

/// Losses and, for real numbers, their gradient.
template <class T>
struct Step {
    AvatarLosses<T> losses;
    TwoStream<T> gradient;
    AvatarPictures<T> pictures;
};
template <class T>
Step<T> step_at(TwoStream<T> avatar, const AvatarSample<T>& sample, const AvatarTraining<>& t) {
    Adam<TwoStream<T>> adam(avatar);
    AvatarTrainer trainer{ScalarBackend<Serial>{}, avatar, adam, t};
    Step<T> step;
    step.losses = trainer.losses(sample.drivers, sample);
    if constexpr (Real<T>) {
        step.gradient = zeros_like(avatar);
        trainer.add_gradient(sample.drivers, sample, step.gradient);
    }
    step.pictures = trainer.pictures();
    return step;
}

/// How far <gradient, d> is from the derivative along d that duals give.
template <class T>
double law_error(ChosenMetric metric, std::uint64_t seed) {
    using D = Dual<T, 1>;
    Draw draw{{seed, 3}};
    AvatarConfig config = tiny_config();
    config.metric = metric;
    const TwoStream<T> avatar = lifted<T>(tiny_avatar(config, draw));
    const AvatarTraining<> training = training_of(config);
    const Step<T> step = step_at(avatar, tiny_sample<T>(Draw{{9, 0}}), training);
    const AvatarLosses<T>& l = step.losses;
    const TwoStream<T>& grad = step.gradient;
    const TwoStream<T> direction = random_like(avatar, Random{seed, 5});
    TwoStream<D> dual = lifted<D>(avatar);
    detail::seed_fields(dual, avatar, direction);
    const AvatarLosses<D> dl = step_at(dual, tiny_sample<D>(Draw{{9, 0}}), training).losses;
    CHECK(std::abs(static_cast<double>(dl.total.value - l.total)) <=
          1e-5 * static_cast<double>(l.total));
    DotSum by_vjp, by_dual;
    by_vjp.add_all(grad, direction);
    by_dual.sum = static_cast<double>(dl.total.d[0]);
    CHECK(by_vjp.magnitude > 0.01);
    return disagreement(by_vjp, by_dual);
}

} // namespace rye::test
