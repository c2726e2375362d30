// SPDX-License-Identifier: Apache-2.0
// What a user gives a run that travels: drivers as CSV, cameras as JSON; and words nearly right.
#include <doctest/doctest.h>

#include <CLI/CLI.hpp>

#include "../support/hostile.hpp"
#include "commands/program.hpp"
#include "data/cameras_file.hpp"
#include "data/driver_table.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

Drivers<float> base() {
    Drivers<float> d;
    d.expression = Eigen::Vector3f(0.25f, -0.5f, 2);
    d.pose << 0.1f, 0.2f, -0.3f, 1, 2, 3;
    d.scale = 1.5f;
    d.gaze = {gaze_vector(0.1, 0.2).cast<float>(), gaze_vector(-0.1, 0.3).cast<float>()};
    return d;
}

std::vector<Drivers<float>> parsed(const std::string& text) {
    return parse_drivers(text, "d.csv", {3, {"smile", "blink", "jaw"}}, base());
}

std::vector<Photograph> cameras(const std::string& text) { return parse_cameras(text, "c.json"); }

} // namespace

TEST_CASE("drivers as CSV: columns that are there replace, others stay") {
    const auto d = parsed(
        "\xef\xbb\xbf"
        "frame, expression_1 ,jaw\r\na,0.5,7\r\n\r\nb,-1e-3,0\r\n");
    REQUIRE(d.size() == 2);
    CHECK(d[0].expression == Eigen::Vector3f(0.25f, 0.5f, 7));
    CHECK(d[1].expression == Eigen::Vector3f(0.25f, -1e-3f, 0));
    CHECK(d[1].pose == base().pose);
    CHECK(d[1].gaze[0] == base().gaze[0]);
    const auto look = parsed("gaze_left_pitch,gaze_left_yaw\n10,-20\n");
    constexpr double degree = 3.14159265358979323846 / 180;
    CHECK(look[0].gaze[0] == gaze_vector(10 * degree, -20 * degree).cast<float>());
    CHECK(look[0].gaze[1] == base().gaze[1]);
    const auto pose = parsed("scale,translation_x,translation_y,translation_z\n2,4,5,6\n");
    CHECK(pose[0].scale == 2);
    CHECK(pose[0].pose.tail<3>() == Eigen::Vector3f(4, 5, 6));
    CHECK(pose[0].pose.head<3>() == base().pose.head<3>());
}

TEST_CASE("drivers as CSV: what is written is read again") {
    Drivers<float> other = base();
    other.expression[0] = 1.0f / 3;
    other.pose[2] = -2.7182817f;
    other.gaze[1] = gaze_vector(0.3, -0.4).cast<float>();
    const auto back = parsed(text_of_drivers({base(), other}, {"0001", "with,comma"}));
    REQUIRE(back.size() == 2);
    CHECK(back[1].expression == other.expression);
    CHECK(back[1].pose == other.pose);
    CHECK(back[1].scale == other.scale);
    for (std::size_t e = 0; e < 2; ++e) CHECK((back[1].gaze[e] - other.gaze[e]).norm() < 2e-7f);
}

TEST_CASE("drivers as CSV: pupils, for those who take them") {
    std::vector<std::array<float, 2>> pupils, back;
    const std::string text = "pupil_right\n1.25\n0.5\n";
    const auto d = parse_drivers(text, "d.csv", {3, {}}, base(), &pupils);
    REQUIRE(pupils.size() == 2);
    CHECK(pupils[1] == std::array<float, 2>{1, 0.5f});
    parse_drivers(text_of_drivers(d, {"a", "b"}, pupils), "d.csv", {3, {}}, base(), &back);
    CHECK(back == pupils);
    parse_drivers("scale\n1\n", "d.csv", {3, {}}, base(), &(back = {}));
    CHECK(back.empty());
    CHECK_FAULT(parsed(text), "column 1 is 'pupil_right', expected frame");
    CHECK_FAULT(parse_drivers("pupil_left\n3\n", "d.csv", {3, {}}, base(), &back),
                "d.csv: line 2: column 'pupil_left': got '3', expected a number from 0.4 to 2");
}

TEST_CASE("drivers as CSV: faults name line, column and value") {
    CHECK_FAULT(parsed(""), "d.csv: is empty");
    CHECK_FAULT(parsed("frame,scale\n"), "no line after");
    CHECK_FAULT(parsed("expression_3\n1\n"), "column 1 is 'expression_3'");
    CHECK_FAULT(parsed("scale,scale\n1,1\n"), "names 'scale' twice");
    CHECK_FAULT(parsed("gaze_left_yaw\n1\n"), "'gaze_left_pitch' is missing beside gaze_left_yaw");
    CHECK_FAULT(parsed("rotation_x,rotation_y\n1,1\n"), "'rotation_z' is missing");
    CHECK_FAULT(parsed("scale\n1\n2,3\n"), "d.csv: line 3: got 2 fields, expected 1");
    CHECK_FAULT(parsed("scale\n0\n"), "line 2: column 'scale': got '0'");
    for (const char* x : {"nan", "inf", " ", "one", "1e300", "1,5"})
        CHECK_FAULT(parsed(std::string("jaw\n") + x + "\n9"), "line 2: ");
    CHECK_FAULT(parsed("gaze_right_pitch,gaze_right_yaw\n91,0\n"),
                "got '91', expected a number from -90");
}

TEST_CASE("cameras as JSON: places, matrices, and defaults for all") {
    const auto all = cameras(R"({"size": [64, 48], "fov": 30, "up": [0, 1, 0], "look_at": [0, 0, 0],
        "cameras": [{"eye": [0, 0, 10]}, {"name": "b", "eye": [5, 0, 10], "fov": 40, "size": [32, 32]},
                    {"intrinsic": [[90, 0, 30], [0, 91, 20], [0, 0, 1]],
                     "extrinsic": [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]}]})");
    REQUIRE(all.size() == 3);
    const Pinhole<double> first = look_at<double>({0, 0, 10}, {0, 0, 0}, {0, 1, 0},
                                                  30 * 3.14159265358979323846 / 180, {64, 48});
    CHECK(all[0].camera.fx == first.fx);
    CHECK(all[0].camera.camera_from_world.rotation == first.camera_from_world.rotation);
    CHECK(all[1].file == "b");
    CHECK(all[1].camera.width == 32);
    CHECK(all[2].camera.fy == 91);
    CHECK(all[2].camera.width == 64);
    CHECK(all[2].camera.camera_from_world.translation == Vec3<double>(1, 2, 3));
    // The same by a transforms.json: a camera at (0, 0, 10) that looks down z, y up.
    const auto same = cameras(R"({"w": 64, "h": 48, "fl_x": 90, "frames": [{"transform_matrix":
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 10], [0, 0, 0, 1]]}]})");
    CHECK((same[0].camera.camera_from_world.rotation - first.camera_from_world.rotation).norm() <
          1e-12);
    CHECK((same[0].camera.centre() - Vec3<double>(0, 0, 10)).norm() < 1e-12);
}

TEST_CASE("cameras as JSON: faults name camera and field") {
    const auto one = [](const std::string& camera) {
        return R"({"size": [8, 8], "fov": 30, "up": [0, 1, 0], "look_at": [0, 0, 0], "cameras": [)" +
               camera + "]}";
    };
    CHECK_FAULT(cameras("[]"), "neither 'cameras' nor 'frames'");
    CHECK_FAULT(cameras("{"), "c.json: not JSON");
    CHECK_FAULT(cameras(one("")), "is empty");
    CHECK_FAULT(cameras(one("3")), "camera 0: a camera: got 3");
    CHECK_FAULT(cameras(one("{}")), "expected 'eye'");
    CHECK_FAULT(cameras(one(R"({"eye": [0, 0]})")), "camera 0: eye: got [0,0], expected 3 numbers");
    CHECK_FAULT(cameras(one(R"({"eye": [0, 0, "a"]})")), "got \"a\", expected a finite number");
    CHECK_FAULT(cameras(one(R"({"eye": [0, 0, 0]})")), "eye and target coincide");
    CHECK_FAULT(cameras(one(R"({"eye": [0, 0, 1], "fov": 180})")), "fov: got 180");
    CHECK_FAULT(cameras(one(R"({"eye": [0, 0, 1], "size": [0, 8]})")), "size: got [0,8]");
    CHECK_FAULT(cameras(one(R"({"eye": [0, 0, 1], "foc": 3})")), "foc: is unknown here");
    CHECK_FAULT(cameras(R"({"cameras": [{"eye": [0, 0, 1]}]})"), "is missing");
    CHECK_FAULT(cameras(one(R"({"intrinsic": [[9, 0, 4], [0, 9, 4], [0, 0, 1]],
        "extrinsic": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]})")),
                "extrinsic");
    CHECK_FAULT(parsed_size("64", "--size"), "--size: got 64, expected WxH");
    CHECK_FAULT(parsed_size("0x5", "--size"), "got 0x5");
}

TEST_CASE("near misses of words") {
    const std::vector<std::string> commands{"capture", "train", "redirect", "evaluate", "render"};
    CHECK(near_miss("trian", commands) == "train");
    CHECK(near_miss("rendr", commands) == "render");
    CHECK(near_miss("eval", commands) == "evaluate");
    CHECK(near_miss("redirection", commands) == "redirect");
    CHECK(near_miss("x", commands).empty());
    CHECK(near_miss("paint", commands).empty());
    CHECK(near_miss("--captur", {"--capture", "--config"}) == "--capture");
    CHECK(near_miss("--cap", {"--config", "--capture"}) == "--capture");
    CHECK(near_miss("--", {"--config"}).empty());
}

TEST_CASE("what an option takes") {
    CLI::App app;
    std::string text;
    int number = 0;
    bool flag = false;
    using Kind = OptionValue::Kind;
    CHECK(value_of(*app.add_flag("--flag", flag)).kind == Kind::none);
    CHECK(value_of(*app.add_option("--number", number)).kind == Kind::number);
    CHECK(value_of(*app.add_option("--run", text, "Folder of a run")).kind == Kind::folder);
    CHECK(value_of(*app.add_option("--out", text, "A file")).kind == Kind::file);
    CHECK(value_of(*app.add_option("--frame", text, "Name")).kind == Kind::word);
    const OptionValue v =
        value_of(*app.add_option("--preset", text)->check(CLI::IsMember({"tiny", "cpu"})));
    CHECK(v.kind == Kind::choice);
    CHECK(v.choices == std::vector<std::string>{"tiny", "cpu"});
}
