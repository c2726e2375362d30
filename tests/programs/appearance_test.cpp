// SPDX-License-Identifier: Apache-2.0
// Runs whose eyes' features are driven and whose head is shaded (model/trained_parts.hpp).
#include "model/trained_parts.hpp"

#include <filesystem>
#include <string>

#include <doctest/doctest.h>

#include <rye/io/avatar_file.hpp>
#include <rye/io/safetensors.hpp>
#include <rye/interactive/player.hpp>

#include "../support/effect_sets.hpp"
#include "../support/hostile.hpp"
#include "drawing/playable.hpp"
#include "drawing/shown.hpp"
#include "drawing/variants.hpp"
#include "tiny_capture.hpp"
#include "tiny_run.hpp"
#include "training/steps.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

using Json = nlohmann::ordered_json;

struct Folder {
    fs::path path = fs::temp_directory_path() / "rye_appearance_test";
    Folder() {
        fs::remove_all(path);
        fs::create_directories(path);
    }
    ~Folder() { fs::remove_all(path); }
};

/// The tiny run as one that begins with these.
TrainState begun(EyeAppearanceName eyes, ShadingName shading) {
    TrainState s = tiny_state();
    s.config.eye_appearance = eyes;
    s.config.shading = shading;
    const Index n = s.avatar.face.position.cols();
    begin_parts(s.avatar, s.config, Vec3<float>(0, 0, 1).replicate(1, n).eval(), Random{3, 0});
    s.avatar_adam = Adam<Avatar>(s.avatar);
    return s;
}

/// All of it, with parameters that show.
TrainState trained() {
    TrainState s = begun(EyeAppearanceName::driven, ShadingName::head_pose);
    Avatar& a = s.avatar;
    for (Mlp<float>& mlp : a.eyes.networks) mlp.weight.back().setConstant(0.02f);
    a.shading.light.setConstant(0.3f);
    s.step = 1;
    return s;
}

bool equal(const Gaussians<float>& a, const Gaussians<float>& b) {
    bool same = true;
    Gaussians<float>::fields(
        [&](const std::string&, const auto& x, const auto& y) { same = same && x == y; }, a, b);
    return same;
}

/// Equal but for rounding: by which products are fused into sums compilers differ from place to place.
bool rounded_alike(const Gaussians<float>& a, const Gaussians<float>& b) {
    bool same = true;
    Gaussians<float>::fields(
        [&](const std::string&, const auto& x, const auto& y) {
            same = same && x.rows() == y.rows() && x.cols() == y.cols() &&
                   (x.size() == 0 || (x - y).cwiseAbs().maxCoeff() <=
                                         2e-6f * (1 + x.cwiseAbs().maxCoeff()));
        },
        a, b);
    return same;
}

template <class F>
std::string message_of(F&& f) {
    try {
        f();
    } catch (const Error& e) {
        return e.what();
    }
    return "accepted";
}

} // namespace

TEST_CASE("appearance: fields of the configuration, and of the presets") {
    for (const std::string& name : preset_names()) {
        const bool both = name == "cpu" || name == "gpu";
        CHECK(to_json(preset(name))["avatar"]["eye_appearance"] ==
              (name == "paper" ? "driven" : "free"));
        CHECK(to_json(preset(name))["avatar"]["shading"] == (both ? "head_pose" : "none"));
    }
    TrainConfig c = preset("tiny");
    from_json(Json::parse(R"({"avatar": {"eye_appearance": "driven", "shading": "head_pose"}})"),
              "x", c);
    CHECK(c.eye_appearance == EyeAppearanceName::driven);
    CHECK(c.shading == ShadingName::head_pose);
    TrainConfig again = preset("paper");
    from_json(to_json(c), "x", again);
    CHECK(to_json(again) == to_json(c));
    const auto refused = [](const char* text) {
        TrainConfig d = preset("tiny");
        return message_of([&] { from_json(Json::parse(text), "my.json", d); });
    };
    CHECK(refused(R"({"avatar": {"eye_appearance": "fixed"}})") ==
          "my.json: field 'avatar.eye_appearance': got \"fixed\", expected \"free\" or \"driven\"");
    CHECK(refused(R"({"avatar": {"shading": true}})") ==
          "my.json: field 'avatar.shading': got true, expected \"none\" or \"head_pose\"");
    CHECK(refused(R"({"avatar": {"eye_appearance": "driven", "gaze_mechanism": "condition"}})") ==
          "my.json: field 'avatar.gaze_mechanism': got \"condition\", expected \"rotation\", as "
          "eye_appearance is \"driven\"");
}

TEST_CASE("appearance: a run begins with the picture of one without it") {
    const Drivers<float> drivers = test::tiny_drivers<float>();
    const Gaussians<float> plain = driven_gaussians(tiny_state(), drivers);
    const auto look = [&](EyeAppearanceName eyes, ShadingName shading) {
        return driven_gaussians(drawn_state(begun(eyes, shading)), drivers);
    };
    CHECK(rounded_alike(look(EyeAppearanceName::driven, ShadingName::head_pose), plain));
    CHECK(rounded_alike(look(EyeAppearanceName::free, ShadingName::head_pose), plain));
    CHECK(rounded_alike(look(EyeAppearanceName::driven, ShadingName::none), plain));
    CHECK_FALSE(rounded_alike(driven_gaussians(drawn_state(trained()), drivers), plain));
}

TEST_CASE("appearance: a run comes back from its checkpoint, with the tensors that are on") {
    const Folder folder;
    for (const bool eyes : {false, true})
        for (const bool shading : {false, true}) {
            if (!eyes && !shading) continue;
            TrainState state = begun(eyes ? EyeAppearanceName::driven : EyeAppearanceName::free,
                                     shading ? ShadingName::head_pose : ShadingName::none);
            state.avatar_adam.step = 7;
            save_checkpoint(folder.path, state);
            const Safetensors file = read_safetensors(checkpoint_path(folder.path));
            CHECK(file.has("avatar.eyes.left_appearance_mlp.conv0.weight") == eyes);
            CHECK(file.has("avatar.shading.light") == shading);
            const TrainState back = load_checkpoint(folder.path);
            CHECK(back.avatar_adam.step == 7);
            Avatar::fields([](const std::string& name, const auto& a,
                                        const auto& b) { CHECK_MESSAGE(a == b, name); },
                                     back.avatar, state.avatar);
        }
}

TEST_CASE("appearance: tensors that are missing or of another shape are named") {
    const Folder folder;
    const auto message = [&](const TrainState& state) {
        save_checkpoint(folder.path, state);
        return message_of([&] { load_checkpoint(folder.path); });
    };
    TrainState state = trained();
    state.avatar.shading.light.resize(4, 3);
    state.avatar.shading.light.setZero();
    state.avatar_adam = Adam<Avatar>(state.avatar);
    CHECK(message(state).find("avatar.shading.light") != std::string::npos);
    state = trained();
    state.avatar.eyes.kappa = Columns<float>::Zero(2, 2);
    state.avatar.eyes.kappa(0, 1) = 0.1f;
    state.avatar_adam = Adam<Avatar>(state.avatar);
    CHECK(message(state).find("tensor 'avatar.eyes.kappa': got an angle that is not 0, expected "
                              "none: the run's gaze_axis is 'optical'") != std::string::npos);
    state = trained();
    state.config.eye_appearance = EyeAppearanceName::driven;
    state.avatar.eyes.networks = {};
    state.avatar_adam = Adam<Avatar>(state.avatar);
    CHECK(message(state).find("left_appearance_mlp") != std::string::npos);
    state = tiny_state();
    state.config.shading = ShadingName::head_pose;
    CHECK(message(state).find("avatar.shading.light") != std::string::npos);
    state = trained();
    state.avatar.shading.normal(1, 2) = NAN;
    CHECK(message_of([&] {
              save_checkpoint(folder.path, state);
          }).find("'avatar.shading.normal'") != std::string::npos);
}

TEST_CASE("appearance: steps train light, normals and the eyes' networks, and no kappa") {
    TrainState state = begun(EyeAppearanceName::driven, ShadingName::head_pose);
    const Avatar before = state.avatar;
    const auto steps = avatar_steps(state, {});
    for (int step = 0; step < 3; ++step)
        CHECK(steps->step(state, small_sample(state), 1, [](const char*) {}).bad_field.empty());
    const Avatar& after = state.avatar;
    CHECK((after.shading.light - before.shading.light).cwiseAbs().maxCoeff() > 0);
    CHECK((after.shading.normal - before.shading.normal).cwiseAbs().maxCoeff() > 0);
    for (std::size_t eye = 0; eye < 2; ++eye) {
        CHECK(after.eyes.networks[eye].weight.back() != before.eyes.networks[eye].weight.back());
        CHECK(after.eyes.networks[eye].weight.front() != before.eyes.networks[eye].weight.front());
    }
    CHECK(after.eyes.kappa.size() == 0);
}

TEST_CASE("appearance: a kappa of 0 in an optical run changes nothing and stays 0") {
    TrainState state = begun(EyeAppearanceName::driven, ShadingName::head_pose), zero = state;
    zero.avatar.eyes.kappa = Columns<float>::Zero(2, 2);
    zero.avatar_adam = Adam<Avatar>(zero.avatar);
    const Folder folder;
    save_checkpoint(folder.path, zero);
    TrainState back = load_checkpoint(folder.path);
    CHECK(back.avatar.eyes.kappa == zero.avatar.eyes.kappa);
    for (TrainState* s : {&state, &back})
        for (int step = 0; step < 3; ++step)
            avatar_steps(*s, {})->step(*s, small_sample(*s), 1, [](const char*) {});
    CHECK((back.avatar.eyes.kappa.array() == 0).all());
    back.avatar.eyes.kappa = {};
    Avatar::fields([](const std::string& name, const auto& a,
                      const auto& b) { CHECK_MESSAGE(a == b, name); },
                   back.avatar, state.avatar);
}

TEST_CASE("appearance: what is drawn of a run by lines of sight is what is trained") {
    TrainState state = trained();
    state.config.gaze_axis = GazeAxis::visual;
    state.avatar.eyes.kappa.resize(2, 2);
    state.avatar.eyes.kappa << -0.03f, -0.02f, 0.09f, -0.08f;
    const Drivers<float> drivers = test::tiny_drivers<float>();
    const TrainState drawn = drawn_state(state);
    CHECK(drawn.avatar.eyes.kappa == state.avatar.eyes.kappa);
    const Gaussians<float> shown = driven_gaussians(drawn, drivers);
    CHECK(equal(shown, driven_gaussians(state, drivers)));
    CHECK(equal(driven_gaussians(drawn_state(drawn), drivers), shown));
    TrainState straight = drawn;
    straight.avatar.eyes.kappa = {};
    CHECK_FALSE(equal(driven_gaussians(straight, drivers), shown));
}

TEST_CASE("appearance: pictures are drawn by the smallest variant with what they call for") {
    for (const bool visual : {false, true}) {
        CAPTURE(visual);
        TrainState state = trained();
        if (visual) {
            state.config.gaze_axis = GazeAxis::visual;
            state.avatar.eyes.kappa.resize(2, 2);
            state.avatar.eyes.kappa << -0.03f, -0.02f, 0.09f, -0.08f;
        }
        // What the networks read of expression and head shows.
        for (Mlp<float>& mlp : state.avatar.eyes.networks)
            mlp.weight.front().rightCols(mlp.shape.frame_inputs).setConstant(0.3f);
        const TrainState drawn = drawn_state(state);
        DrawnFrame frame{test::tiny_drivers<float>(), test::tiny_camera(64, 48).cast<float>()};
        DrawnFrame turned = frame, looks = frame, talks = frame;
        turned.drivers.pose[1] += 0.3f;
        looks.drivers.gaze[0] = gaze_vector(0.1f, 0.3f);
        looks.drivers.gaze[1] = gaze_vector(0.1f, 0.2f);
        talks.drivers.expression[1] += 0.5f;
        const auto drawn_by = [&](const std::string& variant, const std::string& wanted,
                                  const DrawnFrame& other) {
            CAPTURE(variant);
            const FrameDrawer drawer(drawn, {frame, other}, wanted, "--effects", 0.01);
            CHECK(drawer.variant() == variant);
            for (const DrawnFrame& f : {frame, other})
                CHECK((drawer.picture(f).pixels - drawer.picture_by_all(f).pixels)
                          .cwiseAbs()
                          .maxCoeff() <= 1e-4f);
            return drawer.explanation();
        };
        drawn_by("paper", "auto", turned);
        drawn_by("talk", "auto", talks);
        CHECK(drawn_by("gaze", "auto", looks).find("eye appearance") != std::string::npos);
        CHECK(drawn_by("still", "auto", frame).find("left out     eye appearance") !=
              std::string::npos);
        TrainState with_irises = drawn;
        test::set_tiny_irises(with_irises.avatar.eyes);
        DrawnFrame wide = frame;
        wide.pupil = {1.6f, 0.7f};
        const FrameDrawer pupils(with_irises, {frame, wide}, "auto", "--effects", 0.01);
        CHECK(pupils.variant() == "gaze");
        CHECK(pupils.picture(wide).pixels != pupils.picture(frame).pixels);
        const FrameDrawer held(with_irises, {wide, wide}, "still", "--effects", 0.01);
        CHECK(held.explanation().find("left out     pupil: a pupil's ratio varies") !=
              std::string::npos);
        for (const FrameDrawer* drawer : {&pupils, &held})
            CHECK((drawer->picture(wide).pixels - drawer->picture_by_all(wide).pixels)
                      .cwiseAbs()
                      .maxCoeff() <= 1e-4f);
        const FrameDrawer still(drawn, {frame, looks}, "still", "--effects", 0.01);
        CHECK(still.explanation().find("NOT drawn    eye appearance") != std::string::npos);
        CHECK((still.picture(looks).pixels - still.picture_by_all(looks).pixels)
                  .cwiseAbs()
                  .maxCoeff() > 1e-3f);
    }
}

TEST_CASE("appearance: exported and read back, other programs draw the run's pictures") {
    const Folder folder;
    const TinyCapture files(folder.path / "capture");
    const Capture capture = read_capture(folder.path / "capture");
    for (const bool visual : {false, true}) {
        TrainState state = trained();
        if (visual) {
            state.config.gaze_axis = GazeAxis::visual;
            state.avatar.eyes.kappa.resize(2, 2);
            state.avatar.eyes.kappa << -0.03f, -0.02f, 0.09f, -0.08f;
        }
        // As label correction leaves them: corrections of the training frames' gazes.
        if (!visual) state.avatar.eyes.kappa = Columns<float>::Zero(2, 2);
        state.avatar.delta_gaze = Columns<float>::Constant(4, state.avatar.delta_pose.cols(), 0.1f);
        const TrainState drawn = drawn_state(state);
        PlayableAvatar<float> exported = playable_avatar(drawn, capture, 1, 0);
        CHECK_NOTHROW(rye::detail::check_corrections(exported.avatar, "exported"));
        // The run of random numbers has another code of expressions than the capture.
        exported.neutral.expression = test::tiny_drivers<float>().expression;
        exported.ranges.expression_low = exported.ranges.expression_high =
            exported.neutral.expression;
        exported.expression_names = {};
        write_avatar(folder.path / "a.avatar", exported, AvatarPrecision::full);
        const PlayableAvatar<float> read = read_avatar<float>(folder.path / "a.avatar");
        CHECK(has_driven_eyes(read.avatar));
        CHECK(read.avatar.shading.any());
        CHECK(read.visual_axes() == visual);
        AvatarPlayer<TrainBackend> player(train_backend(), read);
        DrawnFrame frame{read.neutral, test::tiny_camera(64, 48).cast<float>()};
        const FrameDrawer drawer(drawn, {frame}, "auto", "--effects", 0.01);
        const auto check = [&] {
            const Image<float>& picture =
                player.draw(frame.drivers, frame.camera, read.background);
            frame.dilation = player.dilation();
            // Equal but for rounding, which super-resolution's norm enlarges.
            CHECK((picture.pixels - drawer.picture_by_all(frame).pixels).cwiseAbs().maxCoeff() <=
                  1e-4f);
        };
        check();
        frame.drivers.gaze[0] = gaze_vector(0.1f, 0.3f);
        check();
        CHECK(player.work().networks == 3);
        frame.drivers.expression[1] += 0.5f;
        check();
        frame.drivers.pose[1] += 0.4f;
        check();
    }
}
