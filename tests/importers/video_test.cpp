// SPDX-License-Identifier: Apache-2.0
// `rye import video` of tracks whose head, camera and gazes are known, and of tracks that are wrong.
#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <string>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "../support/hostile.hpp"
#include "corrections/labels.hpp"
#include "data/capture.hpp"
#include "data/validate.hpp"
#include "importers/import_folder.hpp"
#include "importers/video_choice.hpp"
#include "importers/video_dots.hpp"
#include "importers/video_gaze.hpp"
#include "importers/video_head.hpp"
#include "importers/video_tools.hpp"
#include "video_tracks_source.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

constexpr double degrees = 57.29577951308232;

Tracks parsed(const std::vector<std::string>& lines) {
    std::string text;
    for (const std::string& line : lines) text += line + "\n";
    Tracks tracks;
    add_tracks(tracks, text, "t");
    return tracks;
}

std::vector<int> all_of(const Tracks& tracks) {
    std::vector<int> all;
    for (std::size_t i = 0; i < tracks.pictures.size(); ++i) all.push_back(static_cast<int>(i));
    return all;
}

/// Largest errors of a head that was found [deg, share].
struct Errors {
    double turn = 0, gaze = 0, distance = 0;
};
Errors errors_of(const VideoHead& head, const KnownVideo& video) {
    const std::vector<KnownPicture> known = known_pictures(video);
    Errors e;
    for (std::size_t i = 0; i < known.size(); ++i) {
        const VideoPose& pose = head.poses[i];
        const Rigid<double>& camera = head.camera.camera_from_world;
        const Mat3<double> turned = camera.rotation * pose.world_from_head.rotation;
        e.turn = std::max(e.turn, degrees * so3_log(Mat3<double>(turned.transpose() *
                                                                 known[i].head.rotation)).norm());
        for (std::size_t k = 0; k < 2; ++k) {
            const Vec3<double> a = turned * pose.gaze[k], b = known[i].head.rotation * known[i].gaze[k];
            e.gaze = std::max(e.gaze, degrees * angular_error(a, b));
            const Vec3<double> eye(k == 0 ? 0.31 : -0.31, 0.3, 0.5);
            const double far = camera.apply(pose.world_from_head.apply(head.eyes[k].centre)).z();
            e.distance = std::max(e.distance, std::abs(far / known[i].head.apply(eye).z() - 1));
        }
    }
    return e;
}

/// Mean errors of the gazes that were found, before the camera [deg].
double mean_gaze_error(const VideoHead& head, const KnownVideo& video) {
    const std::vector<KnownPicture> known = known_pictures(video);
    double sum = 0;
    for (std::size_t i = 0; i < known.size(); ++i) {
        const VideoPose& pose = head.poses[i];
        const Mat3<double> turned =
            head.camera.camera_from_world.rotation * pose.world_from_head.rotation;
        for (std::size_t e = 0; e < 2; ++e) {
            const Vec3<double> a = turned * pose.gaze[e], b = known[i].head.rotation * known[i].gaze[e];
            sum += degrees * angular_error(a, b);
        }
    }
    return sum / static_cast<double>(2 * known.size());
}

} // namespace

TEST_CASE("video: a tracked head is found where it is, by a camera that is known") {
    const KnownVideo video;
    const Tracks tracks = parsed(known_tracks(video));
    HeadOptions options;
    options.focal = video.focal;
    const VideoHead head = video_head(tracks, all_of(tracks), options);
    const Errors e = errors_of(head, video);
    INFO("turn ", e.turn, " deg, gaze ", e.gaze, " deg, distance ", e.distance);
    CHECK(head.camera.fx == doctest::Approx(video.focal).epsilon(0.01));
    CHECK(e.turn < 1);
    CHECK(e.gaze < 2);
    CHECK(e.distance < 0.04);
    CHECK(head.drivers.size() == 2); // neither eyeLook* nor _neutral
}

TEST_CASE("video: a focal length that is not known is found between what is likely and what is true") {
    KnownVideo video;
    video.focal = 800; // a likely one is 640
    const Tracks tracks = parsed(known_tracks(video));
    const VideoHead head = video_head(tracks, all_of(tracks), {});
    INFO("focal ", head.camera.fx, ", deviation ", head.focal_deviation);
    CHECK(head.camera.fx > 640);
    CHECK(head.camera.fx < 840);
    CHECK(head.focal_deviation > 0);
    CHECK(head.focal_deviation < 0.15);
}

TEST_CASE("video: the same tracks give the same bits") {
    const KnownVideo video;
    const Tracks tracks = parsed(known_tracks(video));
    const VideoHead a = video_head(tracks, all_of(tracks), {}), b = video_head(tracks, all_of(tracks), {});
    CHECK(a.camera.fx == b.camera.fx);
    for (std::size_t i = 0; i < a.poses.size(); ++i) {
        CHECK(a.poses[i].landmarks == b.poses[i].landmarks);
        CHECK(a.poses[i].gaze[0] == b.poses[i].gaze[0]);
    }
}

TEST_CASE("video: gazes that the coefficients have wrong are corrected by the irises in the pictures") {
    const TemporaryFolder folder;
    KnownVideo video;
    video.noise = 0.1;
    write_known_video(video, folder.path);
    paint_eyes(video, folder.path);
    Tracks tracks = read_tracks({folder.path});
    // The tracker says that both eyes look further down than they do.
    for (TrackedPicture& p : tracks.pictures)
        for (std::size_t k = 0; k < tracks.names.size(); ++k)
            if (tracks.names[k].starts_with("eyeLookDown"))
                p.coefficients[static_cast<Index>(k)] += 0.25;
    HeadOptions options;
    options.focal = video.focal;
    VideoHead head = video_head(tracks, all_of(tracks), options);
    const double before = mean_gaze_error(head, video);
    const VideoGazes said = correct_gazes(tracks, head);
    const double after = mean_gaze_error(head, video);
    INFO("before ", before, ", after ", after, ", up ", said.up_deg);
    CHECK(before > 6);
    CHECK(after < 2.5);
    CHECK(said.seen > 40);
    CHECK(said.up_deg == doctest::Approx(7.5).epsilon(0.25));

    // Without irises they stay.
    write_known_video(video, folder.path);
    const Vec3<double> was = head.poses[0].gaze[0];
    CHECK(correct_gazes(tracks, head).up_deg == 0);
    CHECK(head.poses[0].gaze[0] == was);
    tracks.width = 4 * tracks.width;
    CHECK_FAULT(correct_gazes(tracks, head), "is 640 x 640 pixels, expected 2560 x 640");
}

/// A video whose eyes look at dots of a screen, and the dots.
struct DotVideo {
    KnownVideo video;
    std::vector<GazeDot> dots;
    static constexpr double began = 1.3; ///< the dots' clock, with the reaction [s]

    DotVideo() {
        video.pictures = 72;
        video.turn_deg = 12;
        const Random r{11, 4};
        for (int d = 0; d < 10; ++d) {
            const auto key = static_cast<std::uint64_t>(2 * d);
            dots.push_back({0.6 * d, 0.6 * d + 0.59,
                            {240 * (r.uniform(key) - 0.5), -200 * r.uniform(key + 1)}});
        }
        video.target = [all = dots, r](int picture) {
            const auto dot = dot_at(all, 0.1 * picture - began);
            const auto key = static_cast<std::uint64_t>(100 + 2 * picture);
            const Vec2<double> at = dot ? dot->right_up
                                        : Vec2<double>(300 * (r.uniform(key) - 0.5),
                                                       -200 * r.uniform(key + 1));
            return Vec3<double>(-0.01 * at.x(), -0.01 * at.y(), 0); // y down
        };
    }
};

TEST_CASE("video: dots that were looked at give gazes, and when they began") {
    const DotVideo known;
    Tracks tracks = parsed(known_tracks(known.video));
    // The tracker sees eyes turn too little, and both too far to one side.
    for (TrackedPicture& p : tracks.pictures)
        for (std::size_t k = 0; k < tracks.names.size(); ++k) {
            double& x = p.coefficients[static_cast<Index>(k)];
            if (tracks.names[k].starts_with("eyeLook")) x *= 0.6;
            if (tracks.names[k] == "eyeLookOutLeft" || tracks.names[k] == "eyeLookInRight") x += 0.3;
        }
    HeadOptions options;
    options.focal = known.video.focal;
    VideoHead head = video_head(tracks, all_of(tracks), options);
    const double before = mean_gaze_error(head, known.video);
    const DotClock clock = find_dots(tracks, known.dots, "dots");
    const DotGazes said = look_at_dots(tracks, clock, head);
    const double after = mean_gaze_error(head, known.video);
    MESSAGE("before ", before, " deg, after ", after, "; begin ", clock.begin, " s in ",
            said.pictures, " pictures, correlation ", clock.correlation);
    CHECK(before > 7);
    CHECK(after < 2);
    CHECK(said.pictures >= 18);
    CHECK(clock.correlation > 0.6);
    CHECK(clock.begin > DotVideo::began - 0.35);
    CHECK(clock.begin < DotVideo::began + 0.05);
    CHECK(said.off_deg > 4);

    // From the first dot to the last, eyes rest on a dot or are between two.
    int between = 0, resting = 0;
    for (const TrackedPicture& p : tracks.pictures) {
        const bool rests = clock.looked_at(p).has_value();
        CHECK((!rests || clock.has(p)));
        resting += rests ? 1 : 0;
        between += clock.has(p) && !rests ? 1 : 0;
    }
    CHECK(resting == said.pictures);
    CHECK(between >= 18);
    const VideoChoice wanted = choose_pictures(tracks, 100, [&](const TrackedPicture& p) {
        if (clock.looked_at(p)) return Wanted::preferred;
        return clock.has(p) ? Wanted::no : Wanted::otherwise;
    });
    // The head turns by 12 degrees: not far enough to be new.
    CHECK(wanted.unwanted >= between);
    CHECK(static_cast<int>(wanted.pictures.size()) == 72 - wanted.unwanted);
    for (const int i : wanted.pictures)
        CHECK((clock.looked_at(tracks.pictures[static_cast<std::size_t>(i)]) ||
               !clock.has(tracks.pictures[static_cast<std::size_t>(i)])));
    // A head that no picture with a dot has.
    const auto far = std::find_if(tracks.pictures.begin(), tracks.pictures.end(),
                                  [&](const TrackedPicture& p) { return !clock.has(p); });
    REQUIRE(far != tracks.pictures.end());
    const auto choose = [&] {
        const VideoChoice c = choose_pictures(tracks, 100, [&](const TrackedPicture& p) {
            return &p == &*far ? Wanted::otherwise
                   : clock.looked_at(p) ? Wanted::preferred : Wanted::no;
        });
        return static_cast<int>(c.pictures.size()) - resting;
    };
    CHECK(choose() == 0);
    far->head.rotation = far->head.rotation * so3_exp(Vec3<double>(0, 0.7, 0));
    CHECK(choose() == 1);

    // Dots of another video.
    std::vector<GazeDot> others = known.dots;
    std::rotate(others.begin(), others.begin() + 5, others.end());
    for (std::size_t i = 0; i < others.size(); ++i) {
        others[i].begin = known.dots[i].begin, others[i].end = known.dots[i].end;
        others[i].right_up = {-others[i].right_up.y() - 100, others[i].right_up.x()};
    }
    CHECK_FAULT(find_dots(tracks, others, "other.csv"),
                "other.csv: the gazes of the video follow these dots at no time (correlation ");
}

TEST_CASE("video: files of dots are read, and wrong ones refused by line") {
    const std::string head = "begin_s,end_s,right_mm,up_mm\n";
    const std::vector<GazeDot> dots = parse_gaze_dots(head + "0,1.5,-20,30\r\n1.5,3,40.5,-7\n", "d");
    REQUIRE(dots.size() == 2);
    CHECK(dots[1].right_up == Vec2<double>(40.5, -7));
    CHECK(!dot_at(dots, -0.1));
    CHECK(dot_at(dots, 1.4)->right_up.x() == -20);
    CHECK(!dot_at(dots, 1.6, 0.3));
    CHECK(dot_at(dots, 1.9, 0.3)->right_up.x() == 40.5);
    CHECK(!dot_at(dots, 3));
    CHECK_FAULT(parse_gaze_dots("a,b\n", "d"), "d: line 1: got 'a,b', expected 'begin_s,");
    CHECK_FAULT(parse_gaze_dots(head, "d"), "d: has no dots");
    CHECK_FAULT(parse_gaze_dots(head + "0,1,2\n", "d"), "d: line 2: got 3 fields, expected 4");
    CHECK_FAULT(parse_gaze_dots(head + "0,1,2,nan\n", "d"), "got 'nan', expected a finite number");
    CHECK_FAULT(parse_gaze_dots(head + "0,1,x,2\n", "d"), "got 'x', expected a finite number");
    CHECK_FAULT(parse_gaze_dots(head + "1,1,2,3\n", "d"), "is not after its begin");
    CHECK_FAULT(parse_gaze_dots(head + "0,2,0,0\n1,3,0,0\n", "d"), "line 3: it begins at 1 s, before");
    CHECK_FAULT(parse_gaze_dots(head + "0,2,0,6000\n", "d"), "expected at most 5000");
}

TEST_CASE("video: a head's turn stays near its guess where that is known before") {
    const KnownVideo video;
    Tracks tracks = parsed(known_tracks(video));
    const Mat3<double> off = so3_exp(Vec3<double>(0, 4 / degrees, 0));
    tracks.pictures[5].head.rotation = tracks.pictures[5].head.rotation * off;
    HeadOptions options;
    options.focal = video.focal;
    const VideoHead head = video_head(tracks, all_of(tracks), options);
    const Mat3<double> turned =
        head.camera.camera_from_world.rotation * head.poses[5].world_from_head.rotation;
    const double away = degrees * so3_log(Mat3<double>(turned.transpose() *
                                                       known_pictures(video)[5].head.rotation)).norm();
    INFO("away ", away);
    CHECK(away > 0.5);
    CHECK(away < 4);
}

TEST_CASE("video: an import makes a capture without faults, and repeats no frame") {
    const TemporaryFolder folder;
    const KnownVideo video;
    write_known_video(video, folder.path / "tracks");
    paint_eyes(video, folder.path / "tracks");
    ImportOptions options;
    options.out = folder.path / "out";
    options.video.files = {folder.path / "tracks"};
    options.video.size = 320;
    const ImportSummary summary = import_video(options);
    CHECK(summary.frames >= 20);
    CHECK(summary.written == summary.frames);
    std::vector<Problem> problems;
    const Capture capture = read_capture(options.out, {}, &problems);
    for (const Problem& p : validate(capture)) problems.push_back(p);
    for (const Problem& p : problems) {
        INFO(p.message);
        CHECK(p.severity != Problem::Severity::error);
    }
    CHECK(capture.frame_count() == summary.frames);
    CHECK(capture.width == 320);
    CHECK(capture.has_gaze());
    CHECK(import_video(options).written == 0);

    // The import has weighed the irises: training does not take gazes from them alone.
    Capture corrected = read_capture(options.out);
    const LabelFindings findings = correct_labels(corrected, preset("tiny"));
    CHECK(!findings.gazes);
    REQUIRE(!findings.not_judged.empty());
    CHECK(findings.not_judged.back().find("`rye import video` has weighed") != std::string::npos);
    fs::remove(options.out / "capture.json");
    const LabelFindings judged = correct_labels(corrected, preset("tiny"));
    CHECK(judged.not_judged.empty());
}

TEST_CASE("video: pictures without one whole, sharp face are left out, and counted") {
    Tracks tracks = parsed(known_tracks({}));
    tracks.pictures[0].faces = 0;
    tracks.pictures[1].faces = 2;
    tracks.pictures[2].sharpness = 2;
    tracks.pictures[3].landmarks.row(0).array() += 500;
    VideoChoice c = choose_pictures(tracks, 100);
    CHECK(c.without_face == 1);
    CHECK(c.with_several == 1);
    CHECK(c.blurred == 1);
    CHECK(c.at_border == 1);
    CHECK(c.pictures.size() == 20);
    c = choose_pictures(tracks, 12);
    CHECK(c.pictures.size() == 12);
    CHECK(c.spare == 8);
    for (TrackedPicture& p : tracks.pictures) p.faces = 0;
    CHECK_FAULT(choose_pictures(tracks, 100),
                "got 0 pictures with one whole, sharp face of 24 (24 without a face");
    tracks.pictures.resize(2);
    CHECK_FAULT(choose_pictures(tracks, 100), "expected 8 or more");
}

TEST_CASE("video: wrong tracks are refused by line and field") {
    KnownVideo video;
    video.pictures = 1;
    const std::string line = known_tracks(video)[0];
    const auto with = [&](const std::string& from, const std::string& to) {
        std::string text = line;
        const std::size_t at = text.find(from);
        REQUIRE(at != std::string::npos);
        return parsed({line, text.replace(at, from.size(), to)});
    };
    CHECK_FAULT(parsed({line, line.substr(0, line.size() / 2)}), "t: line 2: not JSON");
    CHECK_FAULT(parsed({"[]"}), "t: line 1: is no object");
    CHECK_FAULT(parsed({"{}"}), "t: line 1: picture: got '', expected a file in this folder");
    CHECK_FAULT(with("frames/0.png", "../0.png"), "picture: got '../0.png'");
    CHECK_FAULT(with("\"faces\":1", "\"faces\":-1"), "faces: got -1, expected a whole number from 0");
    CHECK_FAULT(with("\"jawOpen\":", "\"jawOpen\":1e9,\"x\":"), "coefficients");
    CHECK_FAULT(with("\"jawOpen\":", "\"jawShut\":"), "coefficients: has no jawOpen");
    CHECK_FAULT(with("\"size\":[640,640]", "\"size\":[640,480]"), "expected 640 x 640 as in the");
    CHECK_FAULT(with("\"size\":[640,640]", "\"size\":[640,4]"), "size: got 4, expected 16 to 16384");
    CHECK_FAULT(with("\"landmarks\":[[", "\"landmarks\":[[null,"), "landmarks: 0: got [null");
    CHECK_FAULT(with("\"landmarks\":[[", "\"landmarks\":[[1e300,2,3],["), "got 479 values, expected 478");
    CHECK_FAULT(with("\"matrix\":[", "\"matrix\":[0,"), "matrix: got 17 values, expected 16");
    CHECK_FAULT(with("\"sharpness\":10", "\"sharpness\":NaN"), "t: line 2: not JSON");
}

TEST_CASE("video: what is not installed is named with the command that installs it") {
    const TemporaryFolder folder;
    const std::string path = std::getenv("PATH") != nullptr ? std::getenv("PATH") : "";
    ::setenv("PATH", folder.path.c_str(), 1);
    ::unsetenv("CHROMIUM");
    VideoToolOptions none;
    none.modules = none.landmarker = none.tracker = folder.path / "none";
    for (const char* words :
         {"ffmpeg: `apt-get install ffmpeg`", "node: `apt-get install nodejs`",
          "chromium: `apt-get install chromium`", "npm install --ignore-scripts @mediapipe",
          "none: `curl -LO ", "rye's own"})
        CHECK_FAULT(find_video_tools(none), words);
    ::setenv("PATH", path.c_str(), 1);
    ImportOptions options;
    options.out = folder.path / "out";
    options.video.files = {folder.path};
    CHECK_FAULT(import_video(options), "is a folder without tracks.jsonl");
    CHECK(!fs::exists(options.out));
}
