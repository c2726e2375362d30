// SPDX-License-Identifier: Apache-2.0
#include <rye/rig/gaze.hpp>

#include <doctest/doctest.h>

#include <numbers>

#include <rye/autodiff/dual.hpp>
#include <rye/math/rotation.hpp>

using namespace rye;
using std::numbers::pi;

TEST_CASE("gaze: golden values") {
    const Vec3<double> g = gaze_vector(0.3, -0.2);
    CHECK((g - Vec3<double>(-0.189796, 0.295520, 0.936293)).cwiseAbs().maxCoeff() <= 5e-7);
    const double degrees = angular_error(g, gaze_vector(.1, .25)) * 180 / pi;
    CHECK(degrees == doctest::Approx(27.69488).epsilon(3e-7));
    CHECK((gaze_vector(0., 0.) - Vec3<double>(0, 0, 1)).norm() == 0);
    CHECK(gaze_vector(0., 0.1)[0] > 0);  // + yaw: to the subject's left
    CHECK(gaze_vector(0.1, 0.)[1] > 0);  // + pitch: up
}

TEST_CASE_TEMPLATE("gaze: angles and vectors undo each other, up to the poles (C7)", T, float,
                   double) {
    const double tolerance = 4 * double(std::numeric_limits<T>::epsilon());
    for (const double below : {1.5, 1., 0.1, 1e-1, 1e-3, 1e-6}) {
        for (const double sign : {-1., 1.})
            for (const double yaw : {-3., -0.4, 0., 0.2, 3.1}) {
                const double pitch = sign * (pi / 2 - below);
                const Vec3<T> g = gaze_vector(static_cast<T>(pitch), static_cast<T>(yaw));
                const Vec2<T> a = pitch_yaw(g);
                CHECK(std::abs(double(a[0]) - pitch) <= tolerance);
                const double lost = below < 1e-2 ? 1 / below : 2;  // the yaw fades at the pole
                CHECK(std::abs(double(a[1]) - yaw) <= tolerance * lost);
                CHECK(double((gaze_vector(a[0], a[1]) - g).norm()) <= tolerance);
            }
    }
    const Vec2<T> pole = pitch_yaw(Vec3<T>(0, 1, 0));
    CHECK(double(pole[0]) == doctest::Approx(pi / 2));
    CHECK(pole[1] == 0);
    const Vec2<T> longer = pitch_yaw(Vec3<T>(T(-37.9592), T(59.104), T(187.2586)));
    CHECK(double(longer[0]) == doctest::Approx(0.3).epsilon(1e-4));
}

TEST_CASE("gaze: angular error in float, where acos sees nothing (C8)") {
    for (const double degrees : {0., 1e-4, 1e-3, 0.01, 0.1, 1., 30., 90., 150., 179.9, 180.}) {
        const double angle = degrees * pi / 180;
        for (int i = 0; i < 100; ++i) {
            const Vec3<double> a = gaze_vector(0.01 * i - 0.5, 0.02 * i);
            const Vec3<double> axis = cross(a, Vec3<double>(0, 1, 0)).normalized();
            const Vec3<double> b = so3_exp(Vec3<double>(axis * angle)) * a;
            const Vec3<float> af = a.cast<float>(), bf = b.cast<float>();
            const double truth = angular_error<double>(af.cast<double>(), bf.cast<double>());
            const double error = std::abs(double(angular_error(af, bf)) - truth) * 180 / pi;
            CHECK(error <= (degrees < 1 ? 1e-5 : 4e-5));
        }
    }
    const Vec3<float> g = gaze_vector(0.2f, 0.3f);
    CHECK(angular_error(g, g) == 0);
    CHECK(angular_error(g, Vec3<float>(5.0f * g)) <= 1e-7f);
    CHECK(angular_error(g, Vec3<float>(-g)) == doctest::Approx(pi));
    CHECK(chord_error(g, Vec3<float>(-g)) == doctest::Approx(4));
    using D = Dual<double, 1>;
    const Vec3<D> same(D::variable(0), D(0), D(1));
    CHECK(std::isfinite(angular_error(same, Vec3<D>(D(0), D(0), D(1))).d[0]));
}

TEST_CASE("gaze: what has no direction is refused, not normalised (C6)") {
    const float nan = std::nanf(""), inf = std::numeric_limits<float>::infinity();
    CHECK_THROWS_AS(detail::checked_gaze(Vec3<float>(0, 0, 0)), Error);
    CHECK_THROWS_AS(detail::checked_gaze(Vec3<float>(0, 1e-30f, 0)), Error);
    CHECK_THROWS_AS(detail::checked_gaze(Vec3<float>(0, nan, 1)), Error);
    CHECK_THROWS_AS(detail::checked_gaze(Vec3<float>(0, inf, 1)), Error);
    const Vec3<float> big = detail::checked_gaze(Vec3<float>(0, 3e30f, 4e30f));
    CHECK((big - Vec3<float>(0, 0.6f, 0.8f)).norm() <= 1e-6f);
}

TEST_CASE("gaze: range of the eye") {
    CHECK_FALSE(beyond_gaze_range(gaze_vector(0.0, 69.9 * pi / 180)));
    CHECK(beyond_gaze_range(gaze_vector(0.0, 70.1 * pi / 180)));
    CHECK(beyond_gaze_range(Vec3<double>(0, 0, -1)));
}

TEST_CASE("gaze: kappa") {
    const Vec3<double> visual = gaze_vector(0.1, -0.2);
    const KappaAngles<double> kappa{0.02, 0.087};
    const Vec3<double> optical = apply_kappa(visual, kappa);
    CHECK((optical - gaze_vector(0.12, -0.113)).norm() <= 1e-15);
    CHECK((gaze_from_kappa(optical, kappa) - visual).norm() <= 1e-15);
    CHECK(apply_kappa(visual, KappaAngles<double>{}) == visual);  // to the bit
    const Vec3<double> up(0, 1, 0);
    CHECK(apply_kappa(up, KappaAngles<double>{}) == up);
    CHECK((apply_kappa(up, kappa) - gaze_vector(pi / 2 + 0.02, 0.087)).norm() <= 1e-15);
}

TEST_CASE("gaze: between head and world") {
    const Mat3<double> r = so3_exp(Vec3<double>(0.3, -0.5, 0.2));
    const Vec3<double> g = gaze_vector(0.1, 0.4);
    CHECK((gaze_in_world(r, g) - r * g).norm() <= 1e-15);
    CHECK((gaze_in_head(r, gaze_in_world(r, g)) - g).norm() <= 1e-15);
}

TEST_CASE("gaze: the code of a gaze is the encoding of pitch and yaw") {
    const Columns<double> code = encode_gaze(gaze_vector(0.3, -0.2));
    REQUIRE(code.rows() == 18);
    CHECK(code(0, 0) == doctest::Approx(0.3));
    CHECK(code(1, 0) == doctest::Approx(-0.2));
    CHECK(code(2, 0) == doctest::Approx(std::sin(0.3)));
    CHECK(code(5, 0) == doctest::Approx(std::cos(-0.2)));
    CHECK(code(17, 0) == doctest::Approx(std::cos(-1.6)));
}
