// SPDX-License-Identifier: Apache-2.0
// Kappa of a rendered capture, from the irises in its photographs and the visual axes of its
// labels, against what its head was made with; and the errors of a run's kappa that rye evaluate
// reports.
#include "corrections/found_kappa.hpp"

#include <doctest/doctest.h>

#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "evaluation/kappa_errors.hpp"
#include "right_capture.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

/// Returns the distance of a found kappa from an eye's (yaw, pitch) [deg].
double off(const FoundKappa& found, std::size_t eye, const Vec2<double>& kappa) {
    const Vec2<double> angles = degrees * found.angles[eye];
    return (Vec2<double>(angles[1], angles[0]) - kappa).norm();
}

} // namespace

TEST_CASE("kappa: found by the irises of a rendered head, and nothing without eye masks") {
    const RightCapture& right = right_capture();
    const double radius = 0.12;
    const FoundKappa found = find_kappa(right.capture, radius);
    for (const std::string& line : found.lines()) MESSAGE(line);
    for (std::size_t e = 0; e < 2; ++e) {
        const CaptureEye& eye = right.frame(0).eyes[e];
        REQUIRE(eye.kappa);
        CHECK(eye.kappa->norm() > 4); // else nothing would be told apart
        CHECK(found.frames[e] >= 6);
        CHECK(off(found, e, *eye.kappa) < 0.5);
    }

    // Labels whose visual axes are turned by 3 degrees have another kappa; a few wild ones do not.
    Capture turned = read_capture(right.path);
    for (CaptureFrame& f : turned.frames)
        for (CaptureEye& eye : f.eyes) {
            const Vec2<double> angles = pitch_yaw(*eye.visual);
            eye.visual = gaze_vector(angles[0], angles[1] - 3 * degree);
        }
    const CaptureFrame& last = turned.frames[static_cast<std::size_t>(turned.train.back())];
    turned.frames[static_cast<std::size_t>(turned.train.back())].eyes[0].visual =
        gaze_vector(0.9, -0.9);
    CHECK(last.eyes[0].visual->y() > 0.5);
    const FoundKappa other = find_kappa(turned, radius);
    for (std::size_t e = 0; e < 2; ++e)
        CHECK(off(other, e, *right.frame(0).eyes[e].kappa + Vec2<double>(3, 0)) < 0.8);

    // The same bits again; nothing where nothing is seen.
    CHECK(find_kappa(turned, radius).angles == other.angles);
    Capture blind = read_capture(right.path);
    blind.has_eye_masks = false;
    CHECK(find_kappa(blind, radius).frames == std::array<int, 2>{0, 0});
    Capture few = read_capture(right.path);
    few.train.resize(4);
    CHECK(find_kappa(few, radius).angles[0].isZero());
    CHECK(find_kappa(few, radius).lines()[0].find("kappa, left: not found, as ") == 0);
    for (CaptureFrame& f : few.frames) f.eyes[1].centre.reset();
    CHECK(find_kappa(few, radius).frames == std::array<int, 2>{0, 0});
}

TEST_CASE("kappa: errors of a run's, and none where it or the capture has none") {
    const RightCapture& right = right_capture();
    const std::vector<int>& frames = right.capture.test;
    TrainState state;
    state.avatar.eyes.kappa = Columns<float>::Zero(2, 2);
    const auto set = [&](Index eye, double yaw, double pitch) {
        state.avatar.eyes.kappa(0, eye) = static_cast<float>(pitch * degree);
        state.avatar.eyes.kappa(1, eye) = static_cast<float>(yaw * degree);
    };
    const Vec2<double> left = *right.frame(0).eyes[0].kappa, rights = *right.frame(0).eyes[1].kappa;
    set(0, left[0] + 3, left[1] - 4);
    set(1, rights[0], rights[1]);
    CHECK(!kappa_errors(state, right.capture, frames).eyes[0]); // optical axes: it is not used
    state.config.gaze_axis = GazeAxis::visual;
    const KappaErrors errors = kappa_errors(state, right.capture, frames);
    REQUIRE(errors.eyes[0]);
    REQUIRE(errors.eyes[1]);
    CHECK(errors.eyes[0]->off() == doctest::Approx(5).epsilon(1e-4));
    CHECK(errors.eyes[1]->off() < 1e-4);
    CHECK(errors.json().at("left").at("degrees").get<double>() == errors.eyes[0]->off());

    Capture without = read_capture(right.path);
    for (CaptureFrame& f : without.frames) f.eyes[1].kappa.reset();
    CHECK(kappa_errors(state, without, frames).eyes[0]);
    CHECK(!kappa_errors(state, without, frames).eyes[1]);
    CHECK(kappa_errors(state, without, frames).json().size() == 1);
}
