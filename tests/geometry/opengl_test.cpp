// SPDX-License-Identifier: Apache-2.0
// Cameras of OpenGL's matrices: against GLM's own matrices and its own projection to the window
// where GLM is, against matrices written down here everywhere; wrong matrices are named.
#include <rye/geometry/opengl.hpp>

#include <array>
#include <cstdio>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>

#include "../support/hostile.hpp"

#if __has_include(<glm/glm.hpp>)
#define RYE_TEST_GLM
#include <glm/ext/matrix_clip_space.hpp>
#include <glm/ext/matrix_projection.hpp>
#include <glm/ext/matrix_transform.hpp>
#include <glm/gtc/type_ptr.hpp>
#endif

using namespace rye;

namespace {

using Mat4 = Mat<double, 4, 4>;

/// glFrustum's matrix: the window [l, r] x [b, t] at depth n.
Mat4 frustum(std::array<double, 4> lrbt, double n, double f) {
    const auto [l, r, b, t] = lrbt;
    Mat4 p = Mat4::Zero();
    p(0, 0) = 2 * n / (r - l);
    p(1, 1) = 2 * n / (t - b);
    p(0, 2) = (r + l) / (r - l);
    p(1, 2) = (t + b) / (t - b);
    p(2, 2) = -(f + n) / (f - n);
    p(2, 3) = -2 * f * n / (f - n);
    p(3, 2) = -1;
    return p;
}

/// A turn about x, then y, and a shift.
Mat4 some_view() {
    const double a = 0.4, b = -0.7;
    Mat4 x = Mat4::Identity(), y = Mat4::Identity();
    x.block<2, 2>(1, 1) << std::cos(a), -std::sin(a), std::sin(a), std::cos(a);
    y(0, 0) = y(2, 2) = std::cos(b);
    y(0, 2) = std::sin(b);
    y(2, 0) = -std::sin(b);
    Mat4 v = x * y;
    v.block<3, 1>(0, 3) << 0.3, -0.2, -5;
    return v;
}

/// Returns the place of a point in a window whose rows go down, by the specification's own
/// divisions [px].
Vec2<double> in_window(const Mat4& view, const Mat4& projection, const Vec3<double>& x, int width,
                       int height) {
    Vec4<double> world;
    world << x, 1;
    const Vec4<double> clip = projection * (view * world);
    return {(clip[0] / clip[3] + 1) / 2 * width, (1 - clip[1] / clip[3]) / 2 * height};
}

const std::array<double, 4> off_centre{-0.3, 0.5, -0.25, 0.15};

} // namespace

TEST_CASE("opengl: points are where the matrices put them, on and off the centre") {
    const Mat4 view = some_view(), centred = frustum({-0.4, 0.4, -0.3, 0.3}, 0.5, 50);
    const Mat4 off = frustum(off_centre, 0.5, 50);
    for (const Mat4& projection : {centred, off, Mat4(3 * off)}) {
        const Pinhole<double> c = pinhole_from_opengl<double>(view, projection, 640, 480);
        for (const Vec3<double>& x :
             {Vec3<double>(0, 0, 0), Vec3<double>(1, 0.5, -0.7), Vec3<double>(-0.6, -1.1, 0.9)}) {
            const Vec3<double> p = c.project_point(x);
            const Vec2<double> w = in_window(view, projection, x, 640, 480);
            CHECK(std::abs(p[0] - w[0]) <= 1e-9);
            CHECK(std::abs(p[1] - w[1]) <= 1e-9);
            CHECK(p[2] > 0);
        }
        CHECK(c.near_depth == doctest::Approx(0.5).epsilon(1e-12));
    }
    const Pinhole<double> c = pinhole_from_opengl<double>(view, off, 640, 480);
    CHECK(c.cx == doctest::Approx(640 * 0.3 / 0.8));  // the share of the window left of the axis
    CHECK(c.cy == doctest::Approx(480 * 0.15 / 0.4)); // above it
}

TEST_CASE("opengl: the same camera from every clip range, with its near plane") {
    const Mat4 view = some_view(), gl = frustum(off_centre, 0.5, 50);
    Mat4 zero = gl, reversed = gl, infinite = gl;
    zero(2, 2) = -50 / 49.5, zero(2, 3) = -50 * 0.5 / 49.5;
    reversed(2, 2) = 0.5 / 49.5, reversed(2, 3) = 50 * 0.5 / 49.5;
    infinite(2, 2) = 0, infinite(2, 3) = 0.5;
    const auto a = pinhole_from_opengl<double>(view, gl, 64, 48);
    for (const auto& [projection, clip] :
         {std::pair{zero, ClipDepth::zero_to_one}, std::pair{reversed, ClipDepth::one_to_zero},
          std::pair{infinite, ClipDepth::one_to_zero}}) {
        const auto b = pinhole_from_opengl<double>(view, projection, 64, 48, clip);
        CHECK(b.near_depth == doctest::Approx(0.5).epsilon(1e-12));
        CHECK(b.fx == a.fx);
        CHECK(b.cy == a.cy);
        CHECK(b.camera_from_world.rotation == a.camera_from_world.rotation);
    }
}

TEST_CASE("opengl: what is not a pinhole camera is named") {
    const Mat4 view = some_view(), good = frustum(off_centre, 0.5, 50);
    const auto changed = [](Mat4 m, int i, int j, double x) {
        m(i, j) = x;
        return m;
    };
    const auto camera = [&](const Mat4& v, const Mat4& p,
                            ClipDepth clip = ClipDepth::minus_one_to_one) {
        return pinhole_from_opengl<double>(v, p, 64, 48, clip);
    };
    CHECK_FAULT(pinhole_from_opengl<double>(view, good, 0, 48), "the image is 0 x 48 pixels");
    Mat4 ortho = Mat4::Identity();
    CHECK_FAULT(camera(view, ortho), "this one is orthographic");
    CHECK_FAULT(camera(view, ortho), "(0, 0, 0, 1)");
    CHECK_FAULT(camera(view, Mat4::Zero()), "orthographic");
    CHECK_FAULT(camera(view, changed(good, 3, 2, 1)), "this one is left-handed");
    CHECK_FAULT(camera(view, changed(good, 3, 0, 0.2)), "expected a multiple of (0, 0, -1, 0)");
    CHECK_FAULT(camera(view, changed(good, 0, 1, 0.1)), "projection(0, 1) is 0.1, expected 0");
    CHECK_FAULT(camera(view, changed(good, 1, 0, 0.1)), "no skew");
    CHECK_FAULT(camera(view, changed(good, 0, 3, 2)), "belongs to the view");
    CHECK_FAULT(camera(view, changed(good, 2, 1, 2)), "oblique near plane");
    CHECK_FAULT(camera(view, changed(good, 0, 0, -1)), "mirrored");
    CHECK_FAULT(camera(view, changed(good, 1, 1, -1)), "negate the second row");
    CHECK_FAULT(camera(view, good, ClipDepth::one_to_zero), "near plane of device z 1");
    CHECK_FAULT(camera(view, changed(good, 2, 2, std::nan(""))), "not finite");
    CHECK_FAULT(camera(Mat4(2 * view), good), "view(3, 3) is 2, expected 1");
    CHECK_FAULT(camera(view.transpose(), good), "view(3, 0) is 0.3, expected 0");
    CHECK_FAULT(camera(changed(view, 0, 0, 3), good), "the view scales or shears");
    Mat4 mirror = view;
    mirror.row(0) *= -1;
    CHECK_FAULT(camera(mirror, good), "the view mirrors: determinant -1");
    CHECK_FAULT(camera(changed(view, 1, 3, std::nan("")), good), "the view has a number");
}

#ifdef RYE_TEST_GLM
TEST_CASE("opengl: 1000 of GLM's cameras and its own projection, within 0.001 px in float") {
    const int width = 1920, height = 1080;
    Random random{7, 0};
    std::uint64_t k = 0;
    const auto number = [&](double from, double to) {
        return from + (to - from) * random.uniform(k++);
    };
    double worst = 0, worst_float = 0;
    int seen = 0;
    for (int i = 0; i < 1000; ++i) {
        const glm::dvec3 eye(number(-4, 4), number(-4, 4), number(3, 8));
        const glm::dmat4 view =
            glm::lookAt(eye, glm::dvec3(number(-1, 1), number(-1, 1), 0), glm::dvec3(0.1, 1, 0.05));
        const double n = number(0.05, 1), f = n + number(10, 100), half = n * number(0.3, 0.8);
        const bool off = i % 2 == 1, zero = i % 4 >= 2;
        const double left = -half * (off ? number(0.6, 1.4) : 1), low = off ? -half * 0.3 : -half;
        const glm::dmat4 projection =
            !off ? (zero ? glm::perspectiveRH_ZO(2 * std::atan(half / n), 16.0 / 9, n, f)
                         : glm::perspectiveRH_NO(2 * std::atan(half / n), 16.0 / 9, n, f))
                 : (zero ? glm::frustumRH_ZO(left, half, low, half, n, f)
                         : glm::frustumRH_NO(left, half, low, half, n, f));
        const auto clip = zero ? ClipDepth::zero_to_one : ClipDepth::minus_one_to_one;
        const auto camera = pinhole_from_opengl<double>(
            Eigen::Map<const Mat4>(glm::value_ptr(view)),
            Eigen::Map<const Mat4>(glm::value_ptr(projection)), width, height, clip);
        using Mat4f = Mat<float, 4, 4>;
        const glm::mat4 view_float(view), projection_float(projection);
        const auto camera_float = pinhole_from_opengl<float>(
            Eigen::Map<const Mat4f>(glm::value_ptr(view_float)),
            Eigen::Map<const Mat4f>(glm::value_ptr(projection_float)), width, height, clip);
        CHECK(camera.near_depth == doctest::Approx(n).epsilon(1e-9));
        CHECK(camera_float.near_depth == doctest::Approx(n).epsilon(1e-3));
        for (int j = 0; j < 8; ++j) {
            const glm::dvec3 x(number(-1, 1), number(-1, 1), number(-1, 1));
            const glm::dvec4 port(0, 0, width, height);
            const glm::dvec3 w = zero ? glm::projectZO(x, view, projection, port)
                                      : glm::projectNO(x, view, projection, port);
            const double v = height - w.y; // GLM's rows go up
            if (w.x < 0 || w.x > width || v < 0 || v > height) continue;
            ++seen;
            const Vec3<double> p = camera.project_point(Vec3<double>(x.x, x.y, x.z));
            worst = std::max({worst, std::abs(p[0] - w.x), std::abs(p[1] - v)});
            const Vec3<float> q = camera_float.project_point(Vec3<float>(
                static_cast<float>(x.x), static_cast<float>(x.y), static_cast<float>(x.z)));
            worst_float =
                std::max({worst_float, std::abs(double(q[0]) - w.x), std::abs(double(q[1]) - v)});
        }
    }
    std::printf(
        "opengl: %d points of GLM's %d x %d windows: largest difference %.1e px in double, "
        "%.1e px in float\n",
        seen, width, height, worst, worst_float);
    REQUIRE(seen > 1000);
    CHECK(worst <= 1e-9);
    CHECK(worst_float <= 1e-3);
}
#else
TEST_CASE("opengl: GLM's cameras") {
    std::printf("not run: cameras against GLM's matrices, for there is no glm/glm.hpp\n");
}
#endif
