// SPDX-License-Identifier: Apache-2.0
#include <rye/rig/gaze_at.hpp>

#include <doctest/doctest.h>

#include <limits>
#include <numbers>
#include <vector>

#include <Eigen/LU>

#include <rye/autodiff/dual.hpp>
#include <rye/backend/lanes.hpp>
#include <rye/math/rotation.hpp>

#include "../support/lane_samples.hpp"

using namespace rye;

namespace {

constexpr double aim_degree = std::numbers::pi / 180;
constexpr double mm = 100; // of a canonical unit

/// Two eyes 62 mm apart, and their kappas.
template <class T>
std::array<Vec3<T>, 2> aimed_centres() {
    return {Vec3<T>(T(0.31), T(0.05), T(0.4)), Vec3<T>(T(-0.31), T(0.04), T(0.41))};
}
template <class T>
std::array<KappaAngles<T>, 2> kappas(double pitch, double yaw) {
    return {KappaAngles<T>{T(pitch * aim_degree), T(yaw * aim_degree)},
            KappaAngles<T>{T(pitch * aim_degree), T(-yaw * aim_degree)}};
}

/// A ray of the world: the visual axis as one finds it from the eyeball that is drawn. Nothing of
/// gaze_at.hpp is used: the pitch and yaw of the drawn eyeball's axis, less kappa, from its centre.
struct SeenRay {
    Vec3<double> from, along;
};
SeenRay seen_ray(const Vec3<double>& centre, const Vec3<double>& optical,
                 const KappaAngles<double>& kappa, const HeadPlacement<double>& head) {
    const EyeTransform<double> eye =
        eye_transform<double>({.centre = centre, .gaze = optical}, head);
    const Mat3<double>& r = head.world_from_head.rotation;
    const Vec3<double> axis = r.transpose() * eye.rotation.col(2);
    const double pitch = std::asin(axis.y()) - kappa.pitch;
    const double yaw = std::atan2(axis.x(), axis.z()) - kappa.yaw;
    const Vec3<double> visual(std::cos(pitch) * std::sin(yaw), std::sin(pitch),
                              std::cos(pitch) * std::cos(yaw));
    return {eye.translation, r * visual};
}
/// The point nearest to both rays, by least squares.
Vec3<double> meeting_point(const SeenRay& a, const SeenRay& b) {
    Mat3<double> sum = Mat3<double>::Zero();
    Vec3<double> right = Vec3<double>::Zero();
    for (const SeenRay& ray : {a, b}) {
        const Mat3<double> across = Mat3<double>::Identity() - ray.along * ray.along.transpose();
        sum += across;
        right += across * ray.from;
    }
    return sum.inverse() * right;
}
/// The distance of a point from a ray.
double beside(const SeenRay& ray, const Vec3<double>& p) {
    const Vec3<double> d = p - ray.from;
    return (d - ray.along * ray.along.dot(d)).norm();
}

std::vector<HeadPlacement<double>> head_poses() {
    std::vector<HeadPlacement<double>> all;
    for (const Vec3<double>& turn :
         {Vec3<double>(0, 0, 0), Vec3<double>(0.3, -0.4, 0.1), Vec3<double>(-0.2, 0.6, -0.3)})
        all.push_back({{so3_exp(turn), Vec3<double>(0.4, -1.2, 3 * turn.norm())},
                       all.size() == 2 ? 1.3 : 1.0});
    return all;
}

template <class T>
GazeTarget<T> target_of(const Vec3<double>& p) {
    return {p.cast<T>().eval(), T(1)};
}

} // namespace

TEST_CASE_TEMPLATE("gaze at: both visual axes meet at the point, at any pose and kappa", T, float,
                   double) {
    double worst = 0, apart = 0;
    for (const HeadPlacement<double>& head : head_poses())
        for (const auto& [pitch, yaw] : {std::pair{0.0, 0.0}, {-1.5, 5.0}, {2.0, -3.0}})
            for (const double distance : {300.0, 600.0, 2000.0})
                for (const Vec3<double>& aside : {Vec3<double>(0, 0, 1), Vec3<double>(0.4, 0.2, 1),
                                                  Vec3<double>(-0.3, -0.5, 1)}) {
                    const Vec3<double> in_head =
                        distance / mm * aside.normalized() + Vec3<double>(0, 0.05, 0.4);
                    const Vec3<double> world =
                        head.world_from_head.apply(Vec3<double>(head.scale * in_head));
                    const HeadPlacement<T> placed{head.world_from_head.cast<T>(), T(head.scale)};
                    const AimedEyes<T> eyes =
                        aim_eyes(aimed_centres<T>(), target_in_head(placed, target_of<T>(world)),
                                 kappas<T>(pitch, yaw));
                    const auto centre = aimed_centres<double>();
                    const auto kappa = kappas<double>(pitch, yaw);
                    std::array<SeenRay, 2> ray;
                    for (std::size_t e = 0; e < 2; ++e) {
                        CHECK(eyes[e].missed == T(0));
                        ray[e] = seen_ray(centre[e], eyes[e].optical.template cast<double>(),
                                          kappa[e], head);
                        worst = std::max(worst, mm * beside(ray[e], world));
                    }
                    apart = std::max(apart, mm * (meeting_point(ray[0], ray[1]) - world).norm());
                }
    MESSAGE("a visual axis passes the point at ", worst, " mm, both meet ", apart, " mm from it");
    CHECK(worst < (std::is_same_v<T, float> ? 5e-3 : 1e-10));
    // Nearly parallel axes of float meet where the last bits say: 2 m away, by 32 mm of 2 m.
    CHECK(apart < (std::is_same_v<T, float> ? 0.01 : 1e-7));
}

TEST_CASE("gaze at: eyes converge by the angle of the triangle") {
    const std::array<Vec3<double>, 2> centre{Vec3<double>(0.3, 0, 0), Vec3<double>(-0.3, 0, 0)};
    const AimedEyes<double> eyes = aim_eyes(centre, {Vec3<double>(0, 0, 3)}, kappas<double>(0, 0));
    CHECK(pitch_yaw(eyes[0].visual)[1] == doctest::Approx(-std::atan(0.1)));
    CHECK(pitch_yaw(eyes[1].visual)[1] == doctest::Approx(std::atan(0.1)));
    CHECK(eyes[0].visual == eyes[0].optical); // no kappa, to the bit
}

TEST_CASE("gaze at: infinitely far, both look the same way, whatever the head's place") {
    const HeadPlacement<double> head{{so3_exp(Vec3<double>(0.1, 0.3, 0)), Vec3<double>(7, 8, 9)},
                                     2};
    const GazeTarget<double> far{Vec3<double>(1, 0.5, 4), 0};
    const AimedEyes<double> eyes =
        aim_eyes(aimed_centres<double>(), target_in_head(head, far), kappas<double>(-1.5, 5));
    CHECK(eyes[0].visual == eyes[1].visual);
    const Vec3<double> expected =
        head.world_from_head.rotation.transpose() * far.point.normalized();
    CHECK((eyes[0].visual - expected).norm() <= 1e-15);
    // Weights continue into infinity.
    const AimedEyes<double> near = aim_eyes(
        aimed_centres<double>(), target_in_head(head, GazeTarget<double>{far.point, 1e-12}),
        kappas<double>(-1.5, 5));
    CHECK((near[0].visual - expected).norm() <= 1e-10);
    // A number so large that its square is none.
    const AimedEye<float> large =
        aim_eye(Vec3<float>(0, 0, 0), GazeTarget<float>{Vec3<float>(3e30f, 0, 4e30f)},
                KappaAngles<float>{});
    CHECK((large.visual - Vec3<float>(0.6f, 0, 0.8f)).norm() <= 1e-6f);
}

TEST_CASE("gaze at: beyond their range the eyes stop, together, and say by how much they miss") {
    const auto centre = aimed_centres<double>();
    const auto kappa = kappas<double>(-1.5, 5);
    const double range = 50 * aim_degree;
    for (const double yaw : {60.0, 100.0, 179.0, -130.0}) {
        CAPTURE(yaw);
        const Vec3<double> p = 6 * gaze_vector(0.1, yaw * aim_degree);
        const AimedEyes<double> eyes = aim_eyes(centre, target_of<double>(p), kappa, range);
        for (std::size_t e = 0; e < 2; ++e) {
            CHECK(angle_from_ahead(eyes[e].optical) <= range + 1e-12);
            CHECK(eyes[e].visual.norm() == doctest::Approx(1));
            CHECK((apply_kappa(eyes[e].visual, kappa[e]) - eyes[e].optical).norm() <= 1e-12);
            CHECK(eyes[e].missed ==
                  doctest::Approx(std::acos(eyes[e].visual.dot((p - centre[e]).normalized()))));
            CHECK(eyes[e].missed > 5 * aim_degree);
            CHECK(eyes[e].visual.x() * yaw > 0); // both to the side of the point
        }
        CHECK(angular_error(eyes[0].visual, eyes[1].visual) < 15 * aim_degree);
    }
    const AimedEyes<double> behind =
        aim_eyes(centre, target_of<double>({0, 0.045, -9}), kappa, range);
    for (std::size_t e = 0; e < 2; ++e) {
        CHECK(behind[e].visual.z() > 0.9);
        CHECK(behind[e].missed > 160 * aim_degree);
    }
    // Between the eyes: each turns in as far as it can.
    const AimedEyes<double> nose =
        aim_eyes(centre, target_of<double>({0, 0.045, 0.45}), kappa, range);
    CHECK(angle_from_ahead(nose[0].optical) == doctest::Approx(range));
    CHECK(nose[0].visual.x() < 0);
    CHECK(nose[1].visual.x() > 0);
    CHECK(nose[0].missed > 0.1);
}

TEST_CASE("gaze at: targets that are none are refused") {
    const auto centre = aimed_centres<double>();
    const auto refused = [&](const Vec3<double>& p, double weight = 1) {
        try {
            detail::checked_target<double>("--gaze-at", {p, weight}, centre, 0.12);
        } catch (const Error& e) {
            return std::string(e.what());
        }
        return std::string();
    };
    const double inf = std::numeric_limits<double>::infinity();
    CHECK(refused({0, 0, 6}).empty());
    CHECK(refused({0, 0, 6}, 0).empty());
    CHECK(refused({0.31, 0.05, 0.5}).find("lies inside the left eye") != std::string::npos);
    CHECK(refused({-0.31, 0.04, 0.41})
              .find("--gaze-at: got the point (-0.31, 0.04, 0.41), which "
                    "lies inside the right eye") == 0);
    CHECK(refused({0, inf, 6}).find("expected finite numbers") != std::string::npos);
    CHECK(refused({0, std::nan(""), 6}).find("expected finite numbers") != std::string::npos);
    CHECK(refused({0, 0, 6}, -1).find("weight of 0 or more") != std::string::npos);
    CHECK(refused({0, 0, 0}, 0).find("without a direction") != std::string::npos);
    CHECK(aim_eye(centre[0], {centre[0]}, {}).visual.norm() == 0);
}

TEST_CASE("gaze at: duals' derivatives are finite differences, inside and outside the range") {
    using D = Dual<double, 8>;
    // Coordinates of the centre and of the target, pitch and yaw of kappa.
    const auto axes = [](const auto* x) {
        using T = std::decay_t<decltype(x[0])>;
        const AimedEye<T> eye =
            aim_eye(Vec3<T>(x[0], x[1], x[2]), GazeTarget<T>{Vec3<T>(x[3], x[4], x[5])},
                    KappaAngles<T>{x[6], x[7]}, T(0.9));
        return std::array<T, 7>{eye.visual[0],  eye.visual[1],  eye.visual[2], eye.optical[0],
                                eye.optical[1], eye.optical[2], eye.missed};
    };
    for (const std::array<double, 8>& at :
         {std::array<double, 8>{0.3, 0.1, 0.4, -0.2, 0.5, 3, 0.03, -0.09},
          std::array<double, 8>{0.3, 0.1, 0.4, 5, 0.5, 1, 0.03, -0.09}}) {
        std::array<D, 8> x;
        for (std::size_t k = 0; k < 8; ++k) x[k] = D::variable(at[k], static_cast<int>(k));
        const auto value = axes(x.data());
        for (std::size_t k = 0; k < 8; ++k) {
            const double step = 1e-6;
            std::array<double, 8> up = at, down = at;
            up[k] += step;
            down[k] -= step;
            const auto a = axes(up.data()), b = axes(down.data());
            for (std::size_t i = 0; i < 7; ++i) {
                CAPTURE(k);
                CAPTURE(i);
                CHECK(std::abs(value[i].d[k] - (a[i] - b[i]) / (2 * step)) <= 1e-8);
            }
        }
    }
}

TEST_CASE("gaze at: lanes give what each gives alone") {
    using Batch = XsimdBackend<>::batch<float>;
    const auto centre = [](std::size_t l) { return unit_vec<float, 3>(l, 2); };
    const auto point = [](std::size_t l) { return Vec3<float>(4.0f * unit_vec<float, 3>(l, 3)); };
    const KappaAngles<float> kappa{-0.02f, 0.08f};
    const AimedEye<Batch> lanes =
        aim_eye(lanes_of<Batch, 3>(centre), GazeTarget<Batch>{lanes_of<Batch, 3>(point)},
                KappaAngles<Batch>{Batch(kappa.pitch), Batch(kappa.yaw)});
    const auto alone = [&](std::size_t l) {
        return aim_eye(centre(l), GazeTarget<float>{point(l)}, kappa);
    };
    CHECK(lane_gap(lanes.visual, [&](std::size_t l) { return alone(l).visual; }) <= 1e-6);
    CHECK(lane_gap(lanes.optical, [&](std::size_t l) { return alone(l).optical; }) <= 1e-6);
    for (std::size_t l = 0; l < Batch::size; ++l)
        CHECK(std::abs(lanes.missed.get(l) - alone(l).missed) <= 1e-6f);
}
