// SPDX-License-Identifier: Apache-2.0
// `rye redirect --gaze-at`, `--idle` and `--labels`: gazes and lids of the pictures.
#include <doctest/doctest.h>

#include <algorithm>
#include <sstream>

#include <nlohmann/json.hpp>

#include <rye/math/rotation.hpp>

#include "../support/effect_sets.hpp"
#include "../support/hostile.hpp"
#include "commands/idle.hpp"
#include "commands/picture_labels.hpp"
#include "tiny_run.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

/// A run whose gazes are visual axes.
TrainState sighted_run() {
    TrainState s = tiny_state();
    s.config.gaze_axis = GazeAxis::visual;
    s.avatar.eyes.kappa.resize(2, 2);
    s.avatar.eyes.kappa << -0.03f, -0.03f, 0.09f, -0.09f;
    return s;
}

DrawnFrame one_frame() {
    return {test::tiny_drivers<float>(), test::tiny_camera(64, 48).cast<float>()};
}

/// A capture of frames with three coefficients.
Capture named_capture(const std::vector<std::string>& names, const std::vector<float>& largest) {
    Capture c;
    c.expression_names = names;
    c.frames.resize(2);
    c.frames[0].expression = std::vector<float>(largest.size(), 0.0f);
    c.frames[1].expression = largest;
    return c;
}

/// The distance of a point from an eye's visual axis, by the labels of the picture.
double beside(const nlohmann::json& eye, const nlohmann::json& label) {
    const auto vec = [](const nlohmann::json& j) {
        return Vec3<double>(j[0].get<double>(), j[1].get<double>(), j[2].get<double>());
    };
    Mat3<double> r;
    for (int i = 0; i < 3; ++i)
        r.row(i) = vec(label["camera"]["extrinsic"][static_cast<std::size_t>(i)]);
    const Vec3<double> along = r.transpose() * vec(eye["visual_in_camera"]),
                       d = vec(label["target"]) - vec(eye["centre"]);
    return (d - along * along.dot(d)).norm();
}

std::vector<nlohmann::json> labels(const TrainState& state, const std::vector<DrawnFrame>& frames,
                                   const GazeAtOptions& at) {
    std::istringstream lines(text_of_labels(state, frames, {}, at));
    std::vector<nlohmann::json> all;
    for (std::string line; std::getline(lines, line);) all.push_back(nlohmann::json::parse(line));
    return all;
}

bool same_drivers(const Drivers<float>& a, const Drivers<float>& b) {
    return a.gaze == b.gaze && a.expression == b.expression && a.pose == b.pose;
}

} // namespace

TEST_CASE("gaze at: what the option takes") {
    CHECK(parsed_gaze_point("camera", "").frame == GazePoint::Frame::camera);
    const GazePoint world = parsed_gaze_point("-1,2.5,1e3", "");
    CHECK(world.frame == GazePoint::Frame::world);
    CHECK(world.point == Vec3<double>(-1, 2.5, 1000));
    const GazePoint head = parsed_gaze_point("head:0,0,6", "");
    CHECK(head.frame == GazePoint::Frame::head);
    CHECK(head.point == Vec3<double>(0, 0, 6));
    for (const char* wrong : {"", "cam", "1,2", "1,2,3,4", "1,2,nan", "1,2,inf", "1,,3", "2e9,0,0",
                              "head:", "head:1,2", "world:1,2,3", "1,2,3,"})
        CHECK_FAULT(parsed_gaze_point(wrong, "--gaze-at"), "--gaze-at: got '");
}

TEST_CASE(
    "gaze at: visual axes of the labels pass the point, in the world, the head and the camera") {
    const TrainState state = sighted_run();
    for (const char* target : {"camera", "0.5,-0.4,4", "head:1,1,8", "head:-0.4,0.2,3"}) {
        CAPTURE(target);
        std::vector<DrawnFrame> frames{one_frame(), one_frame()};
        frames[1].drivers.pose[1] += 0.3f;
        const GazeAtOptions at{target};
        aim_frames(at, state, frames);
        for (const nlohmann::json& label : labels(state, frames, at))
            for (const char* eye : {"left", "right"}) {
                CHECK(100 * beside(label[eye], label) < 0.01); // [mm]: six digits of a label
                CHECK(label[eye]["optical"] != label[eye]["visual"]);
            }
    }
    std::vector<DrawnFrame> frames{one_frame()};
    const Vec3<double> centre = placed_eyes(state, frames[0].drivers).centre[1];
    std::ostringstream inside;
    inside << "head:" << centre.x() << "," << centre.y() + 0.1 << "," << centre.z();
    CHECK_FAULT(
        aim_frames({inside.str()}, state, frames),
        "--gaze-at: got " + inside.str() + ", which lies inside the right eye of picture 0");
}

TEST_CASE("idle: without its parts and with a still head it changes nothing") {
    const TrainState state = sighted_run();
    const Capture capture = named_capture({"jaw", "eyeBlink_L", "eyeBlink_R"}, {1, 0.8f, 0.9f});
    std::ostringstream say;
    const IdleOptions none{2, "1", {"saccades", "drift", "blinks", "lid-lag"}};
    const auto frames = idle_frames(none, {}, {25, 1}, state, capture, {one_frame()}, say);
    REQUIRE(frames.size() == 50);
    for (const DrawnFrame& f : frames) {
        CHECK(same_drivers(f.drivers, one_frame().drivers));
        CHECK(f.pupil == PupilRatios{1, 1}); // the run's eyes have no irises
    }
    CHECK(say.str() == "idle: 0 saccades, 0 blinks\n");
}

TEST_CASE("idle: pupils swing about what they were, in their range, and are left out") {
    TrainState state = sighted_run();
    test::set_tiny_irises(state.avatar.eyes);
    std::ostringstream say;
    DrawnFrame frame = one_frame();
    frame.pupil = {1.2f, 2};
    IdleOptions o{4, "1", {"saccades", "drift", "blinks", "lid-lag"}};
    float least = 2, most = 0;
    for (const DrawnFrame& f : idle_frames(o, {}, {25, 1}, state, {}, {frame}, say)) {
        least = std::min(least, f.pupil[0]);
        most = std::max(most, f.pupil[0]);
        CHECK(f.pupil[1] <= 2);
    }
    CHECK(labels(state, {frame}, {})[0]["left"]["pupil"] == 1.2);
    CHECK(labels(state, {frame}, {})[0]["right"]["pupil"] == 2);
    CHECK(least < 1.2f);
    CHECK(most > 1.2f);
    o.without.push_back("pupils");
    for (const DrawnFrame& f : idle_frames(o, {}, {25, 1}, state, {}, {frame}, say))
        CHECK(f.pupil == frame.pupil);
}

TEST_CASE("idle: the same seed draws the same, and lids close by the coefficients of blinks") {
    const TrainState state = sighted_run();
    const Capture capture = named_capture({"jaw", "eyeBlink_L", "EyeBlinkRight"}, {1, 0.8f, 0.9f});
    std::ostringstream say;
    const auto idle = [&](const IdleOptions& o) {
        return idle_frames(o, {}, {100, 1}, state, capture, {one_frame()}, say);
    };
    const auto a = idle({20, "3", {}}), b = idle({20, "3", {}}), c = idle({20, "4", {}});
    CHECK(say.str().find("blinks (eyeBlink_L to 0.8, EyeBlinkRight to 0.9)") != std::string::npos);
    REQUIRE(a.size() == 2000);
    float left = -1, right = -1;
    bool differs = false;
    for (std::size_t i = 0; i < a.size(); ++i) {
        CHECK(same_drivers(a[i].drivers, b[i].drivers));
        differs = differs || !same_drivers(a[i].drivers, c[i].drivers);
        left = std::max(left, a[i].drivers.expression[1]);
        right = std::max(right, a[i].drivers.expression[2]);
        CHECK(a[i].drivers.expression[0] == one_frame().drivers.expression[0]);
    }
    CHECK(differs);
    CHECK(left > 0.78f);
    CHECK(left <= 0.8f);
    CHECK(right > 0.88f);
}

TEST_CASE("idle: while the head turns, the eyes keep their point, or turn with the head") {
    const TrainState state = sighted_run();
    std::vector<DrawnFrame> turning(25, one_frame());
    for (std::size_t i = 0; i < turning.size(); ++i)
        turning[i].drivers.pose[1] += 0.01f * static_cast<float>(i);
    std::ostringstream say;
    const auto world = [](const DrawnFrame& f) {
        return Vec3<float>(so3_exp(Vec3<float>(f.drivers.pose.head<3>())) * f.drivers.gaze[0]);
    };
    IdleOptions o{1, "1", {"saccades", "drift", "blinks", "lid-lag"}};
    const auto kept = idle_frames(o, {}, {25, 1}, state, {}, turning, say);
    CHECK((world(kept.back()) - world(kept.front())).norm() < 1e-6f);
    const GazeAtOptions at{"0.5,-0.4,4"};
    const auto aimed = idle_frames(o, at, {25, 1}, state, {}, turning, say);
    for (const nlohmann::json& label : labels(state, aimed, at))
        CHECK(100 * beside(label["left"], label) < 0.01);
    o.without.push_back("vor");
    const auto fixed = idle_frames(o, {}, {25, 1}, state, {}, turning, say);
    CHECK(fixed.back().drivers.gaze == turning.front().drivers.gaze);
    CHECK_FAULT(idle_frames({2, "1", {}}, {}, {25, 1}, state, {}, turning, say),
                "--idle: got 2 s, 50 pictures at 25 a second, but --driving or --cameras has 25");
}

TEST_CASE("idle: what a run cannot show is left out, and named") {
    const TrainState state = sighted_run();
    std::ostringstream say;
    idle_frames({1, "1", {}}, {}, {25, 1}, state, named_capture({}, {0, 1, 1}), {one_frame()}, say);
    CHECK(say.str().find("blinks are left out: the coefficients of the expression have no names") !=
          std::string::npos);
    say.str("");
    idle_frames({1, "1", {}}, {}, {25, 1}, state,
                named_capture({"a", "eyeBlink_L", "c"}, {0, 0, 1}), {one_frame()}, say);
    CHECK(say.str().find("no coefficient whose name has 'blink' in it varies") !=
          std::string::npos);
    say.str("");
    idle_frames({1, "1", {}}, {}, {25, 1}, state,
                named_capture({"a", "eyeBlink_L", "c"}, {0, 0.3f, 1}), {one_frame()}, say);
    CHECK(say.str().find("show no closed eye") != std::string::npos);
    Capture single = named_capture({"eyeBlink_L", "eyeWide_L", "jaw"}, {0, 0, 0});
    single.frames.pop_back();
    const LidCoefficients<float> lids = lids_of(single);
    REQUIRE(lids.blink.size() == 1);
    CHECK(lids.blink[0].most == 1.0f);
    CHECK(lids.wide[0].index == 1);
}
