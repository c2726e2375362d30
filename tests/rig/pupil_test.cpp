// SPDX-License-Identifier: Apache-2.0
#include <rye/rig/pupil.hpp>

#include <cmath>
#include <limits>
#include <vector>

#include <doctest/doctest.h>

#include <rye/autodiff/check.hpp>
#include <rye/core/random.hpp>
#include <rye/io/eye_sizes.hpp>

#include "../support/hostile.hpp"

using namespace rye;

namespace {

using V = Vec3<double>;

Iris<double> iris() { return {0.02, 0.06, 0.03}; }

/// f(r) as it is written in the header.
double plain(const Iris<double>& i, double s, double r) {
    if (r <= i.pupil) return s * r;
    if (r > i.limbus) return r;
    return s * i.pupil + (r - i.pupil) / (i.limbus - i.pupil) * (i.limbus - s * i.pupil);
}

V on_iris(const Iris<double>& i, double r, double angle) {
    const double share = r / i.limbus;
    return V(r * std::cos(angle), r * std::sin(angle), 0.09 + i.rise * share * share);
}

template <class T>
PupilMap<T> lifted(const Iris<double>& i, const T& ratio) {
    return {{T(i.pupil), T(i.limbus), T(i.rise)}, ratio};
}

} // namespace

TEST_CASE("pupil: points move along radii by the linear stretch, and stay on the paraboloid") {
    for (const double s : {0.4, 0.7, 1.0, 1.3, 2.0}) {
        double before = -1;
        for (double r = 0; r < 0.08; r += 0.0005) {
            CAPTURE(s);
            CAPTURE(r);
            const V at = PupilMap<double>{iris(), s}(on_iris(iris(), r, 0.7));
            const double f = plain(iris(), s, r);
            CHECK((at - on_iris(iris(), f, 0.7)).norm() < 1e-15);
            CHECK(f > before); // no two points meet
            CHECK(f - before < 0.0005 * 2.01 + (r == 0 ? 1 : 0));
            before = f;
        }
    }
}

TEST_CASE("pupil: at rest no bit changes, nor do the back and what is beyond the limbus") {
    const Random random{5, 0};
    const PupilMap<double> rest{iris(), 1.0}, wide{iris(), 1.7};
    const PupilMap<float> single{{0.02F, 0.06F, 0.03F}, 1.0F};
    int moved = 0;
    for (std::uint64_t k = 0; k < 3000; k += 3) {
        const V p(0.1 * random.uniform(k) - 0.05, 0.1 * random.uniform(k + 1) - 0.05,
                  0.1 * random.uniform(k + 2) - 0.05);
        CHECK(rest(p) == p);
        CHECK(rest.stretch(p) == 1);
        CHECK(single(p.cast<float>()) == p.cast<float>());
        CHECK(single.stretch(p.cast<float>()) == 1);
        const bool iris_point = p[2] > 0 && p.head<2>().norm() < 0.06;
        CHECK((wide(p) != p) == iris_point);
        CHECK((wide.stretch(p) != 1) == iris_point);
        moved += iris_point;
    }
    CHECK(moved > 100);
    CHECK(PupilMap<double>{{}, 1.7}(V(0, 0, 0.1)) == V(0, 0, 0.1));
}

TEST_CASE("pupil: sizes along the surface grow as its area in the iris' plane does, by duals") {
    using D = Dual<double, 3>;
    const Random random{6, 0};
    for (std::uint64_t k = 0; k < 400; k += 3) {
        const double s = 0.4 + 1.6 * random.uniform(k);
        const double r = 0.0005 + 0.059 * random.uniform(k + 1);
        const V p = on_iris(iris(), r, 6 * random.uniform(k + 2));
        Vec3<D> x;
        for (int i = 0; i < 3; ++i) x[i] = D::variable(p[i], i);
        const Vec3<D> y = lifted<D>(iris(), D(s))(x);
        const double area = y[0].d[0] * y[1].d[1] - y[0].d[1] * y[1].d[0];
        const double by = PupilMap<double>{iris(), s}.stretch(p);
        CHECK(by * by == doctest::Approx(area).epsilon(1e-12));
    }
}

TEST_CASE("pupil: duals are the derivatives by the point and the ratio, at rest too") {
    const Random random{7, 0};
    for (std::uint64_t k = 0; k < 200; ++k) {
        const double s = k % 5 == 0 ? 1 : 0.4 + 1.6 * random.uniform(3 * k);
        Columns<double> x(4, 1);
        const double r = 0.001 + 0.058 * random.uniform(3 * k + 1);
        x << on_iris(iris(), r, 6 * random.uniform(3 * k + 2)), s;
        if (std::abs(x.col(0).head<2>().norm() - 0.02) < 1e-4) continue; // its edge has two slopes
        const auto f = [&](const auto& c) {
            using S = typename std::decay_t<decltype(c)>::Scalar;
            const PupilMap<S> map = lifted<S>(iris(), c(3, 0));
            const Vec3<S> at(c(0, 0), c(1, 0), c(2, 0));
            Columns<S> y(4, 1);
            const Vec3<S> moved = map(at);
            y << moved[0], moved[1], moved[2], map.stretch(at);
            return y;
        };
        using D = Dual<double, 1>;
        const Columns<double> dx = 0.01 * random_columns<double>(4, 1, Random{8, k});
        const double h = 1e-5;
        const Columns<double> by_difference = (f(Columns<double>(x + h * dx)) -
                                               f(Columns<double>(x - h * dx))) / (2 * h);
        const Columns<D> by_dual = f(detail::seeded(x, dx));
        for (Index i = 0; i < 4; ++i)
            CHECK(by_dual(i, 0).d[0] ==
                  doctest::Approx(by_difference(i, 0)).epsilon(1e-6).scale(0.01));
    }
}

TEST_CASE("pupil: the iris is found in the points of every shape that training gives an eyeball") {
    for (const double radius : {0.11, 0.12, 0.14})
        for (const double limbus : {0.45, 0.49, 0.55})
            for (const double plane : {0.8, 0.87, 0.95})
                for (const IrisSurface surface : {IrisSurface::plane, IrisSurface::bulge})
                    for (const int rings : {4, 16, 40}) {
                        BasicEyeballShape<PaperEffects> shape =
                            eyeball_shape({radius, limbus * radius, plane * radius}, surface);
                        shape.iris_rings = rings;
                        const Columns<float> points = eyeball_template<float>(shape).points;
                        const Iris<float> found = iris_of_points<float>(points);
                        const double rise = shape.limbus_plane() - shape.iris(0);
                        CAPTURE(limbus);
                        CAPTURE(plane);
                        CAPTURE(rings);
                        CHECK(double(found.pupil) ==
                              doctest::Approx(shape.pupil_radius * (1 - 1e-4)).epsilon(1e-5));
                        CHECK(double(found.limbus) ==
                              doctest::Approx(shape.limbus_radius * (1 - 1e-4)).epsilon(1e-5));
                        CHECK(std::abs(double(found.rise) - rise) < 1e-6);
                        // The limbus and all beyond it stay.
                        const PupilMap<float> wide{found, 1.7F};
                        for (Index i = 0; i < points.cols(); ++i) {
                            const Vec3<float> p = points.col(i);
                            const double r = double(p.head<2>().norm());
                            const bool stays = p.z() < 0 || r > 0.999 * shape.limbus_radius;
                            CHECK((wide(p) == p && wide.stretch(p) == 1) == stays);
                        }
                    }
}

TEST_CASE("pupil: a sphere without an iris, and no points, have the zero iris") {
    using Sphere = Effects<LeftGaze>;
    const EyeballTemplate<double> ball = eyeball_template<double>(BasicEyeballShape<Sphere>{});
    CHECK(iris_of_points<double>(ball.points).limbus == 0);
    CHECK(iris_of_points<double>(Columns<double>(3, 0)).limbus == 0);
    CHECK(iris_of_points<double>(ball.points.leftCols(30)).limbus == 0);
}

TEST_CASE("pupil: a ratio out of range is refused in words, and an eye without an iris") {
    CHECK(pupil_map<float>(0, {0.02F, 0.06F, 0}, 2.0F).ratio == 2.0F);
    CHECK_FAULT(pupil_map<double>(0, iris(), 0.39),
                "pupil: got the ratio 0.39 for the left eye, expected 0.4 to 2, 1 at rest");
    CHECK_FAULT(pupil_map<double>(1, iris(), 2.5),
                "pupil: got the ratio 2.5 for the right eye, expected 0.4 to 2, 1 at rest");
    CHECK_FAULT(pupil_map<double>(1, iris(), std::numeric_limits<double>::quiet_NaN()),
                "pupil: got the ratio nan for the right eye, expected 0.4 to 2, 1 at rest");
    CHECK_FAULT(pupil_map<double>(0, {0.03, 0.06, 0}, 2.0),
                "pupil: got the ratio 2, at which the left pupil reaches the limbus");
    CHECK_FAULT(pupil_map<double>(1, {}, 1.5),
                "pupil: the points of the right eye have no iris apart from a sphere, expected "
                "those of eyeball_template");
    CHECK(pupil_map<double>(1, {}, 1.0).ratio == 1);
}
