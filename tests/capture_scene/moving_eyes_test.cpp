// SPDX-License-Identifier: Apache-2.0
// Eyeballs that expression and head pose displace (`rye capture --eye-translation`), and how the
// eye offset D_e learns that.
#include <cmath>
#include <filesystem>

#include <doctest/doctest.h>

#include <rye/avatar/eye_offset.hpp>
#include <rye/loss/mesh_terms.hpp>
#include <rye/nn/adam.hpp>

#include "corrections/centre_errors.hpp"
#include "data/samples.hpp"
#include "data/validate.hpp"
#include "synthetic_capture/scene.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

using V3 = Vec3<double>;

const HeadModel& head() {
    static const HeadModel model = procedural_head(1);
    return model;
}

CaptureSettings settings(double mm) {
    CaptureSettings s{.size = 32,
                      .cameras = 1,
                      .train_frames = 16,
                      .novel_frames = 4,
                      .independent_frames = 0,
                      .samples = 1};
    s.eye_translation_mm = mm;
    return s;
}

/// A capture with eyeballs that move by up to 3 mm, written once.
struct Moving {
    fs::path path = fs::temp_directory_path() / "rye_moving_eyes_test";
    CaptureScene scene = capture_scene(head(), settings(3));
    Capture capture;
    Moving() {
        fs::remove_all(path);
        write_capture(head(), scene, path, [](int, int) {});
        capture = read_capture(path);
    }
    ~Moving() { fs::remove_all(path); }
};
const Moving& moving() {
    static const Moving made;
    return made;
}

/// A state of stage 2 whose D_e was trained by L_eye of stage 1 alone.
TrainState with_offset(bool measured) {
    const Capture& capture = moving().capture;
    TrainState s;
    s.config = preset("tiny");
    s.config.measured_eyes = measured;
    s.config.avatar.expression = capture.expression_width();
    s.subject = describe_subject(capture, s.config);
    const AvatarConfig& config = s.config.avatar;
    using Offset = EyeOffsetNetwork<float>;
    Offset offset = Offset::init(config, Random{1, 0}), grad = zeros_like(offset);
    Adam<Offset> adam(offset);
    EyeOffsetTrace<float> trace;
    constexpr int steps = 3000;
    for (int step = 0; step < steps; ++step) {
        Offset::fields([](const std::string&, auto& a) { a.setZero(); }, grad);
        const int frame = capture.train[static_cast<std::size_t>(step) % capture.train.size()];
        const auto code = frame_code(
            config, OpticalDrivers<float>(frame_drivers(capture, frame, s.config.gaze_axis)));
        const Columns<float> moved =
            eye_offset<float>(train_backend(), offset, config, code, trace);
        const LossTerm<float> term = detail::eye_offset_term<float>(
            moved, eye_displacement(capture, s.subject, frame).cast<float>());
        VecX<float> g_pose = VecX<float>::Zero(code.pose.size());
        eye_offset_vjp<float>(train_backend(), offset, {config, trace}, term.gradient,
                              {grad, g_pose});
        const double rate = 1e-3 * std::pow(0.02, double(step) / steps);
        adam_step(train_backend(), offset, grad, adam, [&](const std::string&) { return rate; });
    }
    s.avatar.eyes.offset = offset;
    s.avatar.eyes.centre.resize(3, 2);
    for (std::size_t e = 0; e < 2; ++e)
        s.avatar.eyes.centre.col(static_cast<Index>(e)) = s.subject.eye_centre[e].cast<float>();
    return s;
}

} // namespace

TEST_CASE("moving eyes: 0 is the scene without; more displaces by expression and pose, up to it") {
    const CaptureScene still = capture_scene(head(), settings(0)), moved = moving().scene;
    double most = 0, least = 1;
    for (std::size_t i = 0; i < still.frames.size(); ++i) {
        const SceneFrame &a = still.frames[i], &b = moved.frames[i];
        CHECK(a.pose == b.pose);
        CHECK(a.state.expression == b.state.expression);
        for (std::size_t e = 0; e < 2; ++e) {
            CHECK(a.state.eye_offset[e].isZero(0));
            const double size = b.state.eye_offset[e].norm();
            most = std::max(most, size);
            if (i > 0) least = std::min(least, size);
        }
        if (i == 0) CHECK(b.state.eye_offset[0].isZero(0));
    }
    CHECK(most < 0.03);
    CHECK(most > 0.02);
    CHECK(least > 0.001);
    // An eye that is not displaced keeps every vertex, to the bit.
    Points vertices = head().vertices(VecX<double>::Zero(still.frames[0].state.expression.size()),
                                      VecX<double>::Zero(8));
    const Points before = vertices;
    Eyeball eye = head().eyes[0];
    displace_eye(vertices, eye, V3::Zero());
    CHECK(vertices == before);
    displace_eye(vertices, eye, V3(0.02, 0, 0));
    CHECK((eye.centre - head().eyes[0].centre).norm() == doctest::Approx(0.02));
    CHECK((vertices - before).colwise().norm().maxCoeff() == doctest::Approx(0.02));
    CHECK(V3(vertices.col(head().landmarks[8])) == V3(before.col(head().landmarks[8])));
}

TEST_CASE("moving eyes: labels have the displaced centres, and lids that go with them") {
    const Capture& c = moving().capture;
    std::vector<Problem> warnings;
    CHECK_NOTHROW(read_valid_capture(moving().path, {}, &warnings));
    for (std::size_t f = 0; f < c.frames.size(); ++f) {
        const SceneFrame& made = moving().scene.frames[f];
        for (std::size_t e = 0; e < 2; ++e) {
            const V3 centre = made.state.world_from_head.apply(
                V3(head().eyes[e].centre + made.state.eye_offset[e]));
            CHECK((*c.frames[f].eyes[e].centre - centre).norm() < 1e-12);
            if (!made.target) continue;
            const V3 sight = made.state.world_from_head.turn(made.visual[e]);
            CHECK(V3((*made.target - centre).normalized() - sight).norm() < 1e-12);
        }
        // Landmarks around the eye against the same frame with eyes that stay.
        HeadState still = made.state;
        still.eye_offset = {V3::Zero(), V3::Zero()};
        const PosedHead here(head(), made.state), there(head(), still);
        for (int e = 0; e < 2; ++e) {
            V3 lids = V3::Zero();
            for (int k = 0; k < 6; ++k) {
                const Index v = head().landmarks[static_cast<std::size_t>((e == 0 ? 42 : 36) + k)];
                lids += V3(here.vertices().col(v) - there.vertices().col(v)) / 6;
            }
            const V3 by =
                made.state.world_from_head.turn(made.state.eye_offset[static_cast<std::size_t>(e)]);
            CHECK((lids - by).norm() <= 0.5 * by.norm() + 1e-12);
        }
        if (f > 1) break;
    }
}

TEST_CASE("moving eyes: a translation out of range is refused by name") {
    for (const double mm : {-1.0, 5.5, std::nan("")})
        CHECK_THROWS_WITH_AS(capture_scene(head(), settings(mm)),
                             doctest::Contains("the eye translation [mm], expected 0 to 5"), Error);
}

TEST_CASE("moving eyes: D_e of measured centres is nearer to the truth than none") {
    const TrainState s = with_offset(true);
    const CentreErrors train = centre_errors(s, moving().capture, moving().capture.train);
    CHECK(train.eyes == 32);
    CHECK(train.without > 1);
    CHECK(train.with < 0.3 * train.without);
    const CentreErrors test = centre_errors(s, moving().capture, moving().capture.test);
    CHECK(test.eyes == 8);
    CHECK(test.with < 0.9 * test.without);
    MESSAGE("measured: training ", train.with, " of ", train.without, " mm, test ", test.with,
            " of ", test.without, " mm");
}

TEST_CASE("moving eyes: D_e of landmarks is nearer to the motion than none") {
    const TrainState s = with_offset(false);
    const CentreErrors train = centre_errors(s, moving().capture, moving().capture.train);
    const CentreErrors test = centre_errors(s, moving().capture, moving().capture.test);
    MESSAGE("landmarks: training ", train.with, " of ", train.without, " mm, motion ",
            train.motion_with, " of ", train.motion_without, " mm; test motion ", test.motion_with,
            " of ", test.motion_without, " mm");
    CHECK(train.motion_with < 0.6 * train.motion_without);
    CHECK(test.motion_with < 0.8 * test.motion_without);
}
