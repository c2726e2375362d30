// SPDX-License-Identifier: Apache-2.0
#include "run.hpp"

#include <doctest/doctest.h>

#include <rye/avatar/hold.hpp>
#include <rye/capture/safetensors.hpp>

#include "steps.hpp"
#include "tiny_capture.hpp"
#include "tiny_run.hpp"
#include "validate.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

struct Folder {
    fs::path path = fs::temp_directory_path() / "rye_run_test";
    Folder() {
        fs::remove_all(path);
        fs::create_directories(path);
    }
    ~Folder() { fs::remove_all(path); }
};

/// The tiny run, trained by lines of sight, with a kappa of a few degrees.
TrainState sight_state() {
    TrainState s = tiny_state();
    s.config.gaze_axis = GazeAxis::visual;
    VisualTraining& t = s.visual.emplace();
    t.avatar = restricted<VisualEffects>(s.avatar);
    t.avatar.eyes.kappa.resize(2, 2);
    t.avatar.eyes.kappa << -0.03f, -0.02f, 0.09f, -0.08f;
    t.adam = Adam<VisualAvatar>(t.avatar);
    t.adam.m.eyes.kappa(0, 1) = 0.25f;
    t.adam.step = 7;
    s.avatar = {};
    s.avatar_adam = {};
    return s;
}

std::string message(const fs::path& run) {
    try {
        load_checkpoint(run);
    } catch (const Error& e) {
        return e.what();
    }
    return "accepted";
}

} // namespace

TEST_CASE("run: one by lines of sight comes back from its checkpoint, with its kappa") {
    const Folder folder;
    const TrainState state = sight_state();
    save_checkpoint(folder.path, state);
    const TrainState back = load_checkpoint(folder.path);
    CHECK(back.config.gaze_axis == GazeAxis::visual);
    CHECK(read_safetensors(checkpoint_path(folder.path)).has("avatar.eyes.kappa"));
    REQUIRE(back.visual.has_value());
    VisualAvatar::fields([](const std::string& name, const auto& a, const auto& b) {
        INFO(name);
        CHECK((a.array() == b.array()).all());
    }, back.visual->avatar, state.visual->avatar);
    CHECK(back.visual->adam.m.eyes.kappa(0, 1) == 0.25f);
    CHECK(back.visual->adam.step == 7);
    CHECK(back.avatar.face.position.size() == 0);
}

TEST_CASE("run: an optical one has no tensor of kappa") {
    const Folder folder;
    save_checkpoint(folder.path, tiny_state());
    CHECK(!read_safetensors(checkpoint_path(folder.path)).has("avatar.eyes.kappa"));
    const TrainState back = load_checkpoint(folder.path);
    CHECK(back.config.gaze_axis == GazeAxis::optical);
    CHECK(!back.visual.has_value());
    CHECK(drawn_state(back).kappa.size() == 0);
}

TEST_CASE("run: a checkpoint that does not fit its gaze_axis is refused, and why") {
    const Folder folder;
    TrainState state = sight_state();
    state.config.gaze_axis = GazeAxis::optical;
    save_checkpoint(folder.path, state);
    CHECK(message(folder.path).find("got a tensor 'avatar.eyes.kappa', expected none: the run's "
                                    "gaze_axis is 'optical'") != std::string::npos);
    state = tiny_state();
    state.config.gaze_axis = GazeAxis::visual;
    save_checkpoint(folder.path, state);
    CHECK(message(folder.path).find("there is no tensor 'avatar.eyes.kappa', expected one: the "
                                    "run's gaze_axis is 'visual'") != std::string::npos);
}

TEST_CASE("run: what is drawn of one by lines of sight is what is trained, bit for bit") {
    const TrainState state = sight_state(), drawn = drawn_state(state);
    const Drivers<float> drivers = test::tiny_drivers<float>();
    TwoStreamTrace<float, VisualEffects> trace;
    drive<TrainBackend>(state.visual->avatar, state.config.avatar, state.subject.roles,
                        restricted<VisualEffects>(drivers), trace);
    const Gaussians<float> trained = joined(trace.world_face, trace.world_eyes);
    Gaussians<float>::fields([](const std::string& name, const auto& a, const auto& b) {
        INFO(name);
        CHECK((a.array() == b.array()).all());
    }, driven_gaussians(drawn, drivers), trained);
    // It is not what the same gazes show as optical axes.
    TrainState optical = drawn;
    optical.kappa = {};
    CHECK((driven_gaussians(optical, drivers).mean.array() != trained.mean.array()).any());
}

TEST_CASE("run: a step by lines of sight moves kappa, and the rate 0 keeps it") {
    for (const double rate : {1e-3, 0.0}) {
        TrainState state = sight_state();
        state.config.gaussians.rates.kappa = rate;
        state.config.gaussians.weights.eye_smooth = 0;
        const Columns<float> before = state.visual->avatar.eyes.kappa;
        AvatarSample<float> s;
        s.drivers = test::tiny_drivers<float>();
        s.camera = test::tiny_camera(32, 24).cast<float>();
        const Index pixels = 32 * 24;
        s.truth_small = Image<float>(32, 24, 3);
        s.truth_small.pixels.setConstant(0.5f);
        s.truth = Image<float>(64, 48, 3);
        s.truth.pixels.setConstant(0.5f);
        for (Columns<float>* a : {&s.visible_small, &s.eyes_small, &s.mask_small})
            *a = Columns<float>::Ones(1, pixels);
        for (Columns<float>* a : {&s.visible, &s.eyes}) *a = Columns<float>::Ones(1, 4 * pixels);
        s.background = s.blank = VecX<float>::Ones(state.config.avatar.channels);
        const StepReport report =
            avatar_steps(state, {})->step(state, s, 1, [](const char*) {});
        CHECK(report.bad_field.empty());
        CHECK(state.step == 1);
        const Columns<float>& after = state.visual->avatar.eyes.kappa;
        CHECK(((after - before).cwiseAbs().minCoeff() > 0) == (rate > 0));
        CHECK(((after - before).cwiseAbs().maxCoeff() > 0) == (rate > 0));
    }
}

TEST_CASE("run: a capture without lines of sight does not do for one by them") {
    const Folder folder;
    const TinyCapture tiny(folder.path);
    CHECK_NOTHROW(require_gazes(read_capture(folder.path), GazeAxis::visual));
    TinyCapture::remove(tiny.params(2, "gaze.npz"), "visual_right");
    const Capture capture = read_capture(folder.path);
    CHECK_NOTHROW(require_gazes(capture, GazeAxis::optical));
    CHECK_THROWS_WITH_AS(require_gazes(capture, GazeAxis::visual),
                         doctest::Contains("frame '0002': gaze.npz has no visual_right, expected it "
                                           "in every frame, since the run's gaze_axis is 'visual'"),
                         Error);
}
