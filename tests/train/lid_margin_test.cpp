// SPDX-License-Identifier: Apache-2.0
// Gaussians on the lids' margins: where they begin, and that they go where a lid goes.
#include <rye/train/lid_margin.hpp>

#include <cmath>
#include <vector>

#include <doctest/doctest.h>

#include <rye/avatar/hold.hpp>
#include <rye/io/eye_sizes.hpp>
#include <rye/train/fit_deformation.hpp>
#include <rye/train/initialize.hpp>

#include "../support/tiny_mesh.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using B = ScalarBackend<>;
using Points = Columns<double>;

constexpr double spacing = 0.01;

Points eye_centres() {
    Points c(3, 2);
    c << 0.3, -0.3, 0.3, 0.3, 0.8, 0.8;
    return c;
}
constexpr double radius = 0.12;

/// Landmarks with two open eyes before eyeballs of that radius, one the other's mirror image.
Points open_eyes() {
    Draw draw;
    Points l = tiny_landmarks(draw);
    for (Index k = 0; k < 6; ++k) { // from the corner by the nose, by the upper lid
        const double x[] = {-0.14, -0.05, 0.05, 0.12, 0.05, -0.05},
                     y[] = {-0.01, 0.045, 0.05, 0.01, -0.04, -0.045};
        const Index right[] = {39, 38, 37, 36, 41, 40};
        const double z = 0.8 + std::sqrt(0.17 * 0.17 - x[k] * x[k] - y[k] * y[k]);
        l.col(42 + k) << 0.3 + x[k], 0.3 + y[k], z;
        l.col(right[k]) << -0.3 - x[k], 0.3 + y[k], z;
    }
    return l;
}

double distance_to(const Points& line, const Vec3<double>& p) {
    return std::sqrt((line.colwise() - p).colwise().squaredNorm().minCoeff());
}

struct Subject {
    AvatarConfig config = tiny_config();
    GuidanceMesh<double> mesh = tiny_mesh();
    AvatarInit<double> init;

    Subject() {
        config.networks.exp_deform = {24, 24};
        mesh.landmarks = open_eyes();
        mesh.networks.exp_deform = FaceNetworks<double>::init(config, Random{5, 0}).exp_deform;
        init.grid = tiny_grid();
        init.mouth_points = 9;
        init.eye_centre = eye_centres();
        for (auto& eye : init.eyeball) {
            eye = eyeball_shape({radius, 0.4 * radius, 0.9 * radius});
            eye.iris_rings = eye.sclera_rings = eye.back_rings = 3;
        }
    }
    TwoStream<double> avatar(double lid_margin) const {
        AvatarInit<double> with = init;
        with.lid_margin = lid_margin;
        return initialize_avatar<double>(B{}, mesh, config, with, Random{3, 0});
    }
    /// The face's means in the head's frame, by the first expression coefficient.
    Points driven(const TwoStream<double>& a, double closed) const {
        Drivers<double> d = tiny_drivers<double>();
        d.expression = Vec3<double>(closed, 0, 0);
        d.pose.setZero();
        d.scale = 1;
        TwoStreamTrace<double> trace;
        const LandmarkRoles roles = tiny_roles();
        drive(B{}, a, {config, roles, d}, trace);
        return trace.gaussians.mean.leftCols(a.face.position.cols());
    }
};

} // namespace

TEST_CASE("lid margin: a smooth line goes through its points, at one spacing") {
    Points through(3, 4);
    through << 0, 1, 2, 3, 0, 0.8, 0.7, 0, 0, 0.1, 0, 0.2;
    const Points line = detail::smooth_line<double>(through, 0.02);
    for (Index k = 0; k < 4; ++k) CHECK(distance_to(line, through.col(k)) <= 0.0101);
    CHECK(line.col(0) == through.col(0));
    CHECK((line.col(line.cols() - 1) - through.col(3)).norm() < 1e-12);
    for (Index i = 0; i + 1 < line.cols(); ++i) {
        const double step = (line.col(i + 1) - line.col(i)).norm();
        CHECK(step <= 0.0201);
        CHECK(step >= 0.018);
    }
    // Between two points it is above their chord, as the points beside them are below it.
    CHECK(line.row(1).maxCoeff() > 0.81);
    Points one(3, 2);
    one << 1, 1, 0, 0, 0, 0; // both the same
    CHECK(detail::smooth_line<double>(one, 0.1).cols() == 2);
}

TEST_CASE("lid margin: rows beside both lids' lines, and the caruncle between them at the nose") {
    const Points landmarks = open_eyes();
    const LidMargin<double> margin = lid_margin_points<double>(landmarks, eye_centres(), spacing);
    CHECK(margin.left > 0);
    CHECK(margin.points_of(0) == margin.points_of(1));
    for (int eye = 0; eye < 2; ++eye) {
        const LidLines<double> fine = lid_lines<double>(landmarks, eye, spacing / 20),
                               lids = lid_lines<double>(landmarks, eye, spacing);
        const Vec3<double> corner = landmarks.col(eye == 0 ? 42 : 39);
        CHECK(lids.upper.col(0) == corner);
        CHECK(lids.lower.col(0) == corner);
        CHECK(fine.upper.row(1).mean() > fine.lower.row(1).mean() + 0.05);
        const Points own = margin.points.middleCols(eye == 0 ? 0 : margin.left, margin.left);
        const Index rows = lid_margin_rows * (lids.upper.cols() + lids.lower.cols());
        CHECK(own.cols() > rows);
        for (Index i = 0; i < own.cols(); ++i) {
            const double near =
                std::min(distance_to(fine.upper, own.col(i)), distance_to(fine.lower, own.col(i)));
            if (i < rows)
                CHECK(near <= 1.05 * spacing);
            else
                CHECK((Vec3<double>(own.col(i)) - corner).norm() < 1.5 * caruncle_length);
        }
        // No gap along a line, and a row on both sides of it.
        for (const Points* line : {&fine.upper, &fine.lower})
            for (Index k = 0; k < line->cols(); ++k)
                CHECK(distance_to(own, line->col(k)) <= 0.51 * spacing);
        const Index n = lids.upper.cols(), middle = n / 2;
        const double across = own(1, 2 * n + middle) - own(1, middle);
        CHECK(across == doctest::Approx(-2 * spacing).epsilon(0.1)); // the last is the lower
    }
    // Twice as far apart a quarter as many, about.
    const auto coarse = lid_margin_points<double>(landmarks, eye_centres(), 2 * spacing);
    CHECK(coarse.points.cols() < 0.6 * double(margin.points.cols()));
    // The right eye's are the mirror image of the left eye's.
    Points mirrored = margin.points.leftCols(margin.left);
    mirrored.row(0) = -mirrored.row(0);
    CHECK((mirrored - margin.points.rightCols(margin.left)).norm() < 1e-9);
}

TEST_CASE(
    "lid margin: the face gets small Gaussians like the skin beside them, and none when off") {
    const Subject s;
    const TwoStream<double> off = s.avatar(0), on = s.avatar(spacing);
    const Index n = off.face.position.cols(), all = on.face.position.cols();
    const Points wanted =
        lid_margin_points<double>(s.mesh.landmarks, s.init.eye_centre, spacing).points;
    REQUIRE(all == n + wanted.cols());
    CHECK(on.face.position.leftCols(n) == off.face.position);
    CHECK(on.face.log_scale.leftCols(n) == off.face.log_scale);
    CHECK(on.face.feature.leftCols(n) == off.face.feature);
    CHECK(on.face.opacity_logit.leftCols(n) == off.face.opacity_logit);
    CHECK(on.eyes.position == off.eyes.position);
    CHECK(on.face.feature.rightCols(all - n).cwiseAbs().maxCoeff() > 0);
    for (Index i = n; i < all; ++i) {
        const Vec3<double> p = on.face.position.col(i);
        CHECK(on.face.log_scale(1, i) == doctest::Approx(std::log(spacing)));
        for (Index eye = 0; eye < 2; ++eye)
            CHECK((p - Vec3<double>(s.init.eye_centre.col(eye))).norm() > 1.02 * radius);
        CHECK((p - Vec3<double>(wanted.col(i - n))).norm() < 1e-9); // all were before the eyeballs
    }
    Subject large = s;
    for (auto& eye : large.init.eyeball) eye = eyeball_shape({0.2, 0.08, 0.18});
    const Points before = large.avatar(spacing).face.position.rightCols(all - n);
    for (Index i = 0; i < before.cols(); ++i) {
        const Vec3<double> centre = s.init.eye_centre.col(before(0, i) > 0 ? 0 : 1);
        CHECK((Vec3<double>(before.col(i)) - centre).norm() > 0.201);
    }
}

TEST_CASE("lid margin: a lid that an expression closes takes its margin along") {
    Subject s;
    Points closed = s.mesh.landmarks;
    for (const auto& [upper, lower] : {std::pair{37, 41}, {38, 40}, {43, 47}, {44, 46}})
        closed.col(upper) = s.mesh.landmarks.col(lower);
    std::vector<MeshSample<double>> frames(3);
    for (int f = 0; f < 3; ++f) {
        MeshSample<double>& frame = frames[std::size_t(f)];
        frame.drivers = tiny_drivers<double>();
        frame.drivers.pose.setZero();
        frame.drivers.scale = 1;
        frame.drivers.expression = Vec3<double>(0.5 * f, 0, 0);
        frame.landmarks = s.mesh.landmarks + 0.5 * f * (closed - s.mesh.landmarks);
        frame.eye_displacement = Points::Zero(3, 2);
    }
    DeformationFit fit{1200, 2, 5e-3, Random{1, 0}};
    fit.lids = 10;
    fit_deformation<double>(B{}, s.mesh, {s.config, tiny_roles(), true}, frames, fit);
    const TwoStream<double> avatar = s.avatar(spacing);
    const Points open = s.driven(avatar, 0), shut = s.driven(avatar, 1);
    const LidMargin<double> margin =
        lid_margin_points<double>(s.mesh.landmarks, s.init.eye_centre, spacing);
    const Index first = open.cols() - margin.points.cols();
    for (int eye = 0; eye < 2; ++eye) {
        const LidLines<double> lids = lid_lines<double>(s.mesh.landmarks, eye, spacing);
        const Index begin = first + (eye == 0 ? 0 : margin.left), n = lids.upper.cols(),
                    upper = begin + n + n / 2, // of the middle row
            lower = begin + lid_margin_rows * n + lids.lower.cols() + lids.lower.cols() / 2;
        const auto gap = [&](const Points& at) { return at(1, upper) - at(1, lower); };
        CHECK(gap(open) > 0.07);
        CHECK(gap(shut) < 0.3 * gap(open));
        CHECK(std::abs(shut(1, lower) - open(1, lower)) < 0.3 * gap(open));
    }
}
