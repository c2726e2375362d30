// SPDX-License-Identifier: Apache-2.0
#include "tiny_run.hpp"

#include <rye/avatar/hold.hpp>

namespace rye::trainer {

TrainState tiny_state() {
    test::Draw draw;
    TrainState s;
    s.stage = Stage::avatar;
    s.config = preset("tiny");
    s.config.avatar = test::tiny_config();
    s.subject.roles = test::tiny_roles();
    const TwoStream<double> avatar = test::tiny_avatar(s.config.avatar, draw);
    s.config.gaussians.upsampler = avatar.upsampler.shape;
    s.avatar = restricted<TrainEffects>(test::lifted<float>(avatar));
    s.avatar_adam = Adam<Avatar>(s.avatar);
    s.subject.neutral = avatar.face.landmarks;
    s.subject.head_centre.setZero();
    for (std::size_t e = 0; e < 2; ++e) {
        s.subject.eye_centre[e] = avatar.eyes.centre.col(static_cast<Index>(e));
        s.subject.eye_radius[e] = 0.12;
        s.subject.limbus_radius[e] = 0.06;
        s.subject.iris_plane[e] = 0.1;
    }
    s.train_frames = {0, 1};
    s.mesh = Mesh::init(s.config.avatar, s.subject.neutral.cast<float>(), Random{1, 0});
    return s;
}

AvatarSample<float> small_sample(const TrainState& state) {
    AvatarSample<float> s;
    s.drivers = test::tiny_drivers<float>();
    s.frame = 1;
    s.camera = test::tiny_camera(32, 24).cast<float>();
    const Index pixels = 32 * 24;
    s.truth_small = Image<float>(32, 24, 3);
    s.truth_small.pixels.setConstant(0.5f);
    s.truth_small.pixels.leftCols(pixels / 2).setOnes();
    s.truth = Image<float>(64, 48, 3);
    s.truth.pixels.setConstant(0.5f);
    s.truth.pixels.leftCols(2 * pixels).setOnes();
    for (Columns<float>* a : {&s.visible_small, &s.eyes_small, &s.mask_small})
        *a = Columns<float>::Ones(1, pixels);
    for (Columns<float>* a : {&s.visible, &s.eyes}) *a = Columns<float>::Ones(1, 4 * pixels);
    s.background = s.blank = VecX<float>::Ones(state.config.avatar.channels);
    return s;
}

} // namespace rye::trainer
