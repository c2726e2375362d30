// SPDX-License-Identifier: Apache-2.0
#include <rye/rig/eye_transform.hpp>

#include <doctest/doctest.h>

#include <numbers>

#include <rye/autodiff/check.hpp>
#include <rye/rig/eyeball.hpp>

using namespace rye;
using std::numbers::pi;

namespace {

HeadPlacement<double> some_head() {
    return {{so3_exp(Vec3<double>(0.3, -0.4, 0.2)), Vec3<double>(0.5, -1, 2)}, 0.9};
}

template <class T>
HeadPlacement<T> cast(const HeadPlacement<double>& h) {
    return {h.world_from_head.cast<T>(), static_cast<T>(h.scale)};
}

} // namespace

TEST_CASE("eye transform: composes offset, gaze and head in this order (C15)") {
    const HeadPlacement<double> head = some_head();
    const double deg = pi / 180;
    const EyeDrive<double> drive{{0.3, 0.2, 0.6}, {0.01, -0.02, 0.03},
                                 gaze_vector(20 * deg, 30 * deg)};
    const EyeTransform<double> eye = eye_transform(drive, head);
    const Vec3<double> axis = cross(Vec3<double>(0, 0, 1), drive.gaze).normalized();
    const double angle = std::acos(drive.gaze[2]);
    const Mat3<double> r_gaze = so3_exp(Vec3<double>(axis * angle));
    const Mat3<double>& r = head.world_from_head.rotation;
    const Vec3<double> x(0.02, -0.03, 0.1);
    const Vec3<double> in_head = drive.centre + drive.offset + r_gaze * x;
    const Vec3<double> expected = head.scale * (r * in_head) + head.world_from_head.translation;
    CHECK((eye.apply(x) - expected).norm() <= 1e-15);
    CHECK((quat_matrix(eye.quaternion) - r * r_gaze).norm() <= 2e-15);
    CHECK_FALSE(eye.beyond_range);
    // The other order gives a different eye, so the test is meaningful.
    const Vec3<double> other = head.scale * (r_gaze * (r * x)) + eye.translation;
    CHECK((other - expected).norm() > 1e-3);
}

TEST_CASE("eye transform: golden rotation, and rest changes nothing") {
    EyeDrive<double> drive{{0, 0, 0}, {0, 0, 0}, {.189796, .295520, .936293}};
    const EyeTransform<double> eye = eye_transform(drive, HeadPlacement<double>{});
    CHECK((eye.quaternion - Quat<double>(.983944, -.150171, .096447, 0)).norm() <= 2e-6);
    drive.gaze = Vec3<double>(0, 0, 5);  // any length
    const EyeTransform<double> rest = eye_transform(drive, HeadPlacement<double>{});
    CHECK(rest.rotation == Mat3<double>::Identity());
    CHECK(rest.apply(Vec3<double>(1, 2, 3)) == Vec3<double>(1, 2, 3));
}

TEST_CASE("eye transform: the mesh looks where it was told to, each eye on its own") {
    const EyeballTemplate<double> eyeball = eyeball_template<double>({});
    const HeadPlacement<double> head = some_head();
    for (const double pitch : {-0.5, 0., 0.4})
        for (const double yaw : {-0.6, 0., 0.8}) {
            const Vec3<double> g = gaze_vector(pitch, yaw);
            const EyeTransform<double> eye = eye_transform({{0.3, 0.2, 0.6}, {0, 0, 0}, g}, head);
            const Vec3<double> seen = gaze_from_mesh(eyeball, eye_points(eye, eyeball.points));
            CHECK(angular_error(gaze_in_head(head.world_from_head.rotation, seen), g) <= 1e-13);
        }
}

TEST_CASE("eye transform: no direction is refused, too far a direction is reported (C5, C6)") {
    const auto look = [](const Vec3<double>& gaze) {
        return eye_transform<double>({{0, 0, 0}, {0, 0, 0}, gaze}, HeadPlacement<double>{});
    };
    CHECK_THROWS_AS(look(Vec3<double>(0, 0, 0)), Error);
    CHECK_THROWS_AS(look(Vec3<double>(0, std::nan(""), 1)), Error);
    const EyeTransform<double> back = look(Vec3<double>(0, 0, -1));
    CHECK(back.beyond_range);
    CHECK((back.apply(Vec3<double>(0, 0, 1)) - Vec3<double>(0, 0, -1)).norm() <= 1e-15);
}

TEST_CASE("eye transform: rounding does not grow with the lever arm, only with the place (A16)") {
    for (const double far : {1., 10., 1e3, 1e5}) {
        HeadPlacement<double> head = some_head();
        head.world_from_head.translation.setConstant(far);
        head.scale = 1;
        const EyeDrive<double> drive{{0.3, 0.2, 0.6}, {0, 0, 0}, gaze_vector(0.2, 0.3)};
        const EyeTransform<double> exact = eye_transform(drive, head);
        const EyeDrive<float> drive_f{drive.centre.cast<float>(), Vec3<float>::Zero(),
                                      drive.gaze.cast<float>()};
        const EyeTransform<float> eye = eye_transform(drive_f, cast<float>(head));
        for (int i = 0; i < 100; ++i) {
            const Vec3<double> x = 0.12 * gaze_vector(0.03 * i, 0.06 * i);
            const Vec3<double> y = eye.apply(Vec3<float>(x.cast<float>())).cast<double>();
            CHECK((y - exact.apply(x)).norm() <= 4 * 0x1p-24 * (1 + far * std::sqrt(3.)));
        }
    }
}

TEST_CASE_TEMPLATE("eye transform: adjoints of offset and rotations", T, float, double) {
    const double tolerance = std::is_same_v<T, double> ? 1e-14 : 2e-6;
    const HeadPlacement<T> head = cast<T>(some_head());
    const Columns<T> points = random_columns<T>(3, 200, {1});
    const Columns<T> rotations = random_columns<T>(4, 200, {2});
    const Vec3<T> centre(T(0.3), T(0.2), T(0.6)), gaze = gaze_vector(T(0.3), T(-0.2));
    const EyeTransform<T> eye = eye_transform<T>({centre, Vec3<T>::Zero(), gaze}, head);
    const auto place = [&](const auto& offset) {
        using S = typename std::decay_t<decltype(offset)>::Scalar;
        const HeadPlacement<S> h{head.world_from_head.template cast<S>(), S(head.scale)};
        const EyeDrive<S> drive{centre.template cast<S>(),
                                Vec3<S>(offset(0, 0), offset(1, 0), offset(2, 0)),
                                gaze.template cast<S>()};
        return eye_points(eye_transform(drive, h), Columns<S>(points.template cast<S>()));
    };
    const auto place_vjp = [&](const Columns<T>& w) {
        return Columns<T>(detail::eye_offset_cotangent(eye, w));
    };
    CHECK(detail::dot_product_test(place, place_vjp, random_columns<T>(3, 1, {3}),
                                   random_columns<T>(3, 1, {4}),
                                   random_columns<T>(3, 200, {5})) <= tolerance);
    const auto turn = [&](const auto& q) {
        using S = typename std::decay_t<decltype(q)>::Scalar;
        EyeTransform<S> e;
        e.quaternion = eye.quaternion.template cast<S>();
        return eye_rotations(e, Columns<S>(q));
    };
    const auto turn_vjp = [&](const Columns<T>& w) { return eye_rotations_vjp(eye, w); };
    CHECK(detail::dot_product_test(turn, turn_vjp, rotations, random_columns<T>(4, 200, {6}),
                                   random_columns<T>(4, 200, {7})) <= tolerance);
}
