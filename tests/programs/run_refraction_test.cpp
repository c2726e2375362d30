// SPDX-License-Identifier: Apache-2.0
// Runs whose corneas refract: begun, trained, kept, read back and drawn by the variants.
#include <doctest/doctest.h>

#include "../support/effect_sets.hpp"
#include "../support/hostile.hpp"
#include "corrections/lights.hpp"
#include "data/config.hpp"
#include "drawing/shown.hpp"
#include "drawing/variants.hpp"
#include "tiny_run.hpp"
#include "training/steps.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

TrainState refracting() {
    TrainState s = tiny_state();
    test::set_tiny_lights(s.avatar.eyes.optics);
    resize_lights(s.avatar.eyes.optics, 0);
    s.avatar_adam = Adam<Avatar>(s.avatar);
    return s;
}

Columns<float> stepped(TrainState& state) {
    for (int step = 0; step < 3; ++step)
        avatar_steps(state, {})->step(state, small_sample(state), 1, [](const char*) {});
    return state.avatar.eyes.optics.index;
}

} // namespace

TEST_CASE("refraction: a run keeps its index, trains it by a rate, and is read back as it was") {
    TrainState fixed = refracting(), state = fixed;
    const Columns<float> before = state.avatar.eyes.optics.index;
    CHECK(stepped(fixed) == before);
    state.config.gaussians.rates.refractive_index = 1e-3;
    const Columns<float> moved = (stepped(state) - before).cwiseAbs();
    CHECK(moved.minCoeff() > 1e-4F);
    CHECK(moved.maxCoeff() < 1e-2F);
    const TemporaryFolder folder;
    save_checkpoint(folder.path, state);
    const TrainState back = load_checkpoint(folder.path);
    CHECK(back.avatar.eyes.optics.cornea == state.avatar.eyes.optics.cornea);
    CHECK(back.avatar.eyes.optics.lights() == 0);
    Avatar::fields(
        [](const std::string& name, const auto& a, const auto& b) { CHECK_MESSAGE(a == b, name); },
        back.avatar, state.avatar);
    CHECK(back.avatar_adam.v.eyes.optics.index == state.avatar_adam.v.eyes.optics.index);
    save_checkpoint(folder.path, tiny_state());
    CHECK_FALSE(load_checkpoint(folder.path).avatar.eyes.optics.refracts());
}

TEST_CASE("refraction: a run begins with usual corneas and the cornea's own index") {
    TrainState state = tiny_state();
    begin_refraction(state.avatar, state.subject);
    const EyeOptics<float, TrainEffects>& optics = state.avatar.eyes.optics;
    CHECK(optics.index == Columns<float>::Constant(1, 2, 1.376F));
    const Cornea<double> usual = usual_cornea(state.subject, 1);
    CHECK(optics.cornea(3, 1) == static_cast<float>(usual.radius));
    CHECK(optics.cornea(2, 1) == static_cast<float>(usual.centre.z()));
    // Beside lights their corneas stay.
    TrainState lit = tiny_state();
    test::set_tiny_lights(lit.avatar.eyes.optics);
    const Columns<float> cornea = lit.avatar.eyes.optics.cornea;
    begin_refraction(lit.avatar, lit.subject);
    CHECK(lit.avatar.eyes.optics.cornea == cornea);
    CHECK(lit.avatar.eyes.optics.lights() == 2);
}

TEST_CASE("refraction: every variant draws it; drawn without a camera there is none") {
    const TrainState state = refracting();
    DrawnFrame frame{test::tiny_drivers<float>(), test::tiny_camera(64, 48).cast<float>()};
    DrawnFrame aside = frame;
    aside.camera.camera_from_world.translation[0] += 0.4F;
    for (const char* const wanted : {"auto", "still", "gaze", "talk", "paper"}) {
        const FrameDrawer drawer(state, {frame, aside}, wanted, "--effects", 0.01);
        CHECK(drawer.explanation().find("corneal refraction") != std::string::npos);
        CHECK(drawer.explanation().find("NOT drawn    corneal") == std::string::npos);
        for (const DrawnFrame& f : {frame, aside})
            CHECK((drawer.picture(f).pixels - drawer.picture_by_all(f).pixels)
                      .cwiseAbs()
                      .maxCoeff() <= 1e-4F);
    }
    TrainState none = state;
    none.avatar.eyes.optics = {};
    CHECK(driven_gaussians(state, frame.drivers).mean ==
          driven_gaussians(none, frame.drivers).mean);
    const FrameDrawer with(state, {frame}, "auto", "--effects", 0.01),
        without(none, {frame}, "auto", "--effects", 0.01);
    CHECK((with.picture(frame).pixels - without.picture(frame).pixels).cwiseAbs().maxCoeff() >
          1e-3F);
    CHECK(without.explanation().find("corneal refraction") == std::string::npos);
}

TEST_CASE("refraction: a configuration has it off, and refuses it beside eyes that do not turn") {
    TrainConfig config = preset("cpu");
    CHECK_FALSE(config.refraction);
    CHECK(config.gaussians.rates.refractive_index == 0);
    from_json({{"avatar", {{"refraction", true}}},
               {"gaussians", {{"rates", {{"refractive_index", 1e-4}}}}}},
              "c.json", config);
    CHECK(config.refraction);
    CHECK(config.gaussians.rates.refractive_index == 1e-4);
    CHECK(to_json(config).at("avatar").at("refraction") == true);
    CHECK_FAULT(from_json({{"avatar", {{"refraction", 1}}}}, "c.json", config),
                "avatar.refraction");
    TrainConfig still = preset("paper-literal");
    CHECK_FAULT(
        from_json({{"avatar", {{"refraction", true}, {"gaze_mechanism", "none"}}}}, "c.json",
                  still),
        "c.json: field 'avatar.gaze_mechanism': got \"none\", expected \"rotation\", as refraction "
        "is true");
}
