// SPDX-License-Identifier: Apache-2.0
// Imports whose labels have the errors of trackers.
#include <filesystem>

#include <doctest/doctest.h>

#include "../support/hostile.hpp"
#include "comparison.hpp"
#include "corrections/labels.hpp"
#include "data/config.hpp"
#include "data/validate.hpp"
#include "importers/import_folder.hpp"
#include "sources.hpp"

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

} // namespace

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
    CHECK(test.gaze_deg < 1e-3);
    CHECK(test.pose_mm < 1e-6);
    CHECK(test.landmarks < 1e-6);
}

TEST_CASE("tracked: vhap's iris has the size that the pictures show") {
    const Tracked& t = Tracked::one();
    const TemporaryFolder folder;
    for (const TrueScene* scene : {&t.right, &t.wrong}) {
        const fs::path source = folder.path / (scene == &t.right ? "right" : "wrong");
        write_vhap_source(*scene, source);
        import_vhap(options(source, source / "out"));
        const Capture got = read_trainable_capture(source / "out");
        const CaptureEye &eye = got.frames[0].eyes[0], &is = t.right.capture.frames[0].eyes[0];
        CHECK(*eye.limbus_radius / *eye.radius ==
              doctest::Approx(*is.limbus_radius / *is.radius).epsilon(0.1));
    }
}

TEST_CASE("tracked: gazes from irises are read again where heads are corrected") {
    const Tracked& t = Tracked::one();
    const TemporaryFolder folder;
    write_gha_source(t.wrong, folder.path / "source", 0.1);
    import_gha(options(folder.path / "source", folder.path / "out"));
    Capture got = read_trainable_capture(folder.path / "out");
    const Comparison before = compare(t.right.capture, got, got.train);
    const LabelFindings found = correct_labels(got, preset("cpu"));
    const Comparison after = compare(t.right.capture, got, got.train);
    INFO(before.text());
    INFO(after.text());
    CHECK(found.gazes);
    CHECK(after.mean_gaze_deg < 0.75 * before.mean_gaze_deg);
    CHECK(after.mean_centres_mm < 0.6 * before.mean_centres_mm);
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
    CHECK(c.eye_overlap > 0.98);
    CHECK(compare(t.right.capture, tests, tests.train).gaze_deg ==
          compare(t.right.capture, import, import.train).gaze_deg);
    CHECK_FAULT(
        write_test_labels(t.right.capture, import, TestGazes::true_axes, folder.path / "tests"),
        "tests: exists already");
}
