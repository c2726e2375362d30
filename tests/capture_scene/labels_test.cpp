// SPDX-License-Identifier: Apache-2.0
// Labels of a rendered capture with errors put in, against the right ones: what is found to be
// wrong, and how much nearer it comes.
#include "corrections/labels.hpp"

#include <cmath>
#include <filesystem>

#include <doctest/doctest.h>

#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "corrections/camera_colours.hpp"
#include "corrections/gaze_estimator.hpp"
#include "data/flaws.hpp"
#include "data/samples.hpp"
#include "right_capture.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

constexpr double degree = 3.14159265358979323846 / 180;

const RightCapture& right() {
    static const RightCapture made(10);
    return made;
}

/// A copy with errors of training frames. The pictures are where the folder is.
struct Flawed {
    TemporaryFolder folder;
    Capture capture;

    template <class Set>
    explicit Flawed(const Set& set, std::uint64_t seed = 0) {
        FlawOptions o;
        o.capture = right().path;
        o.out = folder.path / "flawed";
        o.seed = seed;
        set(o.sizes);
        write_flawed(o);
        capture = read_capture(o.out);
    }
};

/// The one of a label that begins so.
const LabelFinding& finding(const LabelFindings& all, const std::string& label,
                            const std::string& unit) {
    for (const LabelFinding& f : all.all)
        if (f.label.starts_with(label) && f.unit == unit) return f;
    FAIL("no finding about ", label, " in ", unit);
    return all.all.front();
}

/// To the bit.
bool same(const CaptureEye& a, const CaptureEye& b) {
    return a.optical == b.optical && a.optical_world == b.optical_world && a.visual == b.visual &&
           a.centre == b.centre && a.kappa == b.kappa && a.radius == b.radius &&
           a.limbus_radius == b.limbus_radius && a.iris_plane == b.iris_plane;
}
bool same(const CaptureFrame& a, const CaptureFrame& b) {
    return a.expression == b.expression && a.pose == b.pose && a.scale == b.scale &&
           a.landmarks == b.landmarks && a.vertices == b.vertices && same(a.eyes[0], b.eyes[0]) &&
           same(a.eyes[1], b.eyes[1]);
}
bool same(const std::vector<CaptureFrame>& a, const std::vector<CaptureFrame>& b) {
    if (a.size() != b.size()) return false;
    for (std::size_t f = 0; f < a.size(); ++f)
        if (!same(a[f], b[f])) return false;
    return true;
}

/// Whether a picture of the frame shows enough of the eye.
bool is_seen(int f, std::size_t e) {
    for (int c = 0; c < right().capture.camera_count(); ++c) {
        const Image<float> eyes = right().capture.eye_mask(f, c);
        const Columns<float> eye = eyes.pixels.row(static_cast<Index>(e));
        if (usable_eye_pixels(eye, eyes.width) >= 80) return true;
    }
    return false;
}

/// Root mean square of the angles by which gazes of training frames are off, of eyes that are seen
/// and of all [degrees].
struct GazeErrors {
    double seen = 0, all = 0;
    int seen_eyes = 0;

    explicit GazeErrors(const Capture& c) {
        for (const int f : c.train)
            for (std::size_t e = 0; e < 2; ++e) {
                const Vec3<double> is = c.frames[static_cast<std::size_t>(f)].eyes[e].optical;
                const double off = angular_error(is, right().frame(f).eyes[e].optical) / degree;
                all += off * off / (2 * static_cast<double>(c.train.size()));
                if (!is_seen(f, e)) continue;
                seen += off * off;
                ++seen_eyes;
            }
        seen = std::sqrt(seen / seen_eyes);
        all = std::sqrt(all);
    }
};

/// Root mean squares of what head poses of training frames are off by, without what is common to
/// all of them: [degrees] and [mm].
struct PoseErrors {
    double turn = 0, shift = 0;

    explicit PoseErrors(const Capture& c) {
        const auto n = static_cast<double>(c.train.size());
        std::vector<Vec3<double>> turns, shifts;
        Vec3<double> mean_turn = Vec3<double>::Zero(), mean_shift = Vec3<double>::Zero();
        for (const int f : c.train) {
            const Vec<double, 6>&is = c.frames[static_cast<std::size_t>(f)].pose,
                  &truth = right().frame(f).pose;
            const Mat3<double> back = so3_exp(Vec3<double>(truth.head<3>())).transpose();
            turns.push_back(so3_log(Mat3<double>(back * so3_exp(Vec3<double>(is.head<3>())))));
            shifts.push_back(back * (is - truth).tail<3>());
            mean_turn += turns.back() / n;
            mean_shift += shifts.back() / n;
        }
        for (std::size_t i = 0; i < turns.size(); ++i) {
            turn += (turns[i] - mean_turn).squaredNorm() / n;
            shift += (shifts[i] - mean_shift).squaredNorm() / n;
        }
        turn = std::sqrt(turn) / degree;
        shift = 100 * std::sqrt(shift);
    }
};

/// Root mean square of a coordinate by which landmarks and eyeball centres of training frames are
/// off in the world [mm].
struct PointErrors {
    double landmarks = 0, centres = 0;

    explicit PointErrors(const Capture& c) {
        const auto n = static_cast<double>(c.train.size());
        for (const int f : c.train) {
            const CaptureFrame& is = c.frames[static_cast<std::size_t>(f)];
            const Columns<double> off =
                frame_landmarks(c, f) - frame_landmarks(right().capture, f);
            landmarks += off.squaredNorm() / (static_cast<double>(off.size()) * n);
            for (std::size_t e = 0; e < 2; ++e)
                centres += (*is.eyes[e].centre - *right().frame(f).eyes[e].centre).squaredNorm() /
                           (6 * n);
        }
        landmarks = 100 * std::sqrt(landmarks);
        centres = 100 * std::sqrt(centres);
    }
};

/// Root mean square by which expression coefficients of training frames are off.
struct ExpressionErrors {
    double rms = 0;

    explicit ExpressionErrors(const Capture& c) {
        const double n = static_cast<double>(c.train.size()) * c.expression_width();
        for (const int f : c.train)
            for (std::size_t e = 0; e < static_cast<std::size_t>(c.expression_width()); ++e) {
                const auto is = static_cast<double>(
                    c.frames[static_cast<std::size_t>(f)].expression[e]);
                rms += std::pow(is - static_cast<double>(right().frame(f).expression[e]), 2) / n;
            }
        rms = std::sqrt(rms);
    }
};

/// Returns how far the sparse landmarks around the eyes rise by the pitch of their eye, mean of the
/// landmarks of lids [unit / rad].
double lids_follow(const Capture& c) {
    double sum = 0, all = 0;
    for (int eye = 0; eye < 2; ++eye)
        for (const int l : eye_landmarks(eye)) {
            VecX<double> pitch(static_cast<Index>(c.train.size())), height = pitch;
            for (std::size_t i = 0; i < c.train.size(); ++i) {
                // By right poses, so that those are not measured.
                const CaptureFrame& truth = right().frame(c.train[i]);
                pitch[static_cast<Index>(i)] =
                    pitch_yaw(truth.eyes[static_cast<std::size_t>(eye)].optical)[0];
                height[static_cast<Index>(i)] =
                    to_canonical(truth, frame_landmarks(c, c.train[i]))(1, l);
            }
            pitch.array() -= pitch.mean();
            sum += pitch.dot(height) / pitch.squaredNorm();
            ++all;
        }
    return sum / all;
}

/// Displacements of landmarks by a blink of 1 in the head's frame, 3 x L: 8 mm down at those around
/// the eyes, less farther away.
Columns<double> blink_of(const Columns<double>& landmarks) {
    Columns<double> moved = Columns<double>::Zero(3, landmarks.cols());
    for (Index l = 0; l < landmarks.cols(); ++l)
        for (int eye = 0; eye < 2; ++eye)
            for (const int lid : eye_landmarks(eye)) {
                const double far2 = (landmarks.col(l) - landmarks.col(lid)).squaredNorm();
                moved(1, l) = std::min(moved(1, l), -0.08 * std::exp(-far2 / 0.005));
            }
    return moved;
}

/// Closes the eyes in some of the training frames, by labels alone.
void close_eyes(Capture& c) {
    for (std::size_t k = 0; k < c.expression_names.size(); ++k)
        if (c.expression_names[k].starts_with("eyeBlink"))
            for (const int f : c.train) c.frames[static_cast<std::size_t>(f)].expression[k] = 0;
    for (const auto& [i, blink] : {std::pair(1, 0.9F), std::pair(4, 0.6F), std::pair(6, 0.4F)}) {
        CaptureFrame& f = c.frames[static_cast<std::size_t>(c.train[static_cast<std::size_t>(i)])];
        for (std::size_t k = 0; k < c.expression_names.size(); ++k)
            if (c.expression_names[k].starts_with("eyeBlink")) f.expression[k] = blink;
        const Columns<double> open = frame_landmarks(c, c.train[static_cast<std::size_t>(i)]),
                              in_head = blink_of(to_canonical(f, open));
        const Mat3<double> turn = so3_exp(Vec3<double>(f.pose.head<3>()));
        set_frame_landmarks(f, open + static_cast<double>(blink) * f.scale * (turn * in_head));
    }
}

/// Returns the share of close_eyes() that is left in the frame where eyes close most: in its
/// difference from the mean of the training frames, beside that of right landmarks.
double lids_close(const Capture& c) {
    const auto in_head = [](const Capture& of, int f) { // by right poses
        return to_canonical(right().frame(f), frame_landmarks(of, f));
    };
    const int closed = c.train[1];
    const Columns<double> whole = blink_of(in_head(right().capture, closed));
    Columns<double> off = in_head(c, closed) - in_head(right().capture, closed);
    for (const int f : c.train)
        off -= (in_head(c, f) - in_head(right().capture, f)) / static_cast<double>(c.train.size());
    const double left = (off.array() * whole.array()).sum() / whole.squaredNorm();
    return left / (0.9 - (0.9 + 0.6 + 0.4) / static_cast<double>(c.train.size()));
}

/// Test frames keep their labels, whatever those of training frames are.
void check_tests_kept(const Capture& before, const Capture& after) {
    REQUIRE(!before.test.empty());
    for (const int f : before.test) {
        const auto at = static_cast<std::size_t>(f);
        CHECK(same(before.frames[at], after.frames[at]));
    }
}

} // namespace

TEST_CASE("labels: right ones are found right and stay as they are, to the bit") {
    Capture c = read_capture(right().path);
    const LabelFindings found = correct_labels(c, preset("cpu"));
    for (const LabelFinding& f : found.all) {
        CAPTURE(f.label);
        CAPTURE(f.off);
        CHECK(!f.wrong);
        CHECK(f.off <= f.bound);
    }
    CHECK(found.not_judged.empty());
    CHECK(found.all.size() == 8);
    CHECK(!found.poses);
    CHECK(!found.gazes);
    CHECK(same(c.frames, right().capture.frames));
    TrainConfig config = preset("cpu");
    CHECK(refine_further(found, config).empty());
    CHECK(config.gaussians.rates.delta_gaze == preset("cpu").gaussians.rates.delta_gaze);
    CHECK(config.gaussians.rates.delta_pose == preset("cpu").gaussians.rates.delta_pose);
}

TEST_CASE("labels: gazes come back from the irises") {
    for (const std::uint64_t seed : {0, 1}) {
        const Flawed flawed(
            [](FlawSizes& s) {
                s[Flaw::gaze_common] = 4;
                s[Flaw::gaze_single] = 2;
            },
            seed);
        Capture c = read_capture(flawed.capture.folder);
        const LabelFindings found = correct_labels(c, preset("cpu"));
        const GazeErrors before(flawed.capture), after(c);
        CAPTURE(seed);
        CAPTURE(before.all);
        CAPTURE(after.all);
        MESSAGE("gazes of ", before.seen_eyes, " eyes: ", before.seen, " deg, then ", after.seen);
        CHECK(before.seen_eyes >= 15);
        CHECK(found.gazes);
        CHECK(!found.poses);
        CHECK(finding(found, "gazes", "deg").off ==
              doctest::Approx(before.all / std::sqrt(2.0)).epsilon(0.35));
        CHECK(3 * after.seen < before.seen);
        CHECK(2 * after.all < before.all);
        check_tests_kept(flawed.capture, c);
        // Lines of sight turn alike, and gazes in the world are those in the head.
        for (const int f : c.train) {
            const CaptureFrame& is = c.frames[static_cast<std::size_t>(f)];
            CHECK(is.pose == right().frame(f).pose);
            for (std::size_t e = 0; e < 2; ++e) {
                const CaptureEye &eye = is.eyes[e],
                                 &was = flawed.capture.frames[static_cast<std::size_t>(f)].eyes[e];
                CHECK(eye.optical.norm() == doctest::Approx(1));
                CHECK(eye.centre == was.centre);
                const Vec2<double> by = pitch_yaw(eye.optical) - pitch_yaw(was.optical);
                REQUIRE(eye.visual);
                CHECK((pitch_yaw(*eye.visual) - pitch_yaw(*was.visual) - by).norm() < 1e-9);
                if (!eye.optical_world) continue;
                const Vec3<double> world =
                    so3_exp(Vec3<double>(is.pose.head<3>())) * eye.optical;
                CHECK((*eye.optical_world - world).norm() < 1e-9);
            }
        }
        TrainConfig config = preset("cpu");
        if (config.gaze_mechanism == GazeMechanismName::rotation) {
            CHECK(refine_further(found, config) ==
                  "stage 2 goes on refining the gazes of training frames");
            CHECK(config.gaussians.rates.delta_gaze > 0);
        }
    }
}

/// Takes the eyeballs' centres and sizes off the labels.
void forget_eyeballs(Capture& c) {
    for (CaptureFrame& f : c.frames) {
        f.has_centres = false;
        for (CaptureEye& e : f.eyes)
            e.centre.reset(), e.radius.reset(), e.limbus_radius.reset(), e.iris_plane.reset();
    }
}

TEST_CASE("labels: eyeballs that nobody measured are placed by the irises, and gazes come back") {
    const Flawed flawed([](FlawSizes& s) {
        s[Flaw::gaze_common] = 4;
        s[Flaw::gaze_single] = 2;
    });
    for (const fs::path& folder : {flawed.capture.folder, right().path}) {
        const bool wrong = folder != right().path;
        CAPTURE(wrong);
        Capture before = read_capture(folder);
        forget_eyeballs(before);
        const Subject assumed = describe_subject(before, preset("tiny"));
        Capture c = read_capture(folder);
        forget_eyeballs(c);
        const LabelFindings found = correct_labels(c, preset("cpu"));
        CHECK(finding(found, "eyeballs", "mm").wrong);
        CHECK(c.has_centres());
        const CaptureFrame& truth = right().frame(c.train[0]);
        for (std::size_t e = 0; e < 2; ++e) {
            const Vec3<double> at = to_canonical(truth, *truth.eyes[e].centre);
            const double was = 100 * (assumed.eye_centre[e] - at).norm(),
                         off = 100 * (to_canonical(truth, *c.frame(c.train[0]).eyes[e].centre) - at)
                                         .norm();
            MESSAGE("eyeball ", e, ": ", was, " mm off, then ", off, "; irises at ",
                    *c.frame(c.train[0]).eyes[e].iris_plane, " of ", *truth.eyes[e].iris_plane);
            CHECK(off < 1.5);
            CHECK(*c.frame(c.train[0]).eyes[e].iris_plane ==
                  doctest::Approx(*truth.eyes[e].iris_plane).epsilon(0.12));
        }
        // All frames have the same eyeballs, fixed in their heads; test frames keep the rest.
        for (int f = 0; f < c.frame_count(); ++f)
            for (std::size_t e = 0; e < 2; ++e)
                CHECK((to_canonical(c.frame(f), *c.frame(f).eyes[e].centre) -
                       to_canonical(c.frame(0), *c.frame(0).eyes[e].centre))
                          .norm() < 1e-9);
        for (const int f : c.test)
            for (std::size_t e = 0; e < 2; ++e)
                CHECK(c.frame(f).eyes[e].optical == before.frame(f).eyes[e].optical);
        const GazeErrors first(before), after(c);
        MESSAGE("gazes: ", first.seen, " deg, then ", after.seen);
        CHECK(found.gazes == wrong);
        if (wrong) CHECK(2 * after.seen < first.seen);
        else CHECK(after.seen == 0);
    }
}

TEST_CASE("labels: eyeballs are not placed where one camera, or none, shows the irises") {
    Capture c = read_capture(right().path);
    forget_eyeballs(c);
    for (int f = 0; f < c.frame_count(); ++f)
        for (int k = 1; k < c.camera_count(); ++k)
            c.views[static_cast<std::size_t>(f * c.camera_count() + k)].present = false;
    const LabelFindings found = correct_labels(c, preset("cpu"));
    CHECK(!found.not_judged.empty());
    CHECK(found.not_judged.back().starts_with("gazes and eyeball centres: the capture has no"));
    CHECK(!c.has_centres());
    CHECK(!found.gazes);
}

TEST_CASE("labels: head poses and landmarks come nearer by those of all frames") {
    const Flawed flawed([](FlawSizes& s) {
        s[Flaw::pose_rotation] = 0.6;
        s[Flaw::pose_position] = 1;
        s[Flaw::landmarks] = 1.5;
    });
    Capture c = read_capture(flawed.capture.folder);
    const LabelFindings found = correct_labels(c, preset("cpu"));
    const PoseErrors before(flawed.capture), after(c);
    const PointErrors points_before(flawed.capture), points_after(c);
    MESSAGE("head poses: ", before.turn, " deg, then ", after.turn, "; ", before.shift,
            " mm, then ", after.shift, "; landmarks ", points_before.landmarks, " mm, then ",
            points_after.landmarks);
    CHECK(found.poses);
    CHECK(!found.gazes);
    CHECK(finding(found, "head poses", "deg").off == doctest::Approx(before.turn).epsilon(0.3));
    CHECK(finding(found, "landmarks", "mm").wrong);
    CHECK(finding(found, "landmarks", "mm").off == doctest::Approx(1.5).epsilon(0.2));
    CHECK(2 * after.turn < before.turn);
    CHECK(2 * after.shift < before.shift);
    CHECK(1.5 * points_after.landmarks < points_before.landmarks);
    check_tests_kept(flawed.capture, c);
    // Twice the same bits.
    Capture again = read_capture(flawed.capture.folder);
    CHECK(correct_labels(again, preset("cpu")).lines() == found.lines());
    CHECK(same(c.frames, again.frames));
}

TEST_CASE("labels: lids follow gazes where noise is taken from landmarks") {
    const double truth = lids_follow(right().capture);
    double after = 0;
    for (const std::uint64_t seed : {1, 2, 3}) {
        const Flawed flawed([](FlawSizes& s) { s[Flaw::landmarks] = 1.5; }, seed);
        Capture c = read_capture(flawed.capture.folder);
        CHECK(finding(correct_labels(c, preset("cpu")), "landmarks", "mm").wrong);
        after += lids_follow(c) / 3;
    }
    MESSAGE("lids rise by ", 100 * truth, " mm a radian, where smoothed by ", 100 * after);
    CHECK(truth > 0.01);
    CHECK(after > 0.6 * truth);
    CHECK(after < 1.4 * truth);
}

TEST_CASE("labels: lids close where noise is taken from landmarks of unknown shapes") {
    double after = 0;
    for (const std::uint64_t seed : {1, 2, 3}) {
        const Flawed flawed([](FlawSizes& s) { s[Flaw::landmarks] = 1.5; }, seed);
        fs::remove(flawed.capture.folder / "expression_shapes.npz");
        Capture c = read_capture(flawed.capture.folder);
        close_eyes(c);
        CHECK(finding(correct_labels(c, preset("cpu")), "landmarks", "mm").wrong);
        after += lids_close(c) / 3;
    }
    MESSAGE("share of a blink that is left: ", after);
    CHECK(after > 0.8);
    CHECK(after < 1.2);
}

TEST_CASE("labels: expressions come nearer by the face model's shapes") {
    const Flawed flawed([](FlawSizes& s) {
        s[Flaw::expression] = 0.1;
        s[Flaw::pose_rotation] = 0.6;
        s[Flaw::landmarks] = 0.5;
    });
    REQUIRE(fs::exists(flawed.capture.folder / "expression_shapes.npz"));
    Capture c = read_capture(flawed.capture.folder);
    const LabelFindings found = correct_labels(c, preset("cpu"));
    const ExpressionErrors before(flawed.capture), after(c);
    const PoseErrors turned(c);
    MESSAGE("expressions: ", before.rms, ", then ", after.rms, "; head poses then ", turned.turn,
            " deg");
    CHECK(finding(found, "expressions", "mm").wrong);
    CHECK(1.3 * after.rms < before.rms);
    CHECK(turned.turn < 0.2);
    check_tests_kept(flawed.capture, c);
    // Without the shapes they are not judged.
    fs::remove(flawed.capture.folder / "expression_shapes.npz");
    Capture without = read_capture(flawed.capture.folder);
    for (const LabelFinding& f : correct_labels(without, preset("cpu")).all)
        CHECK(!f.label.starts_with("expressions"));
    CHECK(ExpressionErrors(without).rms == before.rms);
}

TEST_CASE("labels: eyeballs that only seem to move are held where irises agree better") {
    const Flawed flawed([](FlawSizes& s) { s[Flaw::centres] = 1.5; });
    Capture c = read_capture(flawed.capture.folder);
    const LabelFindings found = correct_labels(c, preset("cpu"));
    const PointErrors before(flawed.capture), after(c);
    MESSAGE("eyeball centres: ", before.centres, " mm, then ", after.centres);
    CHECK(finding(found, "eyeball centres", "mm").wrong);
    CHECK(2 * after.centres < before.centres);
    CHECK(!found.poses);
    check_tests_kept(flawed.capture, c);
    // Gazes were right: what is left of the centres' errors does not spoil them.
    CHECK(GazeErrors(c).all < 1);
}

TEST_CASE("labels: too few frames, or no picture of an eye, are no reason to change anything") {
    const Flawed flawed([](FlawSizes& s) {
        s[Flaw::gaze_common] = 4;
        s[Flaw::pose_rotation] = 0.6;
        s[Flaw::pose_position] = 1;
    });
    Capture few = read_capture(flawed.capture.folder);
    few.train.resize(5);
    LabelFindings found = correct_labels(few, preset("cpu"));
    REQUIRE(found.not_judged.size() == 1);
    CHECK(found.not_judged[0].find("5 training frames") != std::string::npos);
    CHECK(found.not_judged[0].find("6 are needed") != std::string::npos);
    CHECK(found.all.empty());
    CHECK(found.lines() == found.not_judged);
    CHECK(found.json().at("not_judged").size() == 1);
    CHECK(same(few.frames, flawed.capture.frames));

    Capture blind = read_capture(flawed.capture.folder);
    blind.has_eye_masks = false;
    found = correct_labels(blind, preset("cpu"));
    REQUIRE(found.not_judged.size() == 1);
    CHECK(found.not_judged[0].find("eye masks") != std::string::npos);
    CHECK(found.poses);
    CHECK(!found.gazes);
    for (std::size_t f = 0; f < blind.frames.size(); ++f)
        for (std::size_t e = 0; e < 2; ++e) {
            const CaptureEye &is = blind.frames[f].eyes[e], &was = flawed.capture.frames[f].eyes[e];
            CHECK(is.optical == was.optical);
            CHECK(is.centre == was.centre);
        }
}

namespace {

/// By how much cameras differ in the light that they show of what they show in the right capture:
/// deviation of its logarithm over cameras and channels, their mean over cameras taken off, which
/// no capture tells.
double colours_apart(const Capture& c) {
    Columns<double> apart(3, c.camera_count());
    for (int k = 0; k < c.camera_count(); ++k) {
        Vec3<double> here = Vec3<double>::Zero(), there = here;
        const auto light = [](const Image<float>& picture) {
            const Columns<double> all = picture.pixels.cast<double>().unaryExpr(&linear_from_srgb);
            return Vec3<double>(all.rowwise().sum());
        };
        for (int f = 0; f < c.frame_count(); f += 3) {
            here += light(c.image(f, k));
            there += light(right().capture.image(f, k));
        }
        apart.col(k) = (here.array() / there.array()).log();
    }
    apart.colwise() -= apart.rowwise().mean().eval();
    return std::sqrt(apart.squaredNorm() / static_cast<double>(apart.size()));
}

} // namespace

TEST_CASE("colours of cameras and frames that are alike stay as they are") {
    Capture capture = read_capture(right().path);
    for (const LabelFinding& found : correct_colours(capture, preset("cpu"))) {
        CAPTURE(found.label);
        CAPTURE(found.off);
        CHECK_FALSE(found.wrong);
        CHECK(found.off < 0.7 * found.bound);
    }
    CHECK(capture.camera_gains.empty());
    CHECK(capture.frame_exposures.empty());
    CHECK(colours_apart(capture) == 0);
}

TEST_CASE("gains and white balance of cameras are taken out of their pictures") {
    Flawed flawed([](FlawSizes& s) {
        s[Flaw::gain] = 12;
        s[Flaw::white_balance] = 5;
    });
    const double before = colours_apart(flawed.capture);
    const std::vector<LabelFinding> found = correct_colours(flawed.capture, preset("cpu"));
    const double after = colours_apart(flawed.capture);
    CAPTURE(found[0].off);
    CAPTURE(before);
    CAPTURE(after);
    CHECK(found[0].wrong);
    CHECK_FALSE(found[1].wrong);
    MESSAGE("colours of cameras: ", before, " apart, then ", after);
    CHECK(before > 0.05);
    CHECK(after < before / 4);
    Vec3<double> sum = Vec3<double>::Zero(); // drawn in the colours of the mean camera
    for (const Vec3<double>& gain : flawed.capture.camera_gains) {
        CHECK(gain.minCoeff() > 0.5);
        sum += Vec3<double>(gain.array().log());
    }
    CHECK(sum.cwiseAbs().maxCoeff() < 1e-9);
}

TEST_CASE("exposures of frames are taken out of their pictures, with the gains of cameras") {
    for (const bool gains : {false, true}) {
        CAPTURE(gains);
        Flawed flawed([&](FlawSizes& s) {
            s[Flaw::exposure] = 20;
            if (gains) s[Flaw::gain] = 12;
        });
        Capture& c = flawed.capture;
        const std::vector<LabelFinding> found = correct_colours(c, preset("cpu"));
        CHECK(found[0].wrong == gains);
        CHECK(found[1].label == "exposures of frames");
        CHECK(found[1].wrong);
        REQUIRE(static_cast<int>(c.frame_exposures.size()) == c.frame_count());
        // The light of each frame relative to the right one's, which all of them share then.
        const auto spread = [&](bool taken_out) {
            const std::vector<double> kept = c.frame_exposures;
            if (!taken_out) c.frame_exposures.clear();
            std::vector<double> log_light;
            for (int f = 0; f < c.frame_count(); ++f) {
                const auto light = [&](const Image<float>& picture) {
                    return picture.pixels.cast<double>().unaryExpr(&linear_from_srgb).sum();
                };
                log_light.push_back(
                    std::log(light(c.image(f, 2)) / light(right().capture.image(f, 2))));
            }
            c.frame_exposures = kept;
            double mean = 0, squares = 0;
            for (const double x : log_light) mean += x / static_cast<double>(log_light.size());
            for (const double x : log_light) squares += (x - mean) * (x - mean);
            return std::sqrt(squares / static_cast<double>(log_light.size()));
        };
        const double before = spread(false), after = spread(true);
        MESSAGE("exposures: ", before, " apart, then ", after);
        CHECK(before > 0.1);
        CHECK(after < before / 3);
        double sum = 0;
        for (const double x : c.frame_exposures) sum += std::log(x);
        CHECK(std::abs(sum) < 1e-9);
    }
}

TEST_CASE("one camera has no colours of its own") {
    const TemporaryFolder folder;
    FlawOptions o;
    o.capture = right().path;
    o.out = folder.path / "one";
    o.sizes[Flaw::gain] = 12;
    o.one_camera = right().capture.camera_ids.front();
    write_flawed(o);
    Capture capture = read_capture(o.out);
    CHECK_FALSE(correct_colours(capture, preset("cpu"))[0].wrong);
    CHECK(capture.camera_gains.empty());
}
