// SPDX-License-Identifier: Apache-2.0
#include <rye/rig/gaze_features.hpp>
#include <rye/rig/gaze_mechanisms.hpp>

#include <doctest/doctest.h>

#include "../support/laws.hpp"

using namespace rye;

namespace {

using D = Dual<double, 1>;
using Serially = ScalarBackend<Serial>;
constexpr Index points = 9, left_points = 4;
constexpr int channels = 5;

Vec3<double> direction(double pitch, double yaw) { return gaze_vector(pitch, yaw); }

/// Points of two eyes, and their gazes as columns.
struct Eyes {
    Columns<double> position = random_columns<double>(3, points, 3) * 0.12;
    Columns<double> gaze{3, 2};
    Eyes(double pitch, double yaw) {
        gaze.col(0) = direction(pitch, yaw);
        gaze.col(1) = direction(-0.1, yaw + 0.2);
    }
};

template <class A, class T>
Columns<T> features_of(const typename A::template Parameters<T>& p, const Eyes& eyes) {
    const Columns<T> position = eyes.position.cast<T>(), gaze = eyes.gaze.cast<T>();
    const VecX<T> none;
    Columns<T> out = Columns<T>::Zero(channels, points);
    A::features(Serially{}, p, EyeInputs<T>{position, left_points, none, gaze, none},
                ColumnsSpan<T>(out));
    return out;
}

template <class P>
P random_like_fields(const P& p, std::uint64_t seed) {
    P r = p;
    P::fields([&](const std::string&,
                  auto& a) { a = random_columns<double>(a.rows(), a.cols(), seed++); },
              r);
    return r;
}

template <class A>
auto some_parameters() {
    using P = typename A::template Parameters<double>;
    return A::template init<P>(channels, points, Random{5, 0});
}

/// <J v, w> = <v, J^T w> for the parameters, J v by duals, and by central differences.
template <class A>
void check_appearance() {
    using P = typename A::template Parameters<double>;
    const P p = some_parameters<A>();
    const Eyes eyes(0.2, -0.4);
    const Columns<double> w = random_columns<double>(channels, points, 11);
    const P v = random_like_fields(p, 21);
    auto dual =
        A::template init<typename A::template Parameters<D>>(channels, points, Random{5, 0});
    lift_fields(dual, p, v);
    const Columns<D> lifted_features = features_of<A, D>(dual, eyes);
    CHECK((values(lifted_features) - features_of<A, double>(p, eyes)).norm() < 1e-12);
    const Columns<double> moved = tangents(lifted_features);

    P grad = zeros_like(p);
    const VecX<double> none;
    A::features_vjp(Serially{}, p,
                    EyeInputs<double>{eyes.position, left_points, none, eyes.gaze, none},
                    ColumnsView<double>(w), grad);
    DotProducts dots;
    dots.add_forward(moved, w);
    dots.add_reverse_fields(grad, v);
    CHECK(dots.terms > 0.1);
    CHECK(dots.error() < 1e-12);

    constexpr double h = 1e-6;
    const auto stepped = [&](double by) {
        P at = p;
        P::fields([&](const std::string&, auto& a, const auto& d) { a += by * d; }, at, v);
        return features_of<A, double>(at, eyes);
    };
    const Columns<double> difference = (stepped(h) - stepped(-h)) / (2 * h);
    CHECK((difference - moved).norm() < 1e-6 * moved.norm());
}

template <class A>
double change_by_gaze() {
    const auto p = some_parameters<A>();
    return (features_of<A, double>(p, Eyes(0.2, -0.4)) - features_of<A, double>(p, Eyes(0.2, 0.4)))
        .norm();
}

} // namespace

TEST_CASE("features that follow the gaze: gradients agree with duals and differences") {
    check_appearance<RotatedFeatures>();
    check_appearance<ConditionedFeatures>();
    check_appearance<RotatedCode>();
}

TEST_CASE("features that follow the gaze: each eye by its own") {
    CHECK(change_by_gaze<FreeFeatures>() == 0);
    CHECK(change_by_gaze<RotatedFeatures>() > 0.1);
    CHECK(change_by_gaze<ConditionedFeatures>() > 0.1);
    CHECK(change_by_gaze<RotatedCode>() > 0.01);
    const auto p = some_parameters<RotatedFeatures>();
    Eyes one(0.2, -0.4), other = one;
    other.gaze.col(1) = direction(0.5, 0.1);
    const Columns<double> a = features_of<RotatedFeatures, double>(p, one);
    const Columns<double> b = features_of<RotatedFeatures, double>(p, other);
    CHECK(a.leftCols(left_points) == b.leftCols(left_points));
    CHECK((a - b).rightCols(points - left_points).norm() > 0.05);
}

TEST_CASE("rotated features: at rest they are the map of the latent as stored") {
    const auto p = some_parameters<RotatedFeatures>();
    Eyes rest(0, 0);
    rest.gaze = Vec3<double>(0, 0, 1).replicate(1, 2);
    const Columns<double> map = mlp_forward(Serially{}, p.map, p.latent, VecX<double>(), nullptr);
    CHECK((features_of<RotatedFeatures, double>(p, rest) - map).norm() < 1e-12);
    // A length of a triplet is no matter of the gaze: the latent of a point turns as one.
    Columns<double> turned = p.latent;
    detail::rotate_triplets<double>(
        quat_matrix(shortest_arc(Vec3<double>(0, 0, 1), direction(0.3, 0.2))), turned);
    CHECK((turned - p.latent).norm() > 0.1);
    for (Index k = 0; k < RotatedFeatures::latent_size; k += 3)
        CHECK(turned.middleRows(k, 3).colwise().norm().isApprox(
            p.latent.middleRows(k, 3).colwise().norm(), 1e-12));
}

TEST_CASE("a gaze that is not finite is refused by each appearance") {
    Eyes bad(0, 0);
    bad.gaze(1, 1) = std::nan("");
    const auto refuses = [&]<class A>(A) {
        CHECK_THROWS_AS((features_of<A, double>(some_parameters<A>(), bad)), Error);
    };
    refuses(RotatedFeatures{});
    refuses(ConditionedFeatures{});
    refuses(RotatedCode{});
}

TEST_CASE("fixed eye: no gaze turns it") {
    const FixedEye::Parameters<double> none;
    FixedEye::Parameters<double> grad;
    CHECK(FixedEye::turn(none, 0, direction(0.3, 0.4)) == quat_identity<double>());
    CHECK(FixedEye::turn_vjp(none, 0, direction(0.3, 0.4), Quat<double>(1, 2, 3, 4), grad).norm() ==
          0);
}

TEST_CASE("learned quaternion: no rotation at the start, a unit quaternion always") {
    using P = LearnedQuaternion::Parameters<double>;
    P p = LearnedQuaternion::init<P>(channels, Random{7, 0});
    CHECK((LearnedQuaternion::turn(p, 1, direction(0.3, 0.4)) - quat_identity<double>()).norm() ==
          0);
    p = random_like_fields(p, 31);
    const Quat<double> left = LearnedQuaternion::turn(p, 0, direction(0.3, 0.4));
    CHECK(std::abs(left.norm() - 1) < 1e-12);
    CHECK((left - LearnedQuaternion::turn(p, 1, direction(0.3, 0.4))).norm() > 1e-3);
}

TEST_CASE("learned quaternion: gradients agree with duals and differences") {
    using P = LearnedQuaternion::Parameters<double>;
    P p = LearnedQuaternion::init<P>(channels, Random{7, 0});
    const P v = random_like_fields(p, 41);
    P::fields([](const std::string&, auto& a, const auto& d) { a += 0.1 * d; }, p,
              random_like_fields(p, 51));
    const Vec3<double> gaze = direction(0.2, -0.3), v_gaze(0.3, -0.5, 0.2);
    const Quat<double> w(0.4, -0.7, 0.2, 0.9);
    auto dual = LearnedQuaternion::init<LearnedQuaternion::Parameters<D>>(channels, Random{7, 0});
    lift_fields(dual, p, v);
    Vec3<D> dual_gaze;
    for (int k = 0; k < 3; ++k) {
        dual_gaze[k] = D(gaze[k]);
        dual_gaze[k].d[0] = v_gaze[k];
    }
    const Quat<D> moved = LearnedQuaternion::turn(dual, 1, dual_gaze);
    Vec4<double> tangent;
    for (int k = 0; k < 4; ++k) tangent[k] = moved[k].d[0];

    P grad = zeros_like(p);
    const Vec3<double> g_gaze = LearnedQuaternion::turn_vjp(p, 1, gaze, w, grad);
    DotProducts dots;
    dots.add_forward(tangent, w);
    dots.add_reverse_fields(grad, v);
    dots.add_reverse(g_gaze, v_gaze);
    CHECK(dots.error() < 1e-12);

    constexpr double h = 1e-6;
    const auto stepped = [&](double by) {
        P at = p;
        P::fields([&](const std::string&, auto& a, const auto& d) { a += by * d; }, at, v);
        return LearnedQuaternion::turn(at, 1, Vec3<double>(gaze + by * v_gaze));
    };
    const Vec4<double> difference = (stepped(h) - stepped(-h)) / (2 * h);
    CHECK((difference - tangent).norm() < 1e-6 * tangent.norm());
}
