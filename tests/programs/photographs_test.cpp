// SPDX-License-Identifier: Apache-2.0
#include "../support/real_data.hpp"
#include "data/photographs.hpp"

#include <filesystem>
#include <fstream>

#include <doctest/doctest.h>

#include "data/json.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

struct File {
    fs::path path = fs::temp_directory_path() / "rye_photographs_test.json";
    ~File() { fs::remove(path); }
    const fs::path& holds(const std::string& text) const {
        std::ofstream(path) << text;
        return path;
    }
};

/// A camera 4 before the origin on +z of OpenGL's axes, looking back at it.
const std::string frame = R"({"file_path": "a.png", "transform_matrix":
    [[1, 0, 0, 0.5], [0, 1, 0, 0.25], [0, 0, 1, 4], [0, 0, 0, 1]])";

std::string scene(const std::string& more, const std::string& frames = frame + "}") {
    return R"({"w": 64, "h": 48, "fl_x": 100, "fl_y": 110, "cx": 30, "cy": 25, )" + more +
           R"("frames": [)" + frames + "]}";
}

} // namespace

TEST_CASE("photographs: OpenGL's camera becomes OpenCV's, with the file's lens or the frame's") {
    const File file;
    const auto all = read_photographs(file.holds(
        scene(R"("k1": -0.1, "p2": 0.01, )", frame + "}, " + frame + R"(, "k1": 0, "p2": 0, "w": 32})")));
    REQUIRE(all.size() == 2);
    const Pinhole<double>& c = all[0].camera;
    CHECK(c.width == 64);
    CHECK(all[1].camera.width == 32);
    CHECK((c.centre() - Vec3<double>(0.5, 0.25, 4)).norm() < 1e-14);
    // A point to the right and above is right and up in the image.
    const Vec3<double> p = c.project_point(Vec3<double>(1.5, 1.25, 0));
    CHECK(p[0] == doctest::Approx(30 + 25));
    CHECK(p[1] == doctest::Approx(25 - 27.5));
    CHECK(p[2] == doctest::Approx(4));
    CHECK(all[0].bent());
    CHECK(all[0].lens.k1 == -0.1);
    CHECK(all[0].lens.p2 == 0.01);
    CHECK_FALSE(all[1].bent());
    CHECK(lens_coefficients(file.path) == std::vector<double>{-0.1, 0.01, 0, 0});
}

TEST_CASE("photographs: what is no lens of OPENCV, or no camera, is refused by name") {
    const File file;
    const auto refused = [&](const std::string& text, const char* word) {
        CHECK_THROWS_WITH_AS(read_photographs(file.holds(text)), doctest::Contains(word), Error);
    };
    refused(scene(R"("camera_model": "OPENCV_FISHEYE", )"), "OPENCV_FISHEYE");
    refused(scene(R"("k4": 0.1, )"), "k4");
    refused(scene("", R"({"transform_matrix": [[1, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 0]]})"),
            "rotation");
    refused(scene("", "{}"), "frame 0: transform_matrix: is missing");
    refused(scene(R"("k1": "none", )"), "frame 0: k1: got \"none\", expected a finite number");
    refused(scene("", frame + R"(, "k1": [1]})"), "frame 0: k1: got [1], expected a finite number");
    refused(scene(R"("camera_model": 3, )"), "frame 0: camera_model: got 3, expected a text");
    refused(scene("", R"({"file_path": 1, "transform_matrix": 2})"), "frame 0: file_path: got 1");
    refused(scene("", R"({"transform_matrix": 2})"), "frame 0: transform_matrix: got 2");
    refused(scene("", R"({"transform_matrix": [[1, 0, 0, 0], 5, 6]})"),
            "frame 0: transform_matrix: row 1: got 5, expected 4 numbers");
    refused(scene("", R"({"transform_matrix": [[1, 0, 0, "x"], 5, 6]})"),
            "frame 0: transform_matrix: row 0: got \"x\", expected a finite number");
    refused(scene("", "7"), "frame 0: got 7");
    refused("[]", "got [], expected an object with frames");
    refused("{}", "frames: is missing");
    refused(R"({"frames": {}})", "frames: got {}, expected a list");
    CHECK_THROWS_WITH_AS(lens_coefficients(file.holds(scene(R"("k1": "none", )"))),
                         doctest::Contains(": k1: got \"none\", expected a finite number"), Error);
    CHECK_THROWS_WITH_AS(lens_coefficients(file.holds("{}")),
                         doctest::Contains(": frames: is missing"), Error);
    // No message is the library's own: those name neither file nor field.
    const auto ours = [&](const std::string& text) {
        try {
            read_photographs(file.holds(text));
        } catch (const Error& e) {
            CHECK(std::string(e.what()).find("json.exception") == std::string::npos);
        }
    };
    const nlohmann::json good = nlohmann::json::parse(scene(R"("k1": 0.1, "camera_angle_x": 1, )"));
    for (const auto& [key, value] : good.items())
        for (const char* other : {"null", "true", "\"none\"", "[]", "{}", "[{}]", "[[]]", "-1"}) {
            nlohmann::json wrong = good;
            wrong[key] = nlohmann::json::parse(other);
            ours(wrong.dump());
            wrong = good;
            wrong["frames"][0][key] = nlohmann::json::parse(other);
            ours(wrong.dump());
            wrong["frames"][0]["transform_matrix"] = nlohmann::json::parse(other);
            ours(wrong.dump());
        }
    refused(R"({"frames": [)" + frame + "}]}", "w and h");
    refused("{", "json");
    CHECK_THROWS_AS(read_photographs("no such file"), Error);
}

TEST_CASE("json: text nested too deep is refused, wherever it is read") {
    const std::string deep(100000, '['), closed = deep + std::string(100000, ']');
    for (const std::string& text : {deep, closed, "{\"frames\": " + closed + "}"}) {
        CHECK_THROWS_WITH_AS(parse_json_text(text, "x.json"),
                             doctest::Contains("x.json: not JSON that is read here"), Error);
        CHECK_THROWS_WITH_AS(parse_photographs(text, "x.json"), doctest::Contains("deeper"), Error);
        CHECK_THROWS_WITH_AS(
            parse_json_text<nlohmann::ordered_json>(text, "x.json", JsonComments::skipped),
            doctest::Contains("deeper than 64"), Error);
    }
    const auto nested = [](std::size_t n) { return std::string(n, '[') + std::string(n, ']'); };
    CHECK(parse_json_text(nested(64), "x.json").is_array());
    CHECK_THROWS_AS(parse_json_text(nested(66), "x.json"), Error);
    CHECK_THROWS_WITH_AS(parse_json_text("{", "x.json"), doctest::Contains("x.json: not JSON"),
                         Error);
    CHECK(parse_json_text("[1, 2] // a comment", "x.json", JsonComments::skipped).size() == 2);
    CHECK_THROWS_AS(parse_json_text("[1, 2] // a comment", "x.json"), Error);
}

TEST_CASE("photographs: those of the data folder, where there is one") {
    const auto path = test::real_data("buddha/transforms.json");
    if (!path) return;
    for (const Photograph& p : read_photographs(*path)) CHECK(p.camera.fx > 0);
}
