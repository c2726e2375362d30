// SPDX-License-Identifier: Apache-2.0
#include "evaluation/head_alignment.hpp"

#include <unistd.h>

#include <doctest/doctest.h>

#include "../programs/tiny_capture.hpp"
#include "../programs/tiny_run.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

TEST_CASE("head alignment: a motion that all head poses are off by is found and taken out") {
    const fs::path folder =
        fs::temp_directory_path() / ("rye_head_alignment_" + std::to_string(::getpid()));
    const TinyCapture files(folder);
    for (int f = 0; f < TinyCapture::frames; ++f)
        TinyCapture::set(files.params(f, "params.npz"), "exp_coeff", {1, 3},
                         std::vector<float>{0.1f, -0.2f, 0.1f * static_cast<float>(f)});
    Capture capture = read_capture(folder);
    fs::remove_all(folder);
    TrainState run = tiny_state();
    run.config.mesh.landmarks_follow_gaze = false; // lids follow gazes, which turn with the head
    const Columns<double> rest = run.mesh.landmarks.cast<double>();
    // The landmarks of the run at rest, in the world of each frame's pose; no dense vertices.
    for (CaptureFrame& f : capture.frames) {
        const Mat3<double> turn = so3_exp(Vec3<double>(f.pose.head<3>()));
        f.landmarks = (f.scale * turn * rest).colwise() + Vec3<double>(f.pose.tail<3>());
        f.vertices.resize(3, 0);
    }
    const std::vector<int> frames{0, 1, 2, 3};
    const HeadAlignment none = head_alignment(run, capture, frames);

    const Rigid<double> off{so3_exp(Vec3<double>(0.02, -0.03, 0.01)), Vec3<double>(0.03, 0.01, -0.02)};
    std::vector<Vec3<double>> gaze;
    for (const CaptureFrame& f : capture.frames)
        gaze.push_back(so3_exp(Vec3<double>(f.pose.head<3>())) * f.eyes[0].optical);
    take_head_frame(capture, off);
    for (std::size_t f = 0; f < gaze.size(); ++f) {
        const CaptureFrame& frame = capture.frames[f];
        CHECK((so3_exp(Vec3<double>(frame.pose.head<3>())) * frame.eyes[0].optical - gaze[f]).norm() <
              1e-12);
    }
    const HeadAlignment found = head_alignment(run, capture, frames);
    CHECK(found.turn_degrees() > 1);
    CHECK(found.after_mm == doctest::Approx(none.after_mm));
    // capture_from_run goes through the frame before the change.
    const Rigid<double> through = compose(off, found.capture_from_run);
    CHECK((through.rotation - none.capture_from_run.rotation).norm() < 1e-9);
    CHECK((through.translation - none.capture_from_run.translation).norm() < 1e-9);

    take_head_frame(capture, found.capture_from_run);
    const HeadAlignment again = head_alignment(run, capture, frames);
    CHECK(again.turn_degrees() < 1e-6);
    CHECK(again.shift_mm() < 1e-9);
    CHECK(again.before_mm == doctest::Approx(found.after_mm));
    CHECK(again.before_mm <= found.before_mm);
}
