// SPDX-License-Identifier: Apache-2.0
// Corrections of tracked gazes (TwoStream::delta_gaze) that a training of stage 2 makes.
#include <rye/splat/lanes.hpp>
#include <rye/train/avatar_trainer.hpp>

#include <doctest/doctest.h>

#include <limits>
#include <utility>

#include "../support/corrected_avatar.hpp"
#include "../support/hostile.hpp"

using namespace rye;
using namespace rye::test;

namespace {

template <class T>
using Avatar = TrainedAvatar<T>;

} // namespace

TEST_CASE("corrected gazes: their gradient is the transpose of their duals") {
    using D = Dual<double, 1>;
    const Avatar<double> avatar = corrected_avatar();
    const auto sample = tiny_sample<double, TrainedEffects>(Draw{{9, 0}});
    Avatar<double> own = avatar, gradient = zeros_like(avatar);
    Adam<Avatar<double>> adam(own);
    AvatarTrainer trainer{ScalarBackend<Serial>{}, own, adam, training_of_corrections()};
    trainer.losses(sample.drivers, sample);
    trainer.add_gradient(sample.drivers, sample, gradient);
    Draw draw{{4, 1}};
    const Columns<double> direction = draw.columns(4, avatar.delta_gaze.cols());
    Avatar<D> dual = lifted<D>(avatar);
    for (Index i = 0; i < direction.size(); ++i)
        dual.delta_gaze.data()[i].d[0] = direction.data()[i];
    Adam<Avatar<D>> dual_adam(dual);
    AvatarTrainer dual_trainer{ScalarBackend<Serial>{}, dual, dual_adam, training_of_corrections()};
    const auto dual_sample = tiny_sample<D, TrainedEffects>(Draw{{9, 0}});
    const double by_dual = dual_trainer.losses(dual_sample.drivers, dual_sample).total.d[0];
    const double by_vjp = gradient.delta_gaze.cwiseProduct(direction).sum();
    CHECK(std::abs(by_dual) > 1e-4);
    CHECK(std::abs(by_dual - by_vjp) <= 1e-10 * std::abs(by_dual));
    CHECK(gradient.delta_gaze.col(0).isZero(0)); // the sample is of frame 1
}

TEST_CASE("corrections: what frames have in common is taken off by steps that are applied") {
    const auto off = [](const Columns<double>& a) {
        return a.rowwise().mean().cwiseAbs().maxCoeff();
    };
    const auto sample = tiny_sample<double, TrainedEffects>(Draw{{9, 0}});
    for (const bool poses : {false, true}) {
        CAPTURE(poses);
        AvatarTraining<> t = training_of_corrections();
        t.centred_corrections = poses;
        t.rates.delta_gaze = 1e-4;
        Avatar<double> avatar = corrected_avatar();
        Adam<Avatar<double>> adam(avatar);
        AvatarTrainer trainer{ScalarBackend<Serial>{}, avatar, adam, t};
        double& bias = avatar.upsampler.out_bias(1, 0);
        const double finite = std::exchange(bias, std::numeric_limits<double>::quiet_NaN());
        CHECK(!trainer.step(sample).adam.applied);
        bias = finite;
        CHECK(avatar.delta_gaze == corrected_avatar().delta_gaze);
        CHECK(avatar.delta_pose == corrected_avatar().delta_pose);
        const Columns<double> apart = avatar.delta_gaze.col(1) - avatar.delta_gaze.col(0);
        CHECK(trainer.step(sample).adam.applied);
        CHECK(off(avatar.delta_gaze) <= 1e-15);
        CHECK((off(avatar.delta_pose) <= 1e-15) == poses);
        const Columns<double> now = avatar.delta_gaze.col(1) - avatar.delta_gaze.col(0);
        CHECK((now - apart).cwiseAbs().maxCoeff() <= 2.1e-4); // a step of Adam
        CHECK(!(now == apart));
    }
    Avatar<double> wrong = corrected_avatar();
    Adam<Avatar<double>> adam(wrong);
    wrong.eyes.kappa.resize(0, 0);
    CHECK_FAULT((AvatarTrainer{ScalarBackend<Serial>{}, wrong, adam, training_of_corrections()}),
                "delta_gaze needs a kappa");
    wrong = corrected_avatar();
    wrong.delta_gaze.resize(4, 3);
    CHECK_FAULT((AvatarTrainer{ScalarBackend<Serial>{}, wrong, adam, training_of_corrections()}),
                "delta_gaze is 4 x 3, expected 4 x 2");
}

TEST_CASE("corrected gazes: wrong labels come back, and their mean over frames stays 0") {
    Avatar<double> truth = corrected_avatar();
    truth.eyes.kappa.setZero();
    truth.delta_gaze.setZero();
    truth.delta_pose.setZero();
    const auto at = [&](Index frame) {
        auto s = tiny_sample<double, TrainedEffects>(Draw{{9, 0}});
        s.frame = frame;
        s.camera = tiny_camera(24, 18);
        s.drivers.gaze = {gaze_vector(0.1, 0.1 * double(frame)),
                          gaze_vector(-0.1, 0.05 - 0.1 * double(frame))};
        return s;
    };
    const Index frames = truth.delta_pose.cols();
    std::vector<AvatarSample<double, TrainedEffects>> samples;
    for (Index f = 0; f < frames; ++f) {
        auto s = at(f);
        draw_truth(truth, s);
        samples.push_back(s);
    }
    // Labels that are off by up to 4 degrees, their errors 0 on average.
    Columns<double> error(4, frames);
    for (Index f = 0; f < frames; ++f) error.col(f) << 0.07, -0.05, 0.06, 0.04;
    for (Index f = 0; f < frames; f += 2) error.col(f) *= -1;
    error.colwise() -= error.rowwise().mean().eval();
    Avatar<double> avatar = truth;
    Adam<Avatar<double>> adam(avatar);
    AvatarTraining<> t = training_of_nothing();
    t.rates.delta_gaze = 3e-3;
    AvatarTrainer trainer{ScalarBackend<Serial>{}, avatar, adam, t};
    const auto labelled = [&](Index frame) {
        auto s = samples[static_cast<std::size_t>(frame)];
        for (std::size_t eye = 0; eye < 2; ++eye) {
            const Index row = 2 * static_cast<Index>(eye);
            s.drivers.gaze[eye] = apply_kappa<double>(
                s.drivers.gaze[eye], {error(row, s.frame), error(row + 1, s.frame)});
        }
        return s;
    };
    const auto loss = [&](Index frame) {
        const auto s = labelled(frame);
        return trainer.losses(s.drivers, s).total;
    };
    const double wrong = loss(0);
    avatar.delta_gaze = -error;
    CHECK(loss(0) < 1e-3 * wrong);
    avatar.delta_gaze.setZero();
    for (Index step = 0; step < 160; ++step) {
        const auto s = labelled(step % frames);
        trainer.step(s.drivers, s, step < 100 ? 1 : 0.2);
    }
    CAPTURE(avatar.delta_gaze);
    CAPTURE(error);
    CHECK(loss(0) < 0.2 * wrong);
    CHECK((avatar.delta_gaze + error).cwiseAbs().maxCoeff() <= 0.01);
    CHECK(avatar.delta_gaze.rowwise().mean().cwiseAbs().maxCoeff() <= 1e-6);
    CHECK(avatar.eyes.kappa.isZero(0));
}
