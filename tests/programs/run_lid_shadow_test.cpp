// SPDX-License-Identifier: Apache-2.0
// Runs whose upper lids cast shadows: trained, kept, read back and drawn by the variants.
#include <doctest/doctest.h>

#include "../support/effect_sets.hpp"
#include "../support/hostile.hpp"
#include "drawing/variants.hpp"
#include "tiny_run.hpp"
#include "training/steps.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

TrainState shadowed() {
    TrainState s = tiny_state();
    test::set_tiny_lids(s.avatar);
    s.avatar_adam = Adam<Avatar>(s.avatar);
    return s;
}

} // namespace

TEST_CASE("lids' shadows: a run trains them, and is read back as it was") {
    TrainState state = shadowed();
    const Columns<float> before = state.avatar.eyes.lid_shadow, line = state.avatar.eyes.lid_line;
    for (int step = 0; step < 3; ++step)
        avatar_steps(state, {})->step(state, small_sample(state), 1, [](const char*) {});
    const Columns<float> moved = (state.avatar.eyes.lid_shadow - before).cwiseAbs();
    CHECK(moved.row(0).minCoeff() > 1e-4f);
    CHECK(moved.rowwise().maxCoeff().minCoeff() > 1e-4f);
    CHECK(state.avatar.eyes.lid_line == line);
    const TemporaryFolder folder;
    save_checkpoint(folder.path, state);
    const TrainState back = load_checkpoint(folder.path);
    CHECK(back.avatar.eyes.lid_line == line);
    Avatar::fields(
        [](const std::string& name, const auto& a, const auto& b) { CHECK_MESSAGE(a == b, name); },
        back.avatar, state.avatar);
    CHECK(back.avatar_adam.v.eyes.lid_shadow == state.avatar_adam.v.eyes.lid_shadow);
    save_checkpoint(folder.path, tiny_state());
    CHECK_FALSE(load_checkpoint(folder.path).avatar.eyes.has_lid_shadow());
}

TEST_CASE("lids' shadows: with a rate of 0 they stay") {
    TrainState state = shadowed();
    state.config.gaussians.rates.lid_shadow = 0;
    const Columns<float> before = state.avatar.eyes.lid_shadow;
    avatar_steps(state, {})->step(state, small_sample(state), 1, [](const char*) {});
    CHECK(state.avatar.eyes.lid_shadow == before);
}

TEST_CASE("lids' shadows: variants draw them, of eyes that turn or that do not") {
    const TrainState state = shadowed();
    DrawnFrame frame{test::tiny_drivers<float>(), test::tiny_camera(64, 48).cast<float>()};
    DrawnFrame looks = frame;
    looks.drivers.gaze[0] = gaze_vector(0.1f, 0.3f);
    const auto apart = [](const FrameDrawer& drawer, const DrawnFrame& f) {
        return (drawer.picture(f).pixels - drawer.picture_by_all(f).pixels).cwiseAbs().maxCoeff();
    };
    const FrameDrawer gaze(state, {frame, looks}, "auto", "--effects", 0.01);
    CHECK(gaze.variant() == "gaze");
    CHECK(gaze.explanation().find("lid shadow") != std::string::npos);
    for (const DrawnFrame& f : {frame, looks}) CHECK(apart(gaze, f) <= 1e-4f);
    const FrameDrawer still(state, {frame, looks}, "still", "--effects", 0.01);
    CHECK(still.explanation().find("NOT drawn    left gaze") != std::string::npos);
    CHECK(still.explanation().find("NOT drawn    lid shadow") == std::string::npos);
    CHECK(apart(still, frame) <= 1e-4f);
    CHECK(apart(still, looks) > 1e-3f);
    TrainState none = state;
    none.avatar.eyes.lid_shadow = none.avatar.eyes.lid_line = {};
    const FrameDrawer plain(none, {frame}, "auto", "--effects", 0.01);
    CHECK(plain.explanation().find("lid shadow") == std::string::npos);
    CHECK((plain.picture(frame).pixels - gaze.picture(frame).pixels).cwiseAbs().maxCoeff() > 1e-3f);
}
