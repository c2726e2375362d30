// SPDX-License-Identifier: Apache-2.0
#include <rye/geometry/camera.hpp>

#include <doctest/doctest.h>

#include <rye/autodiff/dual.hpp>
#include <rye/backend/lanes.hpp>
#include <rye/math/rotation.hpp>

using namespace rye;

namespace {

Pinhole<double> oblique() {
    Pinhole<double> c = look_at<double>({1, 2, 5}, {0.1, -0.2, 0.3}, {0, 1, 0}, 0.6, {640, 480});
    c.fx = 700, c.fy = 650, c.cx = 300.5, c.cy = 251.25;
    return c;
}

template <class C>
concept HasCameraShape = Camera<C>;

struct NoRay {
    using scalar = float;
    int width, height;
    Vec3<float> project_point(const Vec3<float>& x) const { return x; }
    Vec3<float> centre() const { return {}; }
};
static_assert(HasCameraShape<Pinhole<double>> && !HasCameraShape<NoRay>);

} // namespace

TEST_CASE("camera: x right, y down, z forward; facing a head its left is on the right") {
    const Pinhole<double> c = look_at<double>({0, 0, 5}, {0, 0, 0}, {0, 1, 0}, 0.5, {64, 48});
    const Vec3<double> middle = c.project_point(Vec3<double>(0, 0, 0));
    CHECK(middle[0] == doctest::Approx(32));
    CHECK(middle[1] == doctest::Approx(24));
    CHECK(middle[2] == doctest::Approx(5));
    CHECK(c.project_point(Vec3<double>(1, 0, 0))[0] > 32);  // the subject's left
    CHECK(c.project_point(Vec3<double>(0, 1, 0))[1] < 24);  // up
    CHECK((c.centre() - Vec3<double>(0, 0, 5)).norm() <= 1e-14);
    // The field of view spans the height.
    const double top = 5 * std::tan(0.25);
    CHECK(c.project_point(Vec3<double>(0, top, 0))[1] == doctest::Approx(0).epsilon(1e-12));
    CHECK(c.near_depth == 0.01);
}

TEST_CASE("camera: a golden projection") {
    Pinhole<double> c;
    c.fx = 100, c.fy = 200, c.cx = 10, c.cy = 20;
    const Vec3<double> p = c.project_point(Vec3<double>(0.5, -0.25, 2));
    CHECK(p[0] == 35);
    CHECK(p[1] == -5);
    CHECK(p[2] == 2);
}

TEST_CASE("camera: a ray goes through the points that project to its pixel") {
    const Pinhole<double> c = oblique();
    for (const double depth : {0.02, 1.0, 30.0}) {
        const Vec2<double> pixel(123.4, 410.7);
        const Vec3<double> d = c.ray(pixel);
        CHECK(d.norm() == doctest::Approx(1));
        const Vec3<double> p = c.project_point(Vec3<double>(c.centre() + depth * d));
        CHECK(p[0] == doctest::Approx(pixel[0]).epsilon(1e-11));
        CHECK(p[1] == doctest::Approx(pixel[1]).epsilon(1e-11));
        CHECK(p[2] > 0);
    }
}

TEST_CASE("camera: half the size halves every pixel coordinate; odd sizes keep the whole view") {
    const Pinhole<double> c = oblique(), half = scaled(c, 0.5), odd = scaled(c, 1.0 / 7);
    CHECK(half.width == 320);
    CHECK(half.fx == c.fx / 2);
    CHECK(half.cy == c.cy / 2);
    CHECK(odd.width == 91);
    const Vec3<double> x(0.3, 0.1, -0.2), p = c.project_point(x);
    CHECK(half.project_point(x)[0] == doctest::Approx(p[0] / 2).epsilon(1e-13));
    CHECK(odd.project_point(x)[0] == doctest::Approx(p[0] * 91 / 640).epsilon(1e-13));
    CHECK(odd.project_point(x)[1] == doctest::Approx(p[1] * 69 / 480).epsilon(1e-13));
}

TEST_CASE("camera: a crop shifts the principal point, anywhere (A9)") {
    const Pinhole<double> c = oblique();
    Pinhole<double> crop = c;
    crop.cx -= 400, crop.cy -= 300, crop.width = 64, crop.height = 64;
    const Vec3<double> x(0.3, 0.1, -0.2), p = c.project_point(x), q = crop.project_point(x);
    CHECK(q[0] == doctest::Approx(p[0] - 400).epsilon(1e-12));
    CHECK(q[1] == doctest::Approx(p[1] - 300).epsilon(1e-12));
}

TEST_CASE("camera: no bias at a small depth, in float (A10)") {
    Pinhole<float> c;
    c.fx = c.fy = 1000;
    for (const float z : {0.01f, 0.2f, 1.0f, 10.0f}) {
        const float x = 0.37f * z;
        const double truth = 1000.0 * double(x) / double(z);
        CHECK(std::abs(double(c.project_point(Vec3<float>(x, x, z))[0]) / truth - 1) <= 2.4e-7);
    }
}

TEST_CASE("camera: derivatives and lanes by the same formula") {
    const Pinhole<double> c = oblique();
    using D = Dual<double, 3>;
    const Vec3<double> at(0.3, 0.1, -0.2);
    const Vec3<D> x(D::variable(at[0], 0), D::variable(at[1], 1), D::variable(at[2], 2));
    const Vec3<D> p = c.cast<D>().project_point(x);
    for (int k = 0; k < 3; ++k) {
        const Vec3<double> h = 1e-6 * Vec3<double>::Unit(k);
        const Vec3<double> slope = (c.project_point(at + h) - c.project_point(at - h)) / 2e-6;
        for (int i = 0; i < 3; ++i)
            CHECK(std::abs(p[i].d[static_cast<std::size_t>(k)] - slope[i]) <= 1e-6);
    }
    using Batch = XsimdBackend<>::batch<float>;
    const Pinhole<float> f = c.cast<float>();
    const Vec3<Batch> lanes(Batch(0.3f), Batch(0.1f), Batch(-0.2f));
    const Vec3<float> scalar = f.project_point(at.cast<float>());
    const Vec3<Batch> q = f.cast<Batch>().project_point(lanes);
    for (int i = 0; i < 3; ++i) CHECK(std::abs(q[i].get(1) - scalar[i]) <= 1e-4f);
}

TEST_CASE("camera: what cannot be a camera is refused with a reason") {
    using V = Vec3<double>;
    CHECK_THROWS_AS(look_at<double>(V(0, 1, 0), V(0, 0, 0), V(0, 1, 0), 0.5, {8, 8}), Error);
    CHECK_THROWS_AS(look_at<double>(V(0, 1, 0), V(0, 1, 0), V(0, 1, 0), 0.5, {8, 8}), Error);
    CHECK_THROWS_AS(look_at<double>(V(0, 0, 1), V(0, 0, 0), V(0, 1, 0), 3.2, {8, 8}), Error);
    CHECK_THROWS_AS(look_at<double>(V(0, 0, 1), V(0, 0, 0), V(0, 1, 0), 0.5, {0, 8}), Error);
    CHECK_THROWS_AS(scaled(oblique(), 0.0001), Error);
    CHECK_THROWS_AS(scaled(oblique(), std::nan("")), Error);
}
