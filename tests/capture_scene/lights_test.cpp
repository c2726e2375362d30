// SPDX-License-Identifier: Apache-2.0
// Lights of a rendered capture, from what the corneas in its photographs mirror, against the
// softboxes that lit it (synthetic_capture/head_render.cpp).
#include "corrections/lights.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>

#include <doctest/doctest.h>

#include <rye/rig/gaze.hpp>

#include "data/config.hpp"
#include "right_capture.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

constexpr double degree = 3.14159265358979323846 / 180;

double angle(const Vec3<double>& a, const Vec3<double>& b) {
    return std::acos(std::clamp(normalized(a).dot(normalized(b)), -1.0, 1.0)) / degree;
}

} // namespace

TEST_CASE("lights: the softboxes of a rendered head are found, and nothing without eye masks") {
    const RightCapture& right = right_capture();
    const Subject subject = describe_subject(right.capture, preset("cpu"));
    const FoundLights found = find_lights(right.capture, subject);
    for (const std::string& line : found.lines()) MESSAGE(line);
    REQUIRE(found.lights.size() >= 2);
    CHECK(angle(found.lights[0].to, Vec3<double>(0.62, 0.68, 0.95)) < 6);
    CHECK(angle(found.lights[1].to, Vec3<double>(-0.95, 0.22, 0.60)) < 8);
    CHECK(found.lights.front().intensity.minCoeff() > 0.02);
    CHECK(found.explained > 0.6);
    CHECK(found.json().at("lights").size() == found.lights.size());

    // The same bits again.
    const FoundLights again = find_lights(right.capture, subject);
    REQUIRE(again.lights.size() == found.lights.size());
    for (std::size_t l = 0; l < found.lights.size(); ++l) {
        CHECK(again.lights[l].to == found.lights[l].to);
        CHECK(again.lights[l].intensity == found.lights[l].intensity);
    }
    Capture blind = read_capture(right.path);
    for (CaptureView& view : blind.views) view.eye_mask.clear();
    const FoundLights nothing = find_lights(blind, subject);
    CHECK(nothing.lights.empty());
    CHECK(nothing.lines().front().find("no light was found") == 0);
}

TEST_CASE("lights: those of a file light the same head and frames, and are found where they are") {
    const TemporaryFolder folder;
    const std::filesystem::path file = folder.path / "lights.json";
    std::ofstream(file)
        << R"([{"to": [-0.5, 0.4, 2], "intensity": [0.5, 0.4, 0.3], "width": 0.15}])";
    const FoundLight given = read_lights(file).lights.front();
    const RightCapture other(12, std::vector{softbox_of(given.to, given.width, given.intensity)});
    const FoundLights found =
        find_lights(other.capture, describe_subject(other.capture, preset("cpu")));
    for (const std::string& line : found.lines()) MESSAGE(line);
    REQUIRE(found.lights.size() >= 1);
    const FoundLight& light = found.lights.front();
    CHECK(angle(light.to, given.to) < 4);
    CHECK(light.width == doctest::Approx(given.width).epsilon(0.3));
    for (Index c = 0; c < 3; ++c)
        CHECK(light.intensity[c] == doctest::Approx(given.intensity[c]).epsilon(0.3));

    const Capture &a = right_capture().capture, &b = other.capture;
    REQUIRE(a.frame_count() == b.frame_count());
    for (int f = 0; f < a.frame_count(); ++f) {
        const auto i = static_cast<std::size_t>(f);
        CHECK(a.frames[i].pose == b.frames[i].pose);
        CHECK(a.frames[i].landmarks == b.frames[i].landmarks);
        CHECK(a.frames[i].eyes[0].optical == b.frames[i].eyes[0].optical);
        CHECK(a.mask(f, 1).pixels == b.mask(f, 1).pixels);
        CHECK(a.image(f, 1).pixels != b.image(f, 1).pixels);
    }
}

TEST_CASE("lights: what is wrong with a file is told with file, field and value") {
    const TemporaryFolder folder;
    const std::filesystem::path file = folder.path / "lights.json";
    const auto read = [&](const std::string& text) {
        std::ofstream(file, std::ios::trunc) << text;
        return read_lights(file).lights;
    };
    const auto of = [&](const std::string& fields) {
        return read("{\"lights\": [{" + fields + "}]}");
    };
    const std::string to = R"("to": [0, 3, 4])", red = R"("intensity": [1, 0, 0])",
                      wide = R"("width": 0.2)";
    const std::vector<FoundLight> good = of(to + "," + red + "," + wide);
    REQUIRE(good.size() == 1);
    CHECK((good[0].to - Vec3<double>(0, 0.6, 0.8)).norm() < 1e-15);
    CHECK_FALSE(good[0].position);
    CHECK(*of(R"("position": [0, 3, 4],)" + red + "," + wide)[0].position == Vec3<double>(0, 3, 4));
    CHECK(read(R"({"lights": {"pictures": 7, "lights": []}})").empty()); // as `rye info` nests it
    CHECK_FAULT(read_lights(folder.path / "none.json"), "none.json");
    CHECK_FAULT(read("{\"lights\": [}"), "lights.json: not JSON");
    CHECK_FAULT(read("{}"), "lights.json: lights: got {}, expected a list of at most 16 lights");
    CHECK_FAULT(read("{\"lights\": null}"), "lights: got null, expected a list");
    CHECK_FAULT(read("[1]"), "lights[0]: got 1, expected an object with to");
    CHECK_FAULT(of(red + "," + wide),
                "lights[0]: to: is missing, expected a list of three numbers");
    CHECK_FAULT(of(to + "," + wide), "lights[0]: intensity: is missing");
    CHECK_FAULT(of(to + "," + red), "lights[0]: width: is missing, expected radians");
    CHECK_FAULT(of(to + R"(,"position": [1, 2, 3],)" + red + "," + wide),
                "lights[0]: has both to and position");
    CHECK_FAULT(of(R"("to": [1, 2],)" + red + "," + wide), "to: got [1,2], expected three numbers");
    CHECK_FAULT(of(R"("to": [1, 2, "up"],)" + red + "," + wide),
                "to: got \"up\", expected a finite number");
    CHECK_FAULT(of(R"("to": [0, 0, 0],)" + red + "," + wide), "to: got a vector of length 0");
    CHECK_FAULT(of(R"("position": [0, 0, 1e10],)" + red + "," + wide),
                "expected numbers of at most");
    CHECK_FAULT(of(to + R"(,"intensity": [1, 1e5, 1],)" + wide),
                "intensity: got [1,100000.0,1], expected numbers of at most 1000");
    CHECK_FAULT(of(to + R"(,"intensity": [1, 1e999, 1],)" + wide), "lights.json: not JSON");
    CHECK_FAULT(of(to + "," + red + R"(,"width": 0)"), "width: got 0 rad, expected 0.001 to 3.2");
    CHECK_FAULT(of(to + "," + red + R"(,"width": null)"),
                "width: got null, expected a finite number");
    std::string many = "[";
    for (int l = 0; l < 17; ++l)
        many += std::string(l ? "," : "") + "{" + to + "," + red + "," + wide + "}";
    CHECK_FAULT(read(many + "]"), "expected a list of at most 16 lights");
}

TEST_CASE("reflections: lobes painted on irises are found where they are, by map and by fit") {
    // Pixels of both eyes that mirror all directions in front, over an iris of its own colours.
    std::vector<MirroredPixel> pixels;
    const Vec3<double> lights[2] = {Vec3<double>(-0.4, 0.5, 0.75).normalized(),
                                    Vec3<double>(0.7, 0.1, 0.7).normalized()};
    for (int picture = 0; picture < 120; ++picture)
        for (int k = 0; k < 150; ++k) {
            const double a = 2.399963 * k, r = std::sqrt((k + 0.5) / 150) * 0.85;
            const double yaw = (0.5 * std::sin(0.37 * picture) + 0.7 * r * std::cos(a)),
                         pitch = (0.3 * std::cos(0.23 * picture) + 0.7 * r * std::sin(a));
            MirroredPixel p;
            p.to = gaze_vector(pitch, yaw).cast<float>();
            p.iris = Vec2<double>(r * std::cos(a), r * std::sin(a)).cast<float>();
            p.eye = picture % 2;
            p.picture = picture;
            const Vec3<double> to = p.to.cast<double>();
            const double light =
                0.3 * light_lobe(to, lights[0], 0.12) + 0.15 * light_lobe(to, lights[1], 0.15);
            p.colour =
                Vec3<float>::Constant(static_cast<float>(0.2 + 0.1 * r + 0.05 * p.eye + light));
            pixels.push_back(p);
        }
    const std::vector<ReflectedPart> map = reflected_parts(pixels, 3, 15);
    REQUIRE(map.size() > 100);
    const auto best = std::max_element(map.begin(), map.end(), [](const auto& a, const auto& b) {
        return a.colour.mean() < b.colour.mean();
    });
    CHECK(angle(best->to, lights[0]) < 4);
    CHECK(best->colour.mean() > 0.15);

    Reflections same{pixels, pixels, 120};
    CHECK(same.json().at("correlation").get<double>() == doctest::Approx(1));
    Reflections dull = same;
    for (MirroredPixel& p : dull.render) p.colour.setConstant(0.3F);
    CHECK((dull.json().at("correlation").is_null() ||
           std::abs(dull.json().at("correlation").get<double>()) < 0.1));
    CHECK(dull.json().at("renders").get<double>() < 0.01);
    Reflections few;
    CHECK(few.json().at("correlation").is_null());
    few.add(same);
    few.add(same);
    CHECK(few.pictures == 240);
    CHECK(few.photograph.back().picture == 239);
    CHECK(few.json().at("correlation").get<double>() == doctest::Approx(1));
}
