// SPDX-License-Identifier: Apache-2.0
// Files of face trackers: units, signs, sides, lost faces, times; and what they do to an avatar.
#include <doctest/doctest.h>

#include <cmath>

#include <rye/core/random.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "../support/hostile.hpp"
#include "data/degrees.hpp"
#include "driving/face_names.hpp"
#include "driving/fit_expressions.hpp"
#include "driving/retarget.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

const std::string eyes_header =
    "Timecode,BlendShapeCount,EyeLookDownLeft,EyeLookInLeft,EyeLookOutLeft,EyeLookUpLeft,"
    "EyeLookDownRight,EyeLookInRight,EyeLookOutRight,EyeLookUpRight,JawOpen,HeadYaw,HeadPitch,"
    "HeadRoll,LeftEyeYaw,LeftEyePitch,LeftEyeRoll,RightEyeYaw,RightEyePitch,RightEyeRoll\n";

/// Eyes that swing to the subject's left and right by 0.3 rad, written with this sign and unit.
std::string swinging(double sign, double unit) {
    std::string text = eyes_header;
    for (int i = 0; i < 24; ++i) {
        const double yaw = 0.3 * std::sin(0.6 * i), pitch = 0.2 * std::cos(0.9 * i);
        const auto positive = [](double x) { return std::to_string(std::max(0.0, x / 0.6)); };
        text += "10:00:00:" + std::to_string(i) + ".5,61," + positive(-pitch) + "," +
                positive(-yaw) + "," + positive(yaw) + "," + positive(pitch) + "," +
                positive(-pitch) + "," + positive(yaw) + "," + positive(-yaw) + "," +
                positive(pitch) + ",0.5,0,0,0";
        for (int eye = 0; eye < 2; ++eye)
            text +=
                "," + std::to_string(sign * unit * yaw) + "," + std::to_string(unit * pitch) + ",0";
        text += "\n";
    }
    return text;
}

std::string mediapipe(const std::string& time, const std::string& name, double score,
                      const std::string& matrix) {
    return R"({"timestampMs":)" + time +
           R"(,"faceBlendshapes":[{"categories":[{"index":0,"score":)" + std::to_string(score) +
           R"(,"categoryName":")" + name +
           R"("}]}],"facialTransformationMatrixes":[{"rows":4,"columns":4,"data":[)" + matrix +
           "]}]}";
}

const std::string moved = "1,0,0,0, 0,1,0,0, 0,0,1,0, 1,2,-40,1";

Drivers<float> rest_of(int coefficients) {
    Drivers<float> d;
    d.expression = VecX<float>::Constant(coefficients, 0.25f);
    d.pose << 0, 0, 0, 1, 2, 3;
    d.scale = 2;
    d.gaze = {gaze_vector(0.0, 0.0).cast<float>(), gaze_vector(0.0, 0.0).cast<float>()};
    return d;
}

/// Frames in which nothing moves.
Capture still_capture(Index coefficients) {
    Capture c;
    for (int f = 0; f < 6; ++f) {
        CaptureFrame frame;
        frame.expression.assign(static_cast<std::size_t>(coefficients), static_cast<float>(f));
        frame.landmarks = Columns<double>::Ones(3, 66);
        c.frames.push_back(std::move(frame));
    }
    return c;
}

} // namespace

TEST_CASE("names of coefficients in all spellings") {
    CHECK(sided_name("browDown_L") == sided_name("BrowDownLeft"));
    CHECK(sided_name("brow.down.r") == SidedName{"browdown", 'r'});
    CHECK(sided_name("jawOpen") == SidedName{"jawopen", 0});
    CHECK(sided_name("left") == SidedName{"left", 0});
    CHECK(index_of_name({"a", "MouthSmileLeft"}, "mouth_smile_left") == 1);
}

TEST_CASE("Live Link Face: units and signs of eyes follow from the looks") {
    for (const double sign : {1.0, -1.0})
        for (const double unit : {1.0, degrees}) {
            CAPTURE(sign);
            CAPTURE(unit);
            const FaceTrack t = parse_live_link(swinging(sign, unit), "t.csv");
            REQUIRE(t.faces.size() == 24);
            CHECK(t.timed);
            for (std::size_t i = 0; i < t.faces.size(); ++i) {
                const double k = static_cast<double>(i);
                CHECK(t.faces[i].time == doctest::Approx(k / 60));
                for (const auto& gaze : t.faces[i].gaze) {
                    REQUIRE(gaze);
                    CHECK((*gaze)[1] == doctest::Approx(0.3 * std::sin(0.6 * k)).epsilon(1e-3));
                    CHECK((*gaze)[0] == doctest::Approx(0.2 * std::cos(0.9 * k)).epsilon(1e-3));
                }
            }
            std::string notes;
            for (const std::string& n : t.notes) notes += n;
            CHECK((notes.find(unit > 1 ? "degrees" : "radians") != std::string::npos));
            CHECK((notes.find("lefteyeyaw") != std::string::npos) == (sign > 0));
        }
}

TEST_CASE("Live Link Face: pictures without a face, times, head") {
    const std::string header =
        "\xef\xbb\xbftimecode,BlendShapeCount,jawOpen,HeadYaw,HeadPitch,HeadRoll\r\n";
    CHECK(is_live_link(header));
    CHECK_FALSE(is_live_link("frame,scale\n"));
    const FaceTrack t = parse_live_link(header +
                                            "00:00:59:59.0,0,,,,\n00:01:00:00.0,61,0.5,10,20,30\r\n"
                                            "00:01:00:30.0,0\n\n00:01:01;00,61,1,0,0,0\n",
                                        "t.csv");
    REQUIRE(t.faces.size() == 3);
    CHECK(t.lost == 1);
    CHECK(t.faces[1].time == 0.5);
    CHECK(t.faces[2].time == 1);
    CHECK(t.faces[1].coefficients == t.faces[0].coefficients);
    REQUIRE(t.faces[0].turn);
    const Vec3<double> nose = *t.faces[0].turn * Vec3<double>::UnitZ();
    CHECK(pitch_yaw(nose)[0] == doctest::Approx(20 * degree)); // up
    CHECK(pitch_yaw(nose)[1] ==
          doctest::Approx(-10 * degree)); // toward the right, as Unreal has it
    CHECK((*t.faces[0].turn)(1, 0) > 0);  // the left side goes up: the head tilts to its right
    CHECK_FAULT(parse_live_link(header, "t.csv"), "t.csv: has no picture with a face");
    CHECK_FAULT(parse_live_link("Timecode,BlendShapeCount\n", "t.csv"), "has no coefficients");
    CHECK_FAULT(parse_live_link(header + "0:0:0:0,61,0.5,0,0\n", "t.csv"),
                "t.csv: line 2: got 5 fields, expected 6");
    CHECK_FAULT(parse_live_link(header + "0:0:0:0,61,nan,0,0,0\n", "t.csv"),
                "line 2: column 'jawOpen': got 'nan'");
    CHECK_FAULT(parse_live_link(header + "0:0:0:0,61,90,0,0,0\n", "t.csv"), "got '90'");
    CHECK_FAULT(parse_live_link(header + "0:61:0:0,61,0,0,0,0\n", "t.csv"),
                "column 'Timecode': got '0:61:0:0'");
    CHECK_FAULT(parse_live_link("Timecode,jawOpen,JawOpen\n0:0:0:0,1,1\n", "t.csv"),
                "names 'JawOpen' twice");
}

TEST_CASE("MediaPipe's results in the spellings of JavaScript and Python") {
    const std::string lines = mediapipe("0", "jawOpen", 0.25, moved) + "\n" +
                              R"({"timestampMs":40,"faceBlendshapes":[]})" + "\n" +
                              mediapipe("80", "jawOpen", 0.75, moved) + "\n";
    const FaceTrack t = parse_face_json(lines, "m.jsonl");
    CHECK(t.kind == "MediaPipe");
    REQUIRE(t.faces.size() == 3);
    CHECK(t.lost == 1);
    CHECK(t.faces[2].time == doctest::Approx(0.08));
    CHECK(t.faces[2].coefficients[0] == 0.75);
    REQUIRE(t.faces[0].place);
    CHECK(*t.faces[0].place == Vec3<double>(10, 20, -400));
    CHECK(*t.faces[0].turn == Mat3<double>::Identity());
    const FaceTrack python = parse_face_json(
        R"([{"face_blendshapes":[[{"score":0.5,"category_name":"jawOpen"}]],)"
        R"("facial_transformation_matrixes":[[[1,0,0,1],[0,1,0,2],[0,0,1,-40],[0,0,0,1]]]}])",
        "m.json");
    CHECK_FALSE(python.timed);
    CHECK(*python.faces[0].place == Vec3<double>(10, 20, -400));
    const FaceTrack ours = parse_face_json(
        R"({"frames":[{"time":1,"faces":0},{"time":2,"faces":1,"coefficients":{"jawOpen":0.5},"matrix":[)" +
            moved + "]}]}",
        "r.json");
    CHECK(ours.kind == "rye import video");
    REQUIRE(ours.faces.size() == 1);
    CHECK(ours.lost == 0);
    CHECK_FAULT(parse_face_json("[]", "m.json"), "m.json: has no picture with a face");
    CHECK_FAULT(parse_face_json("[{}]", "m.json"), "m.json: picture 0: has neither");
    CHECK_FAULT(parse_face_json("[1]", "m.json"), "picture 0: got 1, expected an object");
    CHECK_FAULT(parse_face_json(lines + mediapipe("79", "jawOpen", 0, moved), "m.jsonl"),
                "m.jsonl: line 4: time: got 0.079");
    CHECK_FAULT(parse_face_json(lines + mediapipe("90", "jawLeft", 0, moved), "m.jsonl"),
                "line 4: faceBlendshapes: category 0: got the coefficient jawLeft");
    CHECK_FAULT(parse_face_json(mediapipe("0", "jawOpen", 7, moved), "m.json"), "got 7");
    CHECK_FAULT(parse_face_json(mediapipe("0", "jawOpen", 0, "1,0,0"), "m.json"),
                "facialTransformationMatrixes: got");
    CHECK_FAULT(
        parse_face_json(mediapipe("0", "jawOpen", 0, "1,0,0,0,0,2,0,0,0,0,1,0,0,0,0,1"), "m.json"),
        "is no rotation");
    CHECK_FAULT(parse_face_json(lines + R"({"weights":[]})", "m.jsonl"),
                "is of OpenXR, expected as before of MediaPipe");
}

TEST_CASE("OpenXR's gazes and weights") {
    const double s = std::sin(0.1),
                 c = std::cos(0.1); // a turn by 0.2 to the subject's left, about +y
    const auto pose = [](double x, double y, double z, double w) {
        const auto n = [](double v) { return std::to_string(v); };
        return R"({"orientation":{"x":)" + n(x) + R"(,"y":)" + n(y) + R"(,"z":)" + n(z) +
               R"(,"w":)" + n(w) + R"(},"position":{"x":0.1,"y":0.2,"z":0.3}})";
    };
    std::string weights = "0";
    for (int i = 1; i < 70; ++i) weights += i == 24 ? ",1" : i == 2 ? ",0.5" : ",0";
    const std::string text = R"({"time":1000000000,"head":)" + pose(0, s, 0, c) +
                             R"(,"gaze":[{"isValid":true,"gazePose":)" + pose(0, s, 0, c) +
                             R"(},{"isValid":false,"gazePose":)" + pose(0, 0, 0, 1) +
                             R"(}],"weights":[)" + weights + "]}";
    const FaceTrack t = parse_face_json(text, "x.json");
    CHECK(t.kind == "OpenXR");
    REQUIRE(t.faces.size() == 1);
    const TrackedFace& f = t.faces[0];
    REQUIRE(f.gaze[0]);
    CHECK_FALSE(f.gaze[1]);
    CHECK(f.gaze[0]->norm() < 1e-5); // both turned alike: ahead in the head
    CHECK(pitch_yaw(Vec3<double>(*f.turn * Vec3<double>::UnitZ()))[1] ==
          doctest::Approx(0.2).epsilon(1e-4));
    CHECK((*f.place - Vec3<double>(-100, 200, -300)).norm() < 1e-9);
    CHECK(f.coefficients[*index_of_name(t.names, "jawOpen")] == 1);
    CHECK(f.coefficients[*index_of_name(t.names, "cheekPuff")] == 0.25);
    CHECK_FAULT(parse_face_json(R"({"weights":[1]})", "x.json"), "weights: got 1 numbers");
    CHECK_FAULT(parse_face_json(R"({"gaze":[]})", "x.json"), "gaze: got 0 eyes");
    CHECK_FAULT(
        parse_face_json(R"({"gaze":[{"gazePose":{"orientation":{"x":0,"y":0,"z":0,"w":2}}},{}]})",
                        "x.json"),
        "gazePose: orientation: has the length 2");
}

TEST_CASE("a tracked face drives an avatar by names, looks and turns") {
    const std::vector<std::string> tracked{"eyeLookOutLeft",  "eyeLookInLeft",    "eyeLookUpLeft",
                                           "eyeLookDownLeft", "eyeLookOutRight",  "eyeLookInRight",
                                           "eyeLookUpRight",  "eyeLookDownRight", "browInnerUp",
                                           "mouthSmileLeft",  "mouthSmileRight",  "tongueOut"};
    const Retarget r(tracked,
                     {"browInnerUp_L", "browInnerUp_R", "mouthSmile_R", "mouthSmile", "ears"}, 5);
    CHECK(r.driven() == 4);
    CHECK(r.words() ==
          "4 of 5 coefficients are driven by name; not ears; the avatar has no tongueOut");
    TrackedFace f;
    f.coefficients = VecX<double>::Zero(12);
    f.coefficients[0] = 0.5;  // the left eye 20 degrees out
    f.coefficients[5] = 0.25; // the right one 10 degrees in
    f.coefficients[6] = 0.5;  // and 15 up
    f.coefficients[8] = 0.75;
    f.coefficients[9] = 1;
    f.coefficients[10] = 0.5;
    f.turn = head_turn(0.3, 0, 0);
    f.place = Vec3<double>(100, 0, 0); // 1 dm
    const Drivers<float> d = r.apply(f, rest_of(5));
    CHECK((d.expression - VecX<float>{{0.75f, 0.75f, 0.5f, 0.75f, 0.25f}}).norm() < 1e-6f);
    CHECK((pitch_yaw(d.gaze[0]) - Vec2<float>(0, 0.34906585f)).norm() < 1e-5f);
    CHECK((pitch_yaw(d.gaze[1]) - Vec2<float>(0.2617994f, 0.17453293f)).norm() < 1e-5f);
    CHECK((d.pose.head<3>() - Vec3<float>(0, 0.3f, 0)).norm() < 1e-6f);
    CHECK((d.pose.tail<3>() - Vec3<float>(3, 2, 3)).norm() < 1e-6f);
    // Angles of the track's own come before its looks; without either the rest stays.
    f.gaze[0] = Vec2<double>(0.1, -0.2);
    CHECK((pitch_yaw(r.apply(f, rest_of(5)).gaze[0]) - Vec2<float>(0.1f, -0.2f)).norm() < 1e-6f);
    const Retarget nothing({"jawOpen"}, {}, 5);
    CHECK(nothing.words().find("have no names") != std::string::npos);
    TrackedFace jaw;
    jaw.coefficients = VecX<double>::Ones(1);
    CHECK(nothing.apply(jaw, rest_of(5)).expression == rest_of(5).expression);
    CHECK(nothing.apply(jaw, rest_of(5)).gaze[0] == rest_of(5).gaze[0]);
}

TEST_CASE("coefficients without names are driven by what they move in the landmarks") {
    // An avatar of the same head whose coefficients are a rotation of the named ones.
    const HeadModel model = procedural_head(1, 0);
    const auto names = static_cast<Index>(model.expression_names.size());
    const Random random{7, 0};
    std::uint64_t next = 0;
    Columns<double> turn = Columns<double>::Identity(names, names);
    for (int mirrors = 0; mirrors < 4; ++mirrors) {
        VecX<double> v(names);
        for (Index i = 0; i < names; ++i) v[i] = random.normal(next++);
        turn -= 2 / v.squaredNorm() * v * (v.transpose() * turn);
    }
    const auto landmarks = [&](const VecX<double>& weights) {
        return landmarks_at(model, weights);
    };
    Capture capture;
    for (int f = 0; f < 80; ++f) {
        VecX<double> weights(names);
        for (Index k = 0; k < names; ++k)
            weights[k] = std::max(0.0, random.uniform(next++) * 2 - 1);
        CaptureFrame frame;
        const VecX<double> own = turn * weights;
        for (const double x : own) frame.expression.push_back(static_cast<float>(x));
        frame.pose << 0.2, -0.1, 0.3, 1, 2, 3;
        frame.scale = 1.5;
        const Mat3<double> r = so3_exp(Vec3<double>(frame.pose.head<3>()));
        frame.landmarks = ((1.5 * r) * landmarks(weights)).colwise() + Vec3<double>(1, 2, 3);
        capture.frames.push_back(std::move(frame));
    }
    const ExpressionMix mix = fitted_mix(model, capture, "--driving");
    CHECK(mix.names == model.expression_names);
    const Columns<double> rest = landmarks(VecX<double>::Zero(names));
    double error = 0, all = 0;
    for (Index k = 0; k < names; ++k) {
        const VecX<double> back = turn.transpose() * mix.weights.col(k);
        error += (landmarks(back) - landmarks(VecX<double>::Unit(names, k))).squaredNorm();
        all += (landmarks(VecX<double>::Unit(names, k)) - rest).squaredNorm();
    }
    MESSAGE("share of what names move that is missed: " << std::sqrt(error / all));
    CHECK(std::sqrt(error / all) < 0.1);
    // A track of such names then moves the avatar, from its own rest on.
    const Retarget r(model.expression_names, mix);
    TrackedFace face;
    face.coefficients = VecX<double>::Unit(names, 3);
    Drivers<float> still = rest_of(static_cast<int>(names));
    still.expression.setZero();
    CHECK((r.apply(face, still).expression - mix.weights.col(3).cast<float>()).norm() < 1e-6f);
    CHECK(r.words().find("21 coefficients without names are driven by what 21") == 0);
    capture.frames.resize(5);
    CHECK_FAULT(fitted_mix(model, capture, "--driving"),
                "--driving: got 5 frames, expected at least 6");
    CHECK_FAULT(fitted_mix(model, still_capture(names), "--driving"),
                "landmarks of all frames are alike");
}

TEST_CASE("sides and signs are turned round, a neutral face is taken away") {
    FaceTrack t;
    t.names = {"jawLeft", "jawRight", "eyeLookUpLeft", "jawOpen"};
    TrackedFace f;
    f.coefficients = VecX<double>{{0.1, 0.2, 0.3, 0.5}};
    f.turn = head_turn(0.3, 0.2, 0.1);
    f.place = Vec3<double>(1, 2, 3);
    f.gaze = {Vec2<double>(0.1, 0.2), Vec2<double>(0.3, 0.4)};
    t.faces = {f, f};
    t.faces[1].coefficients[3] = 1;
    FaceTrack mirrored = t;
    flip(mirrored, parsed_flips("sides", "--flip"));
    CHECK(mirrored.faces[0].coefficients == VecX<double>{{0.2, 0.1, 0.3, 0.5}});
    CHECK((*mirrored.faces[0].turn - head_turn(-0.3, 0.2, -0.1)).norm() < 1e-12);
    CHECK(*mirrored.faces[0].gaze[0] == Vec2<double>(0.3, -0.4));
    CHECK(*mirrored.faces[0].place == Vec3<double>(-1, 2, 3));
    flip(mirrored, parsed_flips("sides", "--flip"));
    CHECK((*mirrored.faces[0].turn - *t.faces[0].turn).norm() < 1e-12);
    CHECK(mirrored.faces[0].gaze == t.faces[0].gaze);
    FaceTrack turned = t;
    flip(turned, parsed_flips("head-yaw,head-roll,gaze-pitch,gaze-yaw", "--flip"));
    CHECK((*turned.faces[0].turn - head_turn(-0.3, 0.2, -0.1)).norm() < 1e-12);
    CHECK(*turned.faces[0].gaze[1] == Vec2<double>(-0.3, -0.4));
    CHECK_FAULT(parsed_flips("sides,nose", "--flip"), "--flip: got 'nose', expected sides");
    CHECK_FAULT(parsed_flips("", "--flip"), "got ''");

    subtract_neutral(t, 0, "--neutral");
    CHECK((t.faces[0].coefficients - VecX<double>{{0, 0, 0.3, 0}}).norm() < 1e-12);
    CHECK(t.faces[1].coefficients[3] == doctest::Approx(1));
    CHECK((*t.faces[1].turn - Mat3<double>::Identity()).norm() < 1e-12);
    CHECK_FAULT(subtract_neutral(t, 2, "--neutral"),
                "--neutral: got 2, expected a picture of the track");
}

TEST_CASE("a track is played at another rate") {
    FaceTrack t;
    t.timed = true;
    t.names = {"jawOpen"};
    for (const double time : {0.0, 0.1, 0.2, 0.4}) {
        TrackedFace f;
        f.time = time;
        f.coefficients = VecX<double>::Constant(1, 10 * time);
        f.turn = head_turn(time, 0, 0);
        t.faces.push_back(f);
    }
    const auto slow = resampled(t, 5);
    REQUIRE(slow.size() == 3);
    CHECK(slow[1].coefficients[0] == 2); // as it is in the file
    const auto fast = resampled(t, 20);
    REQUIRE(fast.size() == 9);
    for (std::size_t i = 0; i < fast.size(); ++i) {
        const double time = 0.05 * static_cast<double>(i);
        CHECK(fast[i].coefficients[0] == doctest::Approx(10 * time));
        CHECK((*fast[i].turn - head_turn(time, 0, 0)).norm() < 1e-9);
    }
    t.timed = false;
    CHECK(resampled(t, 20).size() == 4);
    t.timed = true;
    t.faces.back().time = 1e9;
    CHECK_FAULT(resampled(t, 20), "--driving: its pictures last 1e+09 s");
}
