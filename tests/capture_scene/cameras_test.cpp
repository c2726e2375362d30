// SPDX-License-Identifier: Apache-2.0
// Cameras of a rendered capture with errors put in, against the right ones: which are found to be
// wrong, and how near the head comes in their pictures to where it is.
#include "corrections/cameras.hpp"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <string>

#include <doctest/doctest.h>

#include <rye/math/rotation.hpp>

#include "corrections/camera_fit.hpp"
#include "corrections/point_equations.hpp"
#include "corrections/skin_positions.hpp"
#include "data/changed_labels.hpp"
#include "data/corrected_cameras.hpp"
#include "data/flaws.hpp"
#include "data/samples.hpp"
#include "data/threads.hpp"
#include "right_capture.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

const RightCapture& right() { return right_capture(); }

/// A copy with cameras that are half a degree an axis and 1 % of focal length off.
struct Flawed {
    TemporaryFolder folder;
    Capture capture;

    explicit Flawed(std::uint64_t seed, FlawedFrames frames = FlawedFrames::train,
                    bool gazes = false) {
        FlawOptions o;
        o.capture = right().path;
        o.out = folder.path / "flawed";
        o.seed = seed;
        o.labels = frames;
        o.sizes[Flaw::camera_rotation] = 0.5;
        o.sizes[Flaw::focal] = 1;
        if (gazes) {
            o.sizes[Flaw::gaze_common] = 4;
            o.sizes[Flaw::gaze_single] = 2;
            o.sizes[Flaw::centres] = 1.2;
        }
        write_flawed(o);
        capture = read_capture(o.out);
    }
};

/// Mean distance at which two captures' cameras of this index show the head's landmarks [px].
double apart(const Capture& a, const Capture& b, int camera, const std::vector<int>& frames) {
    double sum = 0, count = 0;
    for (const int f : frames) {
        const Columns<double> world = frame_landmarks(right().capture, f);
        for (Index l = 0; l < world.cols(); ++l) {
            const Vec3<double> x = world.col(l);
            sum += (a.camera(f, camera).project_point(x) - b.camera(f, camera).project_point(x))
                       .head<2>()
                       .norm();
            ++count;
        }
    }
    return sum / count;
}
double apart(const Capture& a, const Capture& b, const std::vector<int>& frames) {
    double sum = 0;
    for (int c = 0; c < a.camera_count(); ++c) sum += apart(a, b, c, frames);
    return sum / a.camera_count();
}

bool same_cameras(const Capture& a, const Capture& b) {
    bool same = a.views.size() == b.views.size();
    for (std::size_t v = 0; same && v < a.views.size(); ++v)
        same = same_numbers(a.views[v].camera, b.views[v].camera);
    return same;
}

} // namespace

TEST_CASE("cameras: right ones stay as they are, to the bit") {
    Capture c = read_capture(right().path);
    const CameraFindings found = correct_cameras(c, preset("cpu"));
    CHECK(found.not_judged.empty());
    REQUIRE(found.all.size() == 6);
    for (const CameraFinding& f : found.all) {
        CAPTURE(f.camera);
        MESSAGE("camera ", f.camera, ": ", f.off, " mm, ", f.pixels, " px, irises ", f.irises);
        CHECK(!f.wrong);
        CHECK(f.off < found.bound);
    }
    CHECK(c.corrected_cameras.empty());
    CHECK(same_cameras(c, right().capture));
    CHECK(found.lines().size() == 1);
}

TEST_CASE("cameras: wrong ones show the head where it is once they are corrected") {
    for (const bool gazes : {false, true}) {
        const Flawed flawed(gazes ? 2 : 1, FlawedFrames::train, gazes);
        Capture c = read_capture(flawed.capture.folder);
        const CameraFindings found = correct_cameras(c, preset("cpu"));
        const double before = apart(flawed.capture, right().capture, c.train),
                     after = apart(c, right().capture, c.train);
        MESSAGE("the head is shown ", before, " px off, then ", after,
                std::string(gazes ? ", with gazes off" : ""));
        CHECK(before > 5);
        CHECK(after < (gazes ? 0.8 : 0.4));
        CHECK(c.corrected_cameras.size() == found.lines().size() - 1);
        for (int k = 0; k < c.camera_count(); ++k) {
            const double was = apart(flawed.capture, right().capture, k, c.train),
                         is = apart(c, right().capture, k, c.train);
            CAPTURE(k);
            CAPTURE(was);
            CAPTURE(is);
            CHECK((is < was / 3 || is < 1.5));
        }
        for (const CameraFinding& f : found.all)
            if (f.wrong) CHECK(f.after < f.before);
        // Those of test frames have no error.
        CHECK(apart(c, right().capture, c.test) == 0);
        // Labels of frames stay.
        for (std::size_t f = 0; f < c.frames.size(); ++f)
            CHECK(c.frames[f].eyes[0].optical == flawed.capture.frames[f].eyes[0].optical);
    }
}

TEST_CASE("cameras: exact labels tell a zoom that all cameras share") {
    const Flawed flawed(3);
    Capture c = read_capture(flawed.capture.folder);
    for (const int f : c.train)
        for (int k = 0; k < c.camera_count(); ++k) {
            Pinhole<double>& camera =
                c.views[static_cast<std::size_t>(f * c.camera_count() + k)].camera;
            camera.fx *= 1.015;
            camera.fy *= 1.015;
        }
    // How much larger than the right ones cameras show the head, mean over them.
    const auto zoom = [&] {
        double sum = 0;
        for (int k = 0; k < c.camera_count(); ++k) {
            const auto size = [&](const Capture& of) {
                const Columns<double> world = frame_landmarks(right().capture, c.train[0]);
                Columns<double> at(2, world.cols());
                for (Index l = 0; l < world.cols(); ++l)
                    at.col(l) = of.camera(c.train[0], k)
                                    .project_point(Vec3<double>(world.col(l)))
                                    .head<2>();
                return (at.colwise() - at.rowwise().mean()).norm();
            };
            sum += std::log(size(c) / size(right().capture)) / c.camera_count();
        }
        return sum;
    };
    const double before = zoom();
    correct_cameras(c, preset("cpu"));
    MESSAGE("a zoom of ", 100 * before, " %, then ", 100 * zoom(), " %");
    CHECK(before > 0.01);
    CHECK(std::abs(zoom()) < before / 3); // most of it stays where priors alone decide
}

TEST_CASE("cameras: the skin shows where a displaced camera has the head") {
    const Capture& c = right().capture;
    const std::vector<std::size_t> all{0, 1, 2, 3, 4, 5};
    const SkinPositions skin(c, c.train, all,
                             describe_subject(c, preset("cpu")).head_centre);
    REQUIRE(skin.landmarks().cols() == 10 * static_cast<Index>(c.train.size()));
    std::vector<Pinhole<double>> is, truth;
    for (int k = 0; k < 6; ++k) truth.push_back(c.camera(c.train[0], k));
    is = truth;
    CameraChange by;
    by.turn = Vec3<double>(0.0012, -0.0009, 0.002);
    constexpr int wrong = 2;
    is[wrong] = changed(is[wrong], by);
    double before = 0, after = 0, others = 0;
    int mine = 0, rest = 0;
    for (const SeenPoint& s : skin.seen(is)) {
        const Vec3<double> x = skin.landmarks().col(s.point);
        const auto k = static_cast<std::size_t>(s.camera);
        const Vec2<double> should = truth[k].project_point(x).head<2>();
        if (s.camera == wrong) {
            before += (is[k].project_point(x).head<2>() - should).norm();
            after += (s.at - should).norm();
            ++mine;
        } else {
            others += (s.at - should).norm();
            ++rest;
        }
    }
    REQUIRE(mine > 0);
    REQUIRE(rest > 0);
    MESSAGE("shown ", before / mine, " px off, seen ", after / mine, "; others ", others / rest);
    CHECK(before / mine > 0.8);
    CHECK(after / mine < 0.4 * before / mine);
    CHECK(others / rest < 0.6);
}

TEST_CASE("cameras: the skin of a displaced camera looks less like that of the others") {
    const Capture& c = right().capture;
    const std::vector<std::size_t> all{0, 1, 2, 3, 4, 5};
    const SkinPositions skin(c, c.train, all, describe_subject(c, preset("cpu")).head_centre);
    std::vector<Pinhole<double>> truth;
    for (int k = 0; k < 6; ++k) truth.push_back(c.camera(c.train[0], k));
    const std::vector<double> before = skin.differences(truth);
    CameraChange by;
    by.turn = Vec3<double>(0.008, -0.006, 0); // some pixels
    for (std::size_t k = 0; k < all.size(); ++k) {
        CAPTURE(k);
        CHECK(before[k] > 0);
        std::vector<Pinhole<double>> is = truth;
        is[k] = changed(is[k], by);
        CHECK(skin.differences(is)[k] > 1.15 * before[k]);
    }
}

TEST_CASE("cameras: stage 2 goes on where some were wrong; what it finds joins the corrections") {
    const Capture& c = right().capture;
    TrainConfig config = preset("cpu");
    CameraFindings findings;
    findings.all.resize(2);
    CHECK(refine_further(findings, c, config) == "");
    CHECK(config.gaussians.rates.delta_view == 0);
    findings.all[1].wrong = true;
    CHECK(refine_further(findings, c, config) == "stage 2 goes on refining the poses of cameras");
    const AvatarRates& rates = config.gaussians.rates;
    CHECK(rates.delta_view > 0);
    CHECK(rates.delta_view_from == 3 * config.gaussians.steps / 10);
    TrainConfig own = preset("cpu");
    own.gaussians.rates.delta_view = 1e-12; // keeps them
    CHECK(refine_further(findings, c, own) == "");
    CHECK(own.gaussians.rates.delta_view == 1e-12);

    const Flawed flawed(1);
    Capture corrected = read_capture(flawed.capture.folder);
    correct_cameras(corrected, preset("cpu"));
    const std::vector<CorrectedCamera>& before = corrected.corrected_cameras;
    REQUIRE(!before.empty());
    CHECK(trained_cameras(corrected, {}).size() == before.size());
    const int cameras = corrected.camera_count();
    Columns<float> delta_view = Columns<float>::Zero(6, cameras);
    delta_view.col(1) << 0.01F, -0.02F, 0.005F, 0.02F, 0.01F, -0.03F;
    const std::vector<CorrectedCamera> after = trained_cameras(corrected, delta_view);
    CHECK(after.size() == static_cast<std::size_t>(cameras));
    Capture again = read_capture(flawed.capture.folder); // the capture's own numbers lead to them
    CHECK(take_corrected(again, after) == cameras);
    const int f = corrected.train.front();
    const Vec3<double> head = mean_head(corrected), x = head + Vec3<double>(0.3, 0.4, 0.2);
    for (int k = 0; k < cameras; ++k) {
        CAPTURE(k);
        const Vec<double, 6> by = delta_view.col(k).cast<double>();
        const Vec3<double> moved = so3_exp(Vec3<double>(by.head<3>())) * (x - head) + head +
                                   by.tail<3>();
        const Vec2<double> should = corrected.camera(f, k).project_point(moved).head<2>();
        CHECK((again.camera(f, k).project_point(x).head<2>() - should).norm() < 1e-3);
    }
}

TEST_CASE("cameras: the number of threads changes no bit, and test frames share a calibration") {
    const Flawed flawed(1, FlawedFrames::all);
    Capture one = read_capture(flawed.capture.folder), more = read_capture(flawed.capture.folder);
    set_threads(1);
    const CameraFindings found = correct_cameras(one, preset("cpu"));
    set_threads(3);
    CHECK(correct_cameras(more, preset("cpu")).lines() == found.lines());
    set_threads(0);
    CHECK(same_cameras(one, more));
    CHECK(apart(flawed.capture, right().capture, one.test) > 5);
    CHECK(apart(one, right().capture, one.test) < 1);
}

TEST_CASE("cameras: what is not seen, too few frames and moving cameras change nothing") {
    const Flawed flawed(1);
    const int hidden = 2, moving = 4;
    Capture c = read_capture(flawed.capture.folder);
    for (std::size_t i = 2; i < c.train.size(); ++i)
        c.views[static_cast<std::size_t>(c.train[i] * c.camera_count() + hidden)].present = false;
    c.views[static_cast<std::size_t>(c.train[3] * c.camera_count() + moving)].camera.fx += 1;
    const CameraFindings found = correct_cameras(c, preset("cpu"));
    REQUIRE(found.not_judged.size() == 2);
    CHECK(found.not_judged[0] == "camera " + c.camera_ids[moving] +
                                     ": its numbers differ between training frames");
    CHECK(found.not_judged[1] == "camera " + c.camera_ids[hidden] +
                                     ": its pictures show 4 eyes, 6 are needed");
    CHECK(found.all.size() == 4);
    CHECK(!c.corrected_cameras.empty());
    for (const int k : {hidden, moving})
        CHECK(same_numbers(c.camera(c.train[0], k), flawed.capture.camera(c.train[0], k)));

    Capture few = read_capture(flawed.capture.folder);
    few.train.resize(5);
    CHECK(correct_cameras(few, preset("cpu")).lines() ==
          std::vector<std::string>{
              "cameras: 5 training frames say too little about them, 6 are needed"});
    CHECK(same_cameras(few, flawed.capture));

    Capture blind = read_capture(flawed.capture.folder);
    blind.has_eye_masks = false;
    REQUIRE(correct_cameras(blind, preset("cpu")).not_judged.size() == 1);
    CHECK(same_cameras(blind, flawed.capture));
}

TEST_CASE("cameras: eyes that all cameras show elsewhere in the head alike are labels' errors") {
    Capture c = read_capture(right().path);
    for (CaptureFrame& f : c.frames) {
        const Vec3<double> off =
            so3_exp(Vec3<double>(f.pose.head<3>())) * Vec3<double>(0.04, 0.03, 0);
        for (CaptureEye& eye : f.eyes) eye.centre = *eye.centre + off;
        for (int e = 0; e < 2; ++e)
            for (const int l : eye_landmarks(e)) f.landmarks.col(l) += off;
    }
    const CameraFindings found = correct_cameras(c, preset("cpu"));
    REQUIRE(found.not_judged.size() == 1);
    CHECK(found.not_judged[0].starts_with("cameras: all of them show the eyes"));
    for (const CameraFinding& f : found.all) CHECK(!f.wrong);
    CHECK(c.corrected_cameras.empty());
    CHECK(same_cameras(c, right().capture));
}

TEST_CASE("cameras: those of a run are taken where a capture has exactly the wrong numbers") {
    const Flawed flawed(1);
    Capture c = read_capture(flawed.capture.folder);
    correct_cameras(c, preset("cpu"));
    REQUIRE(!c.corrected_cameras.empty());
    const TemporaryFolder run;
    save_corrected_cameras(run.path, c.corrected_cameras);
    const std::vector<CorrectedCamera> kept = load_corrected_cameras(run.path);

    Capture again = read_capture(flawed.capture.folder), clean = read_capture(right().path);
    CHECK(take_corrected(again, kept) == static_cast<int>(c.corrected_cameras.size()));
    CHECK(same_cameras(again, c));
    CHECK(again.corrected_cameras.size() == c.corrected_cameras.size());
    CHECK(take_corrected(clean, kept) == 0);
    CHECK(same_cameras(clean, right().capture));

    // A copy of the capture with these, on disk.
    const fs::path out = run.path / "out";
    write_changed_capture(flawed.capture.folder, out, {}, HeadPoints::kept, {{}, kept});
    CHECK(same_cameras(read_capture(out), c));

    const fs::path file = corrected_cameras_path(run.path);
    std::ofstream(file) << R"({"cameras": [{"camera": "05", "wrong": {"intrinsic": [1, 2]}}]})";
    CHECK_FAULT(load_corrected_cameras(run.path), "camera 05: right");
    std::ofstream(file) << R"({"cameras": [{"camera": "05", "wrong": {"intrinsic": [1, 2]},)"
                        << R"( "right": {}}]})";
    CHECK_FAULT(load_corrected_cameras(run.path), "camera 05: wrong: intrinsic");
    save_corrected_cameras(run.path, {});
    CHECK(!fs::exists(file));
    CHECK(load_corrected_cameras(run.path).empty());
}

TEST_CASE("cameras: points that pictures show displaced turn, shift and scale a camera") {
    const Vec3<double> middle(0, 0, 0), up(0, 1, 0);
    std::vector<Pinhole<double>> is, truth;
    CameraChange by;
    by.turn = Vec3<double>(0.006, -0.004, 0.003);
    by.log_focal = 0.006;
    for (const double x : {-4.0, 0.0, 4.0, 8.0}) {
        is.push_back(look_at(Vec3<double>(x, 1, 9), middle, up, 0.3, {256, 256}));
        truth.push_back(x == 4 ? changed(is.back(), by) : is.back());
    }
    Columns<double> points(3, 40);
    for (int p = 0; p < 40; ++p)
        points.col(p) = Vec3<double>(0.4 * (p % 5) - 0.8, 0.5 * (p / 20) - 0.2, 0.1 * (p % 7));
    std::vector<SeenPoint> seen;
    for (int c = 0; c < 3; ++c) // the last sees none
        for (int p = 0; p < static_cast<int>(points.cols()); ++p) {
            Vec2<double> at = truth[static_cast<std::size_t>(c)]
                                  .project_point(Vec3<double>(points.col(p)))
                                  .head<2>();
            if (p % 10 == c) at += (p % 20 == c ? 1 : -1) * Vec2<double>(20, -15); // no iris
            seen.push_back({c, p, at, 0.3});
        }
    const CameraFit fit = fit_cameras(is, points, seen);
    REQUIRE(fit.changes.size() == 4);
    CHECK(fit.changes[3].turn.norm() == 0);
    CHECK(fit.changes[3].log_focal == 0);
    for (std::size_t c = 0; c < 3; ++c) {
        const Pinhole<double> found = changed(is[c], fit.changes[c]);
        for (Index p = 0; p < points.cols(); ++p) {
            const Vec3<double> x = points.col(p);
            CHECK((found.project_point(x) - truth[c].project_point(x)).head<2>().norm() < 0.3);
        }
    }
}

TEST_CASE("point equations: steps and products are those of the whole matrix") {
    for (const Index shared : {0, 9}) {
        CAPTURE(shared);
        constexpr Index points = 5;
        VecX<double> x(shared + 3 * points);
        for (Index i = 0; i < x.size(); ++i) x[i] = std::sin(1.7 * double(i));
        PointEquations e(x, shared);
        NormalEquations<double> whole{x.squaredNorm(), Columns<double>::Identity(x.size(), x.size()),
                                      x};
        for (Index r = 0; r < 60; ++r) { // residuals of a point and a third of the shared unknowns
            const Index p = r % points, s = shared == 0 ? 0 : 3 * (r % 3);
            VecX<double> j = VecX<double>::Zero(x.size());
            for (Index i = 0; i < 3; ++i) {
                j[shared + 3 * p + i] = std::cos(double(r) + 2.1 * double(i));
                if (shared > 0) j[s + i] = std::sin(1.3 * double(r) + double(i));
            }
            const double residual = std::cos(0.7 * double(r));
            whole.matrix += j * j.transpose();
            whole.gradient += residual * j;
            const Vec3<double> own = j.segment<3>(shared + 3 * p);
            e.points[static_cast<std::size_t>(p)] += own * own.transpose();
            e.shared += j.head(shared) * j.head(shared).transpose();
            e.tied.middleCols<3>(3 * p) += j.head(shared) * own.transpose();
            e.gradient += residual * j;
        }
        CHECK(e.finite());
        for (const double damping : {0.0, 0.5}) {
            VecX<double> d, wanted;
            REQUIRE(e.step(damping, d));
            REQUIRE(whole.step(damping, wanted));
            CHECK((d - wanted).norm() <= 1e-12 * wanted.norm());
            CHECK((e.times(d) - whole.times(d)).norm() <= 1e-12 * whole.times(d).norm());
        }
        e.points[2] *= -1;
        VecX<double> d;
        CHECK_FALSE(e.step(0, d));
        e.points[2](0, 0) = std::numeric_limits<double>::quiet_NaN();
        CHECK_FALSE(e.finite());
    }
}
