// SPDX-License-Identifier: Apache-2.0
// Runs whose colours depend on the view: begun, trained, kept, read back and drawn by the variants.
#include <doctest/doctest.h>

#include <nlohmann/json.hpp>

#include "../support/effect_sets.hpp"
#include "../support/hostile.hpp"
#include "data/config.hpp"
#include "drawing/shown.hpp"
#include "drawing/variants.hpp"
#include "model/trained_parts.hpp"
#include "tiny_run.hpp"
#include "training/steps.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

using Json = nlohmann::ordered_json;

TrainState viewed(int degree) {
    TrainState s = tiny_state();
    s.config.view_color = degree;
    s.config.gaussians.rates.view_color = 1e-3;
    s.avatar.view_color = initial_view_colors<float>(degree, s.avatar.face.position.cols(),
                                                     s.avatar.eyes.position.cols());
    s.avatar_adam = Adam<Avatar>(s.avatar);
    return s;
}

void step(TrainState& state) {
    AvatarSample<float> sample = small_sample(state);
    for (int k = 0; k < 3; ++k) avatar_steps(state, {})->step(state, sample, 1, [](const char*) {});
}

} // namespace

TEST_CASE("view color: a run trains it by its rate, and is read back as it was") {
    TrainState state = viewed(2);
    step(state);
    const Columns<float>&face = state.avatar.view_color.face, &eyes = state.avatar.view_color.eyes;
    CHECK(face.cwiseAbs().maxCoeff() > 1e-4F);
    CHECK(face.cwiseAbs().maxCoeff() < 4e-3F);
    CHECK(eyes.cwiseAbs().maxCoeff() > 1e-4F);
    const TemporaryFolder folder;
    save_checkpoint(folder.path, state);
    const TrainState back = load_checkpoint(folder.path);
    CHECK(back.config.view_color == 2);
    Avatar::fields(
        [](const std::string& name, const auto& a, const auto& b) { CHECK_MESSAGE(a == b, name); },
        back.avatar, state.avatar);
    CHECK(back.avatar_adam.v.view_color.face == state.avatar_adam.v.view_color.face);
    state.config.view_color = 3;
    save_checkpoint(folder.path, state);
    CHECK_FAULT(load_checkpoint(folder.path), "tensor 'avatar.view_color.face': got shape");
    save_checkpoint(folder.path, tiny_state());
    CHECK_FALSE(load_checkpoint(folder.path).avatar.has_view_color());
}

TEST_CASE("view color: every variant draws it; drawn without a camera there is none") {
    TrainState state = viewed(3);
    test::set_tiny_view_colors(state.avatar);
    DrawnFrame frame{test::tiny_drivers<float>(), test::tiny_camera(64, 48).cast<float>()};
    DrawnFrame aside = frame;
    aside.camera.camera_from_world.translation[0] += 0.4F;
    for (const char* const wanted : {"auto", "still", "gaze", "talk", "paper"}) {
        const FrameDrawer drawer(state, {frame, aside}, wanted, "--effects", 0.01);
        CHECK(drawer.explanation().find("view color") != std::string::npos);
        CHECK(drawer.explanation().find("NOT drawn    view") == std::string::npos);
        for (const DrawnFrame& f : {frame, aside})
            CHECK((drawer.picture(f).pixels - drawer.picture_by_all(f).pixels)
                      .cwiseAbs()
                      .maxCoeff() <= 1e-4F);
    }
    TrainState none = state;
    none.avatar.view_color = {};
    CHECK(driven_gaussians(state, frame.drivers).feature ==
          driven_gaussians(none, frame.drivers).feature);
    const FrameDrawer with(state, {frame}, "auto", "--effects", 0.01),
        without(none, {frame}, "auto", "--effects", 0.01);
    CHECK((with.picture(frame).pixels - without.picture(frame).pixels).cwiseAbs().maxCoeff() >
          1e-3F);
    CHECK(without.explanation().find("view color") == std::string::npos);
}

TEST_CASE("view color: a configuration has it off, and refuses it beside eyes that do not turn") {
    TrainConfig config = preset("cpu");
    CHECK(config.view_color == 0);
    from_json({{"avatar", {{"view_color", 3}}}, {"gaussians", {{"rates", {{"view_color", 1e-3}}}}}},
              "c.json", config);
    CHECK(config.view_color == 3);
    CHECK(config.gaussians.rates("view_color.eyes") == 1e-3);
    CHECK(to_json(config).at("avatar").at("view_color") == 3);
    for (const char* const wrong :
         {R"({"avatar": {"view_color": true}})", R"({"avatar": {"view_color": 4}})"})
        CHECK_FAULT(from_json(Json::parse(wrong), "c.json", config), "avatar.view_color");
    TrainConfig still = preset("paper-literal");
    CHECK_FAULT(
        from_json({{"avatar", {{"view_color", 1}, {"gaze_mechanism", "none"}}}}, "c.json", still),
        "c.json: field 'avatar.gaze_mechanism': got \"none\", expected \"rotation\", as view_color "
        "is not 0");
    Avatar avatar = tiny_state().avatar;
    begin_parts(avatar, config, Columns<float>::Zero(3, avatar.face.position.cols()), {});
    CHECK(avatar.view_color.face.rows() == 45);
    CHECK(avatar.view_color.eyes.cols() == avatar.eyes.position.cols());
    CHECK(avatar.view_color.face.isZero(0));
}
