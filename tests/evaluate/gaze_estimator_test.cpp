// SPDX-License-Identifier: Apache-2.0
#include "corrections/gaze_estimator.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>

#include "drawn_eye.hpp"

using namespace rye;
using namespace rye::test;
using trainer::estimate_gaze;

namespace {

/// Directions of cameras, pitch and yaw [deg].
constexpr std::array<std::array<double, 2>, 3> views{{{0, 0}, {8, 25}, {-20, -15}}};

/// Degrees between the estimated and the true gaze; 180 if none was found.
double error_of(const EyePicture& p, double area_error = 0) {
    const auto found = estimate_gaze(p.image, p.eye, p.camera, p.ball, area_error);
    return found ? angular_error(found->gaze, p.gaze) / degree : 180;
}
double error_of(const DrawnEye& eye) { return error_of(draw(eye)); }

/// The area of the eye so many pixels higher: skin of the upper lid instead of the lower rim.
EyePicture raised(EyePicture p, int up) {
    const Columns<float> exact = p.eye;
    const Index by = static_cast<Index>(up) * p.image.width, rest = exact.cols() - by;
    p.eye.setZero();
    p.eye.leftCols(rest) = exact.rightCols(rest);
    return p;
}

/// Two pixels of skin below the eye as dark as this, as a lid's rim, lashes and corners are.
EyePicture rimmed(EyePicture p, float dark) {
    const Columns<float> eye = p.eye;
    const int w = p.image.width;
    for (int y = 2; y < p.image.height; ++y)
        for (int x = 1; x + 1 < w; ++x) {
            const auto inside = [&](int u, int v) {
                return eye(0, static_cast<Index>(v) * w + u) >= 0.5f;
            };
            bool beside = false;
            for (int v = y - 2; v <= y; ++v)
                for (int u = x - 1; u <= x + 1; ++u) beside = beside || inside(u, v);
            if (beside && !inside(x, y)) p.image.at(x, y) << dark + 0.1f, dark, dark - 0.1f;
        }
    return p;
}

/// Half of it away on the left.
EyePicture cut(EyePicture p) {
    for (Index k = 0; k < p.eye.cols(); ++k)
        if (k % p.image.width < p.image.width / 2) p.eye(0, k) = 0;
    return p;
}

/// From any of three cameras.
bool found_in(DrawnEye eye) {
    bool found = false;
    for (const auto& [pitch, yaw] : views) {
        eye.camera_pitch = pitch, eye.camera_yaw = yaw;
        found = found || error_of(eye) < 180;
    }
    return found;
}

struct Errors {
    double mean = 0, largest = 0;
};

/// Over 5 x 5 gazes, each seen from three cameras; lids, brightness and noise as in `eye`.
Errors errors_over_gazes(DrawnEye eye) {
    Errors all;
    int count = 0;
    for (const auto& [pitch, yaw] : views)
        for (eye.pitch = -20; eye.pitch <= 20; eye.pitch += 10)
            for (eye.yaw = -30; eye.yaw <= 30; eye.yaw += 15) {
                eye.camera_pitch = pitch, eye.camera_yaw = yaw;
                const double error = error_of(eye);
                all.mean += error, all.largest = std::max(all.largest, error), ++count;
            }
    all.mean /= count;
    MESSAGE("mean " << all.mean << ", largest " << all.largest << " degrees");
    return all;
}

} // namespace

TEST_CASE("gaze estimator: an eye wide open, 75 gazes and views") {
    const Errors e = errors_over_gazes({});
    CHECK(e.mean <= 0.1);
    CHECK(e.largest <= 0.3);
}

TEST_CASE("gaze estimator: lids that cover the iris above and below") {
    DrawnEye eye;
    eye.upper = 0.4, eye.lower = 0.35;
    const Errors e = errors_over_gazes(eye);
    CHECK(e.mean <= 0.25);
    CHECK(e.largest <= 0.7);
}

TEST_CASE("gaze estimator: little contrast, with noise") {
    DrawnEye eye;
    eye.upper = 0.5, eye.lower = 0.45;
    eye.sclera = 0.6, eye.iris = 0.45, eye.pupil = 0.35, eye.noise = 0.03;
    const Errors e = errors_over_gazes(eye);
    CHECK(e.mean <= 0.5);
    CHECK(e.largest <= 1.2);
}

TEST_CASE("gaze estimator: a green iris, in red nearly as bright as the sclera") {
    DrawnEye eye;
    eye.upper = 0.5, eye.lower = 0.45;
    eye.sclera = 0.6, eye.iris = 0.55, eye.pupil = 0.5, eye.iris_green = 0.3, eye.noise = 0.02;
    const Errors e = errors_over_gazes(eye);
    CHECK(e.mean <= 0.25);
    CHECK(e.largest <= 1);
    eye.iris_green = 0;
    CHECK(!found_in(eye));
}

TEST_CASE("gaze estimator: the upper lid's shadow on the eyeball") {
    DrawnEye eye;
    eye.upper = 0.5, eye.lower = 0.45, eye.shade = 0.25;
    const Errors e = errors_over_gazes(eye);
    CHECK(e.mean <= 0.2);
    CHECK(e.largest <= 0.6);
}

TEST_CASE("gaze estimator: the answer is in the head's frame") {
    DrawnEye eye;
    eye.pitch = -7, eye.yaw = 12;
    for (eye.head_yaw = -30; eye.head_yaw <= 30; eye.head_yaw += 15) CHECK(error_of(eye) <= 0.5);
}

TEST_CASE("gaze estimator: without an iris nothing is found") {
    DrawnEye eye;
    eye.upper = 0.5, eye.lower = 0.45, eye.has_iris = false;
    CHECK_FALSE(found_in(eye));
    for (eye.noise = 0.01; eye.noise < 0.2; eye.noise *= 2) CHECK_FALSE(found_in(eye));
    eye.noise = 0;
    for (eye.shade = 0.05; eye.shade <= 0.5; eye.shade += 0.05) CHECK_FALSE(found_in(eye));
    DrawnEye bright;  // no iris is brighter than the sclera
    bright.sclera = 0.4, bright.iris = bright.pupil = 0.8;
    CHECK_FALSE(found_in(bright));
}

TEST_CASE("gaze estimator: too few pixels of an eye, or none, say nothing") {
    DrawnEye eye;
    eye.upper = 0.06, eye.lower = 0.02;
    CHECK_FALSE(found_in(eye));
    EyePicture p = draw({});
    p.eye.setZero();
    CHECK_FALSE(estimate_gaze(p.image, p.eye, p.camera, p.ball).has_value());
}

TEST_CASE("gaze estimator: an iris whose plane is before the sphere's, from the side") {
    DrawnEye eye;
    eye.upper = 0.5, eye.lower = 0.45;
    eye.iris_plane = 0.115; // of radius 0.12 and limbus 0.06; where the sphere is as wide: 0.104
    double largest = 0, on_sphere = 0;
    for (eye.camera_yaw = -30; eye.camera_yaw <= 30; eye.camera_yaw += 15)
        for (eye.yaw = -10; eye.yaw <= 10; eye.yaw += 10) {
            EyePicture p = draw(eye);
            largest = std::max(largest, error_of(p));
            p.ball.iris_plane = 0;
            on_sphere = std::max(on_sphere, error_of(p));
        }
    MESSAGE("largest " << largest << ", with the plane unknown " << on_sphere << " degrees");
    CHECK(largest <= 0.6);
    CHECK(on_sphere >= 3);
}

TEST_CASE("gaze estimator: light that changes across the eye") {
    DrawnEye eye;
    eye.upper = 0.5, eye.lower = 0.45;
    for (eye.shade = 0.1; eye.shade <= 0.4; eye.shade += 0.1) CHECK(error_of(eye) <= 0.7);
}

TEST_CASE("gaze estimator: an area that covers the upper lid, or half of the eye") {
    DrawnEye eye;
    eye.upper = 0.4, eye.lower = 0.35, eye.skin_red = 0.15, eye.noise = 0.02;
    for (const auto& [pitch, yaw] : views)
        for (eye.yaw = -20; eye.yaw <= 20; eye.yaw += 20) {
            eye.camera_pitch = pitch, eye.camera_yaw = yaw;
            const EyePicture p = draw(eye);
            const double high = error_of(raised(p, 2), trainer::own_area_error);
            const double half = error_of(cut(p), trainer::own_area_error);
            INFO("camera " << eye.camera_pitch << ", " << eye.camera_yaw << ", gaze " << eye.yaw);
            CHECK(error_of(p, trainer::own_area_error) <= 1);
            CHECK(high <= 1);
            if (eye.yaw >= 0) CHECK(half <= 1.5); // else the iris is in the other half
        }
}

TEST_CASE("gaze estimator: a dark lower lid beside an area that may be off") {
    DrawnEye eye;
    eye.upper = 0.45, eye.lower = 0.35, eye.skin_red = 0.15, eye.noise = 0.02;
    eye.sclera = 0.9, eye.iris = 0.35, eye.pupil = 0.1;
    for (const float dark : {0.2f, 0.3f, 0.4f})
        for (eye.camera_pitch = -20; eye.camera_pitch <= 20; eye.camera_pitch += 20)
            for (eye.pitch = -10; eye.pitch <= 10; eye.pitch += 10)
                for (eye.yaw = -25; eye.yaw <= 25; eye.yaw += 25) {
                    INFO("rim " << dark << ", camera " << eye.camera_pitch << ", gaze " << eye.pitch
                                << ", " << eye.yaw);
                    CHECK(error_of(rimmed(draw(eye), dark), trainer::own_area_error) <= 1);
                }
}

TEST_CASE("gaze estimator: an area that is off does not make an iris of skin or of nothing") {
    DrawnEye eye;
    eye.upper = 0.4, eye.lower = 0.35, eye.skin_red = 0.15, eye.has_iris = false;
    for (eye.noise = 0; eye.noise < 0.1; eye.noise += 0.03)
        for (const int up : {0, 2, 4})
            CHECK(error_of(raised(draw(eye), up), trainer::own_area_error) == 180);
    EyePicture none = draw({});
    none.eye.setZero();
    CHECK(error_of(none, trainer::own_area_error) == 180);
}

TEST_CASE("gaze estimator: the least contrast falls with the number of pixels") {
    CHECK(trainer::least_contrast(10) == trainer::min_contrast);
    CHECK(trainer::least_contrast(40) == doctest::Approx(0.2));
    CHECK(trainer::least_contrast(990) == doctest::Approx(0.01));
}
