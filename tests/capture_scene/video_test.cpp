// SPDX-License-Identifier: Apache-2.0
// `rye capture --video`: what the camera films, and the file.
#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <string>

#include <doctest/doctest.h>
#include <CLI/CLI.hpp>

#include <rye/math/rotation.hpp>

#include "../support/hostile.hpp"
#include "commands/commands.hpp"
#include "data/capture.hpp"
#include "synthetic_capture/video_scene.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

constexpr double degree = 0.017453292519943295;

void run(std::vector<std::string> words) {
    CLI::App app{"rye"};
    add_capture(app);
    std::reverse(words.begin(), words.end());
    app.parse(words);
}

} // namespace

TEST_CASE("video: one camera, a head that turns smoothly to both sides, eyes that jump") {
    const HeadModel model = procedural_head(1, 0);
    VideoSettings film;
    film.frames = 160;
    film.rate = 20;
    const CaptureScene scene = video_scene(model, {}, film);
    REQUIRE(scene.frames.size() == 160);
    CHECK(scene.cameras.size() == 1);
    CHECK(scene.cameras[0].camera.fx == doctest::Approx(film.focal * scene.settings.size));
    double left = 0, right = 0, fastest = 0;
    int jumps = 0, tests = 0;
    for (std::size_t i = 0; i < scene.frames.size(); ++i) {
        const SceneFrame& f = scene.frames[i];
        left = std::max(left, f.pose[1]);
        right = std::min(right, f.pose[1]);
        tests += f.kind == FrameKind::novel ? 1 : 0;
        CHECK((f.state.world_from_head.rotation - so3_exp(Vec3<double>(f.pose.head<3>()))).norm() < 1e-12);
        CHECK(f.state.expression.minCoeff() >= 0);
        CHECK(f.state.expression.maxCoeff() <= 1);
        if (i == 0) continue;
        const SceneFrame& before = scene.frames[i - 1];
        fastest = std::max(fastest, (f.pose - before.pose).norm());
        jumps += *f.fixation_deg != *before.fixation_deg ? 1 : 0;
    }
    CHECK(left > 35 * degree);
    CHECK(right < -35 * degree);
    CHECK(fastest < 3 * degree);
    CHECK(jumps == 15); // twice a second
    CHECK(tests == 32);
    film.frames = 1;
    CHECK_FAULT(video_scene(model, {}, film), "got 1.000000 for the frames, expected 2");
    film.frames = 2;
    film.turn_deg = 90;
    CHECK_FAULT(video_scene(model, {}, film), "for the turn [deg], expected");
}

TEST_CASE("video: a camera in a hand films what a camera films that sways under lights that stand") {
    const HeadModel model = procedural_head(1);
    VideoSettings film;
    film.frames = 30;
    CaptureSettings small;
    small.size = 64;
    const CaptureScene still = video_scene(model, small, film);
    film.hand_held = true;
    const CaptureScene held = video_scene(model, small, film);
    CHECK(held.cameras[0].camera.camera_from_world.translation ==
          still.cameras[0].camera.camera_from_world.translation);
    double turned = 0, moved = 0;
    for (std::size_t i = 0; i < held.frames.size(); ++i) {
        const SceneFrame &h = held.frames[i], &s = still.frames[i];
        CHECK((h.state.world_from_head.rotation - so3_exp(Vec3<double>(h.pose.head<3>()))).norm() < 1e-12);
        const Rigid<double> sway = compose(s.state.world_from_head, h.state.world_from_head.inverse());
        CHECK((sway.rotation * h.state.world_from_lights - Mat3<double>::Identity()).norm() < 1e-12);
        turned = std::max(turned, so3_log(sway.rotation).norm());
        const Vec3<double> at = still.cameras[0].camera.centre();
        moved = std::max(moved, (sway.apply(at) - at).norm());
    }
    CHECK(turned > degree);
    CHECK(turned < 4 * degree);
    CHECK(moved > 0.1);
    CHECK(moved < 0.4);
    // The same head and eyes under lights that stand, filmed by a camera that has moved.
    const HeadState& seen = held.frames[17].state;
    HeadState true_state = seen;
    const Rigid<double> sway{Mat3<double>(seen.world_from_lights.transpose()),
                             still.frames[17].state.world_from_head.apply(
                                 seen.world_from_head.inverse().apply(Vec3<double>::Zero()))};
    true_state.world_from_head = compose(sway, seen.world_from_head);
    true_state.world_from_lights.setIdentity();
    Pinhole<double> camera = held.cameras[0].camera;
    camera.camera_from_world = compose(camera.camera_from_world, sway.inverse());
    const auto picture = [&](const HeadState& state, const Pinhole<double>& from) {
        return PosedHead(model, state).picture(from, 4).image.pixels;
    };
    const auto truth = picture(true_state, camera);
    CHECK((picture(seen, held.cameras[0].camera) - truth).norm() < 2e-3F * truth.norm());
    HeadState unlit = seen;
    unlit.world_from_lights.setIdentity();
    CHECK((picture(unlit, held.cameras[0].camera) - truth).norm() > 4e-3F * truth.norm());
}

TEST_CASE("video: the file has the capture's pictures before a wall") {
    const TemporaryFolder folder;
    const fs::path out = folder.path / "truth", file = folder.path / "head.y4m";
    run({"capture", "--out", out.string(), "--video", file.string(), "--frames", "2", "--size", "48",
         "--samples", "1", "--rate", "12", "--quiet"});
    const Capture capture = read_capture(out);
    CHECK(capture.frame_count() == 2);
    CHECK(capture.camera_count() == 1);
    CHECK(capture.has_gaze());
    std::ifstream in(file, std::ios::binary);
    const std::string bytes{std::istreambuf_iterator<char>(in), {}};
    REQUIRE(bytes.find("YUV4MPEG2 W48 H48 F12:1") == 0);
    const std::size_t begin = bytes.find("FRAME\n") + 6;
    REQUIRE(bytes.size() == begin + 48 * 48 * 3 + 6 + 48 * 48 * 3);
    // The upper left corner is wall, whose luma is about 155 of 255.
    CHECK(static_cast<unsigned char>(bytes[begin]) > 130);
    CHECK(static_cast<unsigned char>(bytes[begin]) < 180);
    CHECK_THROWS_AS(run({"capture", "--out", (folder.path / "x").string(), "--video", file.string(),
                         "--cameras", "3"}),
                    CLI::ParseError);
}
