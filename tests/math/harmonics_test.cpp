// SPDX-License-Identifier: Apache-2.0
#include <rye/math/harmonics.hpp>

#include <doctest/doctest.h>

#include <numbers>

#include <rye/autodiff/check.hpp>
#include <rye/backend/lanes.hpp>

#include "../support/lane_samples.hpp"

using namespace rye;
using std::numbers::pi;

TEST_CASE("harmonics: orthonormal on the sphere") {
    // Gauss-Legendre in z and equal steps in azimuth: exact for products of two degrees 4.
    const double node[] = {0, 0.5384693101056831, -0.5384693101056831, 0.9061798459386640,
                           -0.9061798459386640};
    const double weight[] = {0.5688888888888889, 0.4786286704993665, 0.4786286704993665,
                             0.2369268850561891, 0.2369268850561891};
    Columns<double> products = Columns<double>::Zero(25, 25);
    for (int i = 0; i < 5; ++i)
        for (int k = 0; k < 16; ++k) {
            const double r = std::sqrt(1 - node[i] * node[i]), a = 2 * pi * k / 16;
            const Vec3<double> d(r * std::cos(a), r * std::sin(a), node[i]);
            const VecX<double> b = sh_basis<double>(4, d);
            products += (weight[i] * 2 * pi / 16) * b * b.transpose();
        }
    CHECK((products - Columns<double>::Identity(25, 25)).cwiseAbs().maxCoeff() <= 1e-14);
}

TEST_CASE("harmonics: order and signs are those of 3D Gaussian Splatting") {
    const ShArray<double, 3> y = sh_basis<double, 3>(Vec3<double>(0, 1, 0));
    const ShArray<double, 3> z = sh_basis<double, 3>(Vec3<double>(0, 0, 1));
    const ShArray<double, 3> x = sh_basis<double, 3>(Vec3<double>(1, 0, 0));
    CHECK(y[0] == doctest::Approx(0.28209479));
    CHECK(y[1] == doctest::Approx(-0.48860251));
    CHECK(z[2] == doctest::Approx(0.48860251));
    CHECK(x[3] == doctest::Approx(-0.48860251));
    CHECK(z[6] == doctest::Approx(0.63078313));
    CHECK(x[8] == doctest::Approx(0.54627421));
    CHECK(z[12] == doctest::Approx(0.74635267));
    CHECK(y[9] == doctest::Approx(0.59004359));
    CHECK(x[15] == doctest::Approx(-0.59004359));
}

TEST_CASE("harmonics: turning both directions changes no band's product (E3)") {
    for (std::uint64_t i = 0; i < 200; ++i) {
        const Vec3<float> a = unit_vec<float, 3>(i), b = unit_vec<float, 3>(i, 2);
        const Mat3<float> r = quat_matrix(unit_vec<float, 4>(i, 3));
        const VecX<float> before = sh_basis<float>(4, a).cwiseProduct(sh_basis<float>(4, b));
        const VecX<float> after = sh_basis<float>(4, Vec3<float>(r * a))
                                      .cwiseProduct(sh_basis<float>(4, Vec3<float>(r * b)));
        for (int l = 0; l <= 4; ++l)
            CHECK(std::abs(before.segment(l * l, 2 * l + 1).sum() -
                           after.segment(l * l, 2 * l + 1).sum()) <= 4e-6f);
    }
}

TEST_CASE("harmonics: no direction leaves the constant band alone, with derivative 0 (E1)") {
    const Vec3<float> none = Vec3<float>::Zero();
    const VecX<float> b = sh_basis<float>(4, normalized(none));
    CHECK(b[0] == doctest::Approx(0.28209479));
    CHECK(b.tail(24).cwiseAbs().maxCoeff() == 0);
    const Vec3<float> g = sh_basis_vjp<float>(4, none, VecX<float>::Ones(25));
    CHECK(normalized_vjp(none, g) == none);
}

TEST_CASE("harmonics: through the normalisation of short and long vectors (E2)") {
    for (const float scale : {1e-18f, 1e-8f, 1.0f, 1e8f, 1e18f}) {
        const Vec3<float> d = unit_vec<float, 3>(4), x = d * scale;
        const Vec3<float> g = sh_basis_vjp<float>(3, normalized(x), VecX<float>::Ones(16));
        const Vec3<float> gx = normalized_vjp(x, g), expected = normalized_vjp(d, g) / scale;
        CHECK((gx - expected).norm() <= 1e-5f * expected.norm());
    }
}

TEST_CASE_TEMPLATE("harmonics: adjoint", T, float, double) {
    const double tolerance = std::is_same_v<T, double> ? 1e-14 : 2e-6;
    for (int degree = 0; degree <= 4; ++degree) {
        const auto f = [&](const auto& x) {
            using S = typename std::decay_t<decltype(x)>::Scalar;
            Columns<S> y(sh_count(degree), x.cols());
            for (Index i = 0; i < x.cols(); ++i)
                y.col(i) = sh_basis<S>(degree, Vec3<S>(x(0, i), x(1, i), x(2, i)));
            return y;
        };
        const Columns<T> x = random_columns<T>(3, 30, {1});
        const auto vjp = [&](const Columns<T>& w) {
            Columns<T> g(3, x.cols());
            for (Index i = 0; i < x.cols(); ++i) {
                const Vec3<T> xi = x.template block<3, 1>(0, i);
                g.template block<3, 1>(0, i) = sh_basis_vjp<T>(degree, xi, VecX<T>(w.col(i)));
            }
            return g;
        };
        const Columns<T> dx = random_columns<T>(3, 30, {2});
        const Columns<T> w = random_columns<T>(sh_count(degree), 30, {3});
        CHECK(detail::dot_product_test(f, vjp, x, dx, w) <= tolerance);
    }
}

TEST_CASE("harmonics: lanes, and counts that are no degree") {
    using Batch = XsimdBackend<>::batch<float>;
    const auto d = [](std::size_t l) { return unit_vec<float, 3>(l); };
    const ShArray<Batch, 4> b = sh_basis<Batch, 4>(lanes_of<Batch, 3>(d));
    for (std::size_t k = 0; k < 25; ++k)
        for (std::size_t l = 0; l < Batch::size; ++l)
            CHECK(std::abs(b[k].get(l) - sh_basis<float, 4>(d(l))[k]) <= 2e-6f);
    CHECK(sh_degree(25) == 4);
    CHECK_THROWS_AS(sh_degree(10), Error);
    CHECK_THROWS_AS(sh_basis<float>(5, Vec3<float>(1, 0, 0)), Error);
}
