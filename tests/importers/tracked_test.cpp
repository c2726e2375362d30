// SPDX-License-Identifier: Apache-2.0
// Imports whose labels have the errors of trackers, and what is mended before a training.
#include <filesystem>
#include <iostream>
#include <optional>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>
#include <rye/rig/gaze.hpp>

#include "../support/hostile.hpp"
#include "comparison.hpp"
#include "data/config.hpp"
#include "data/validate.hpp"
#include "importers/hdf5_file.hpp"
#include "importers/import_folder.hpp"
#include "importers/subject_eyes.hpp"
#include "sources.hpp"
#include "training/labels.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

/// One head for all tests of this file, with enough frames for labels to be judged, and the same as
/// a tracker sees it.
struct Tracked {
    TemporaryFolder folder;
    TrueScene right, wrong;
    Tracked() {
        CaptureSettings s = small_settings();
        s.size = 224;
        s.cameras = 5;
        s.train_frames = 8;
        s.novel_frames = 2;
        right = true_scene(folder.path / "truth", s);
        wrong = captured_scene(folder.path / "truth", {});
        track(wrong, folder.path / "tracked", tracker_errors(false), 3);
    }
    static const Tracked& one() {
        static const Tracked tracked;
        return tracked;
    }
};

ImportOptions options(const fs::path& source, const fs::path& out) {
    ImportOptions o;
    o.source = source;
    o.out = out;
    return o;
}

/// Points of irises as eyes that look around would show them, with errors; every fifth is false.
std::vector<IrisPoint> iris_points(const std::array<EyeballInHead, 2>& eyes, bool labels) {
    const Random random{7};
    std::vector<IrisPoint> all;
    for (int f = 0; f < 12; ++f)
        for (std::size_t e = 0; e < 2; ++e) {
            const auto n = static_cast<std::uint64_t>(10 * f);
            const double pitch = 0.2 * random.normal(n), yaw = 0.3 * random.normal(n + 1);
            // Optical axes 5 degrees temporal of lines of sight that meet at a metre.
            const Vec3<double> gaze = gaze_vector(pitch, yaw + (e == 0 ? 0.052 : -0.052));
            IrisPoint p;
            p.frame = f;
            p.eye = e;
            p.at = eyes[e].centre + eyes[e].iris_plane * gaze;
            for (Index d = 0; d < 3; ++d)
                p.at[d] += 0.002 * random.normal(n + 2 + static_cast<std::uint64_t>(d) + 3 * e);
            if (e == 0 && f % 5 == 4) p.at += Vec3<double>(0.05, -0.06, 0.03);
            p.covariance = 0.003 * 0.003 * Mat3<double>::Identity();
            p.gaze = labels ? gaze : Vec3<double>(Vec3<double>::UnitZ());
            all.push_back(p);
        }
    return all;
}

} // namespace

TEST_CASE("tracked: eyeballs are found from points of irises, with gazes and without") {
    std::array<EyeballInHead, 2> truth{EyeballInHead{{0.31, 0.35, 0.8}, 0.15, 0.061, 0.137},
                                       EyeballInHead{{-0.31, 0.35, 0.8}, 0.15, 0.061, 0.137}};
    std::array<EyeballInHead, 2> start = truth;
    for (std::size_t e = 0; e < 2; ++e) {
        start[e].centre += Vec3<double>(e == 0 ? 0.02 : -0.02, -0.015, 0.02);
        start[e].iris_plane = 0.12;
        start[e].limbus_radius = 0.12 * 0.061 / 0.137;
    }
    for (const GivenGazes given : {GivenGazes::labels, GivenGazes::none}) {
        const bool labels = given == GivenGazes::labels;
        const auto found = fit_eyes(iris_points(truth, labels), start, given, 0.03);
        REQUIRE(found);
        CHECK(found->frames == 12);
        for (std::size_t e = 0; e < 2; ++e) {
            CHECK((found->eye[e].centre - truth[e].centre).norm() < (labels ? 0.006 : 0.012));
            CHECK(found->eye[e].iris_plane == doctest::Approx(0.137).epsilon(labels ? 0.06 : 0.1));
        }
        CHECK((start[0].centre - truth[0].centre).norm() > 0.03);
    }
    std::vector<IrisPoint> few = iris_points(truth, true);
    few.resize(10); // of five frames
    CHECK(!fit_eyes(few, start, GivenGazes::labels, 0.03));
}

TEST_CASE("tracked: errors are in the training frames alone, and of the sizes of trackers") {
    const Tracked& t = Tracked::one();
    const Comparison train = compare(t.right.capture, t.wrong.tracked, t.right.capture.train);
    INFO(train.text());
    CHECK(train.mean_gaze_deg > 3);
    CHECK(train.pose_deg > 0.5);
    CHECK(train.pose_mm > 0.8);
    CHECK(train.landmarks_mm == doctest::Approx(1.5).epsilon(0.1));
    CHECK(train.mean_centres_mm > 1);
    const Comparison test = compare(t.right.capture, t.wrong.tracked, t.right.capture.test);
    INFO(test.text());
    CHECK(test.gaze_deg < 1e-4);
    CHECK(test.pose_mm < 1e-6);
    CHECK(test.landmarks < 1e-6);
}

TEST_CASE("tracked: gha's gaze from the iris, on eyeballs that the pictures show") {
    const Tracked& t = Tracked::one();
    const TemporaryFolder folder;
    write_gha_source(t.right, folder.path / "source", 0.1);
    const ImportSummary summary = import_gha(options(folder.path / "source", folder.path / "out"));
    const Capture got = read_trainable_capture(folder.path / "out");
    const Comparison c = compare(t.right.capture, got);
    INFO(c.text());
    CHECK(c.mean_gaze_deg < 2.5);
    CHECK(c.mean_centres_mm < 2);
    CHECK(got.has_centres());
    CHECK(summary.derived.back().find(
              "eyeballs' centres and sizes, one pair for all frames, from ") ==
          std::string::npos); // the last is the factor of lengths
    // A second call finds the same.
    const Bytes before = read_file(folder.path / "out" / "params" / got.frames[2].id / "gaze.npz");
    CHECK(import_gha(options(folder.path / "source", folder.path / "out")).written == 0);
    CHECK(read_file(folder.path / "out" / "params" / got.frames[2].id / "gaze.npz") == before);
}

TEST_CASE("tracked: gha's gazes of a file are corrected by the irises before a training") {
    const Tracked& t = Tracked::one();
    const TemporaryFolder folder;
    write_gha_source(t.wrong, folder.path / "source", 0.1);
    write_gazes(t.wrong, folder.path / "gaze.csv");
    ImportOptions o = options(folder.path / "source", folder.path / "out");
    o.gaze = folder.path / "gaze.csv";
    import_gha(o);
    Capture got = read_trainable_capture(folder.path / "out");
    CHECK(got.has_centres());
    const Comparison before = compare(t.right.capture, got, got.train);
    const LabelFindings found = correct_labels(got, preset("cpu"));
    const Comparison after = compare(t.right.capture, got, got.train);
    INFO(before.text());
    INFO(after.text());
    CHECK(found.gazes);
    CHECK(found.poses);
    CHECK(before.mean_gaze_deg > 3);
    CHECK(after.mean_gaze_deg < 0.6 * before.mean_gaze_deg);
    CHECK(after.pose_mm < 0.6 * before.pose_mm);
}

TEST_CASE(
    "tracked: vhap's iris has the size that the pictures show, and the head follows the skull") {
    const Tracked& t = Tracked::one();
    const TemporaryFolder folder;
    write_vhap_source(t.right, folder.path / "source");
    import_vhap(options(folder.path / "source", folder.path / "out"));
    const Capture got = read_trainable_capture(folder.path / "out");
    const CaptureEye &eye = got.frames[0].eyes[0], &is = t.right.capture.frames[0].eyes[0];
    CHECK(*eye.limbus_radius / *eye.radius ==
          doctest::Approx(*is.limbus_radius / *is.radius).epsilon(0.1));
    // Centres that are 1.2 mm off do not move the head.
    FlawSizes centres;
    centres[Flaw::centres] = 1.2;
    TrueScene off = captured_scene(t.right.capture.folder, {});
    track(off, folder.path / "tracked", centres, 4);
    write_vhap_source(off, folder.path / "off");
    import_vhap(options(folder.path / "off", folder.path / "moved"));
    const Comparison c =
        compare(t.right.capture, read_trainable_capture(folder.path / "moved"), got.train);
    INFO(c.text());
    CHECK(c.mean_centres_mm > 1);
    CHECK(c.pose_mm < 0.1);
}

TEST_CASE("tracked: xgaze's eyeballs come from the irises and the gaze of the face") {
    if (!has_hdf5()) {
        std::cout << "not run: import of xgaze: rye was built without libhdf5\n";
        return;
    }
    const Tracked& t = Tracked::one();
    const TemporaryFolder folder;
    write_xgaze_source(t.right, folder.path / "gazenerf.h5", {}, XgazeFields::gazenerf);
    import_xgaze(options(folder.path / "gazenerf.h5", folder.path / "out"));
    const Capture got = read_trainable_capture(folder.path / "out");
    REQUIRE(got.has_centres());
    const Comparison c = compare(t.right.capture, got);
    INFO(c.text());
    CHECK(c.mean_centres_mm < 1.5);
}

TEST_CASE("tracked: an import gets true gazes, eyeballs and eye masks in its test frames") {
    const Tracked& t = Tracked::one();
    const TemporaryFolder folder;
    write_gha_source(t.wrong, folder.path / "source", 0.1);
    import_gha(options(folder.path / "source", folder.path / "out"));
    const Capture import = read_trainable_capture(folder.path / "out");
    write_test_labels(t.right.capture, import, TestGazes::true_axes, folder.path / "tests");
    const Capture tests = read_trainable_capture(folder.path / "tests");
    const Comparison c = compare(t.right.capture, tests, tests.test);
    INFO(c.text());
    CHECK(c.gaze_deg < 1e-3);
    CHECK(c.centres < 1e-5);
    CHECK(c.eye_overlap == 1);
    CHECK(compare(t.right.capture, tests, tests.train).gaze_deg ==
          compare(t.right.capture, import, import.train).gaze_deg);
    CHECK_FAULT(
        write_test_labels(t.right.capture, import, TestGazes::true_axes, folder.path / "tests"),
        "tests: exists already");
}
