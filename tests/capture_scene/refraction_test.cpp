// SPDX-License-Identifier: Apache-2.0
// Irises that are rendered through corneas, against Fermat's principle
// (rye/geometry/sphere_path.hpp).
#include <cmath>
#include <fstream>
#include <numbers>

#include <doctest/doctest.h>
#include <nlohmann/json.hpp>

#include <rye/geometry/sphere_path.hpp>
#include <rye/rig/cornea.hpp>

#include "../support/hostile.hpp"
#include "data/degrees.hpp"
#include "synthetic_capture/corneal_ray.hpp"
#include "synthetic_capture/head_render.hpp"
#include "synthetic_capture/scene.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

using V3 = Vec3<double>;
constexpr double index_of_cornea = detail::corneal_index;

/// Returns where light from a point of the iris' plane leaves the cornea towards a camera; both in
/// the eyeball's frame.
SpherePath<double> path_from(const Eyeball& eye, const V3& point, const V3& camera) {
    const V3 centre(0, 0, cornea_ahead(eye));
    SpherePath<double> path =
        sphere_path(V3(camera - centre), V3(point - centre), {eye.cornea_radius, index_of_cornea});
    path.at += centre;
    return path;
}

V3 camera_aside(double degrees, double distance) {
    return distance * V3(std::sin(degrees * degree), 0, std::cos(degrees * degree));
}

/// Light of a colour below the tone curve's knee.
double linear(double srgb) {
    return srgb <= 0.04045 ? srgb / 12.92 : std::pow((srgb + 0.055) / 1.055, 2.4);
}

/// Where a row of pixels crosses the pupil's rim, left and right [px].
struct PupilInRow {
    double left = 0, right = 0;
};

/// Returns what a camera aside sees of the left pupil on the row through the eyeball's centre: the
/// pupil darkens half of what an iris without one would show.
PupilInRow pupil_in_picture(HeadModel& model, double index, const Pinhole<double>& camera) {
    HeadState state;
    state.expression = VecX<double>::Zero(static_cast<Index>(model.expression_names.size()));
    state.lids = lid_coefficients({Vec2<double>::Zero(), Vec2<double>::Zero()});
    state.optical = {V3(0, 0, 1), V3(0, 0, 1)};
    state.softboxes.clear();
    state.corneal_index = index;
    const double pupil = model.look.pupil_radius;
    const auto row = [&](double radius) {
        model.look.pupil_radius = radius;
        return PosedHead(model, state).picture(camera, 16).image;
    };
    const Image<float> with = row(pupil), without = row(-1);
    model.look.pupil_radius = pupil;
    PupilInRow found;
    double last = 1;
    for (int x = 0; x < camera.width; ++x) {
        const Index at = camera.width + x; // the second of three rows
        const double share = linear(with.pixels.col(at).sum() / 3) /
                             std::max(linear(without.pixels.col(at).sum() / 3), 1e-6);
        if ((last - 0.5) * (share - 0.5) < 0) {
            double& to = share < last ? found.left : found.right;
            to = x - 0.5 + (0.5 - last) / (share - last);
        }
        last = share;
    }
    return found;
}

} // namespace

TEST_CASE("refraction: a camera's ray goes the way of light from the iris' point to the camera") {
    const Eyeball eye;
    const double plane = eye.iris_plane();
    int seen = 0;
    double worst = 0;
    for (const double aside : {0.0, 30.0, 60.0, 80.0})
        for (int k = 0; k < 60; ++k) {
            const double r = eye.limbus_radius * (k + 0.5) / 61, a = 2.4 * k;
            const V3 point(r * std::cos(a), r * std::sin(a), plane),
                camera = camera_aside(aside, 8) + V3(0, 0.3, 0);
            const SpherePath<double> path = path_from(eye, point, camera);
            if (!path.seen || path.at.z() < plane) continue;
            ++seen;
            const V3 d = (path.at - camera).normalized();
            worst =
                std::max(worst, (seen_on_iris(eye, path.at, d, index_of_cornea) - point).norm());
            // The mesh is not the sphere: wherever it meets the ray, the sphere decides.
            worst = std::max(
                worst,
                (seen_on_iris(eye, V3(path.at + 0.003 * d), d, index_of_cornea) - point).norm());
        }
    MESSAGE("worst of " << seen << ": " << worst);
    CHECK(seen > 150);
    CHECK(worst < 1e-9);
}

TEST_CASE("refraction: rays that graze, miss or leave the cornea see its limbus, without a step") {
    const Eyeball eye;
    for (const double aside : {0.0, 70.0, 89.9, 90.0, 91.0, 110.0}) {
        const V3 d = -camera_aside(aside, 1),
                 across(std::cos(aside * degree), 0, -std::sin(aside * degree));
        V3 last;
        bool first = true;
        for (double off = -1.2; off <= 1.2; off += 1e-4) {
            const V3 at = V3(0, 0, cornea_ahead(eye)) + off * eye.cornea_radius * across -
                          0.5 * eye.cornea_radius * d;
            const V3 q = seen_on_iris(eye, at, d, index_of_cornea);
            REQUIRE(q.allFinite());
            CHECK(q.z() == doctest::Approx(eye.iris_plane()));
            CHECK(q.head<2>().norm() <= eye.limbus_radius * (1 + 1e-12));
            // But for the two sides of an axis that is seen end on, where the way out turns.
            if (!first && q.head<2>().norm() < 0.999 * eye.limbus_radius)
                CHECK((q - last).norm() < 0.02 * eye.limbus_radius);
            last = q;
            first = false;
        }
    }
}

TEST_CASE("refraction: a rendered pupil is as wide and where Fermat's principle has it") {
    HeadModel model = procedural_head(3, 64);
    model.look.pupil_radius = 0.5; // its rim is not behind a lid or a canthus
    const Eyeball& eye = model.eyes[0];
    for (const double aside : {0.0, 60.0}) {
        CAPTURE(aside);
        constexpr double distance = 8;
        const V3 from = camera_aside(aside, distance);
        Pinhole<double> camera =
            look_at<double>(V3(eye.centre + from), eye.centre, V3(0, 1, 0), 1.0, {401, 3});
        camera.fx = camera.fy = distance * 300 / (2 * eye.radius);
        const auto where = [&](double side, double index) {
            const V3 point(side * 0.5 * eye.limbus_radius, 0, eye.iris_plane());
            if (index == 1) return camera.project_point(V3(eye.centre + point)).x();
            const SpherePath<double> path = path_from(eye, point, from);
            CHECK(path.seen);
            return camera.project_point(V3(eye.centre + path.at)).x();
        };
        std::array<double, 2> width, middle;
        for (const double index : {1.0, index_of_cornea}) {
            CAPTURE(index);
            const PupilInRow found = pupil_in_picture(model, index, camera);
            const std::size_t k = index == 1 ? 0 : 1;
            width[k] = std::abs(where(1, index) - where(-1, index));
            middle[k] = 0.5 * (where(1, index) + where(-1, index));
            CHECK(found.right - found.left == doctest::Approx(width[k]).epsilon(0.015));
            CHECK(std::abs(0.5 * (found.right + found.left) - middle[k]) < 0.5);
        }
        MESSAGE(aside << " degrees: width " << width[0] << " and " << width[1] << " px, middle "
                      << middle[0] << " and " << middle[1] << " px of 401");
        CHECK(width[1] > (aside > 0 ? 1.25 : 1.05) * width[0]);
        if (aside > 0) CHECK(std::abs(middle[1] - middle[0]) > 2);
    }
}

TEST_CASE("refraction: a capture has it by its setting alone") {
    CaptureSettings settings;
    settings.train_frames = 1;
    settings.novel_frames = settings.independent_frames = 0;
    settings.gazes = {Vec2<double>(0, 0)};
    const HeadModel model = procedural_head(3, 0);
    for (const SceneFrame& f : capture_scene(model, settings).frames)
        CHECK(f.state.corneal_index == 1);
    settings.refraction = true;
    const CaptureScene scene = capture_scene(model, settings);
    REQUIRE(scene.frames.size() == 2);
    for (const SceneFrame& f : scene.frames) CHECK(f.state.corneal_index == index_of_cornea);
}

TEST_CASE("refraction: capture.json says so, and where the corneas are") {
    CaptureSettings settings;
    settings.size = 32;
    settings.samples = settings.cameras = settings.train_frames = 1;
    settings.novel_frames = settings.independent_frames = 0;
    const HeadModel model = procedural_head(3, 64);
    for (const bool on : {false, true}) {
        settings.refraction = on;
        const TemporaryFolder folder;
        write_capture(model, capture_scene(model, settings), folder.path / "c", [](int, int) {});
        std::ifstream file(folder.path / "c" / "capture.json");
        const nlohmann::json all = nlohmann::json::parse(file);
        const std::string eyeball = all.at("conventions").at("eyeball");
        CHECK((eyeball.find("seen without refraction") == std::string::npos) == on);
        REQUIRE(all.contains("refraction") == on);
        if (!on) continue;
        CHECK(all.at("refraction").at("refractive_index") == index_of_cornea);
        CHECK(all.at("refraction").at("cornea_radius").at(1) == model.eyes[1].cornea_radius);
        CHECK(all.at("refraction").at("cornea_ahead").at(0) == cornea_ahead(model.eyes[0]));
    }
}
