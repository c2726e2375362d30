// SPDX-License-Identifier: Apache-2.0
#include <rye/math/linalg.hpp>

#include <doctest/doctest.h>

#include <limits>

#include <rye/autodiff/check.hpp>

#include "../support/flush_to_zero.hpp"
#include "../support/lane_samples.hpp"

using namespace rye;

namespace {

constexpr double u = 0x1p-24;

/// The two screen rows of the factor of a needle, in float, at a random angle.
struct Needle {
    Vec3<float> x, y;
};

Needle needle(double length, std::uint64_t i) {
    const Mat3<double> r = quat_matrix(unit_vec<double, 4>(i));
    const Vec3<double> s(length, 1e-3, 1e-3);
    Needle n;
    n.x = r.row(0).transpose().cwiseProduct(s).cast<float>();
    n.y = r.row(1).transpose().cwiseProduct(s).cast<float>();
    return n;
}

} // namespace

TEST_CASE("linalg: determinant of a needle's covariance stays positive and exact (A1)") {
    for (const double length : {10., 100., 1e3, 1e4, 3e4}) {
        double worst = 0;
        for (std::uint64_t i = 0; i < 20000; ++i) {
            const Needle n = needle(length, i);
            const float det = detail::gram_determinant(n.x, n.y, 0.3f);
            const double truth = detail::gram_determinant<double>(n.x.cast<double>(),
                                                                  n.y.cast<double>(), double(0.3f));
            REQUIRE(det > 0);
            worst = std::max(worst, std::abs(double(det) / truth - 1));
        }
        CAPTURE(length);
        CHECK(worst <= 4e-7);
    }
}

TEST_CASE("linalg: the naive determinant fails where Cauchy-Binet does not") {
    int negative = 0;
    for (std::uint64_t i = 0; i < 1000; ++i) {
        const Needle n = needle(1e4, i);
        negative += detail::gram(n.x, n.y, 0.3f).determinant() <= 0;
    }
    CHECK(negative > 200);
}

TEST_CASE("linalg: exponent of a needle, lying and standing (A2)") {
    for (const double length : {10., 100., 300., 1000.}) {
        double worst_power = 0, worst_alpha = 0;
        for (std::uint64_t i = 0; i < 600; ++i) {
            Needle n = needle(length, i);
            if (i % 3 == 1) n.x *= 1e-3f;                       // standing
            if (i % 3 == 2) n.y *= 1e-3f;                       // lying
            const detail::PrecisionFactor<float> f = detail::precision_factor(n.x, n.y, 0.3f);
            const Vec3<double> xd = n.x.cast<double>(), yd = n.y.cast<double>();
            const Sym2<double> s = detail::gram(xd, yd, double(0.3f));
            const double det = detail::gram_determinant(xd, yd, double(0.3f));
            for (std::uint64_t k = 0; k < 100; ++k) {
                const Vec2<double> z = normal_vec<double, 2>(k, i + 7);
                // A point of the ellipse: L z with L the Cholesky factor.
                const double l = std::sqrt(s.xx);
                const float dx = static_cast<float>(l * z[0]);
                const float dy = static_cast<float>(s.xy / l * z[0] + std::sqrt(det / s.xx) * z[1]);
                const double m = s.xy / s.xx, v = double(dy) - m * double(dx);
                const double truth =
                    0.5 * (double(dx) * double(dx) / s.xx + v * v * s.xx / det);
                if (truth > 4.5) continue;
                const double power = 0.5 * double(f.quadratic(dx, dy));
                REQUIRE(power >= 0);
                worst_power = std::max(worst_power, std::abs(power - truth));
                worst_alpha = std::max(worst_alpha, std::abs(std::exp(-power) - std::exp(-truth)));
            }
        }
        CAPTURE(length);
        CAPTURE(worst_power);
        CHECK(worst_power <= 2 * u * (3 * length / std::sqrt(0.3)) * 4);
        CHECK(worst_alpha <= 1e-4);
    }
}

TEST_CASE("linalg: the factor keeps the smallest axis that the covariance loses (A3)") {
    for (const float s : {1e-1f, 1e-2f, 1e-3f, 1e-4f, 1e-5f}) {
        double worst = 0;
        for (std::uint64_t i = 0; i < 4000; ++i) {
            const Mat3<float> r = quat_matrix(unit_vec<float, 4>(i));
            const Vec3<float> axis = r.col(2) * s;
            worst = std::max(worst, std::abs(double(norm(axis)) / double(s) - 1));
        }
        CHECK(worst <= 1e-6);
    }
}

TEST_CASE("linalg: gram matrices agree with the full product") {
    Mat3<double> m;
    m << 1, 2, 3, -4, 5, -6, 7, -8, 0.5;
    const Sym3<double> s = detail::gram(m);
    const Mat3<double> full = m * m.transpose();
    CHECK(s.xx == doctest::Approx(full(0, 0)));
    CHECK(s.xy == doctest::Approx(full(0, 1)));
    CHECK(s.xz == doctest::Approx(full(0, 2)));
    CHECK(s.yy == doctest::Approx(full(1, 1)));
    CHECK(s.yz == doctest::Approx(full(1, 2)));
    CHECK(s.zz == doctest::Approx(full(2, 2)));
    const Sym2<double> t = detail::gram<double>(m.row(0), m.row(1), 0.3);
    CHECK(t.determinant() ==
          doctest::Approx(detail::gram_determinant<double>(m.row(0), m.row(1), 0.3)));
}

TEST_CASE("linalg: the pairing of symmetric matrices carries no half (A18)") {
    // d (d^T S d) for an anisotropic, rotated d: entry xy of the cotangent is 2 dx dy, once.
    const Vec2<double> d(0.7, -1.3);
    const Sym2<double> g{d[0] * d[0], 2 * d[0] * d[1], d[1] * d[1]}, dot_s{0.3, -0.4, 0.9};
    CHECK(pairing(g, dot_s) == doctest::Approx(dot_s.quadratic(d)));
}

TEST_CASE_TEMPLATE("linalg: normalising at every magnitude (C1, E2)", T, float, double) {
    const T lo = std::numeric_limits<T>::min(), hi = std::numeric_limits<T>::max() / T(4);
    for (const T scale : {lo, std::sqrt(lo), T(1e-8), T(1), T(1e8), std::sqrt(hi), hi}) {
        for (std::uint64_t i = 0; i < 100; ++i) {
            Vec3<T> v = unit_vec<T, 3>(i);
            v /= v.cwiseAbs().maxCoeff();
            // With denormals flushed, such entries are 0 on input.
            if (flushed() && scale == lo)
                for (int k = 0; k < 3; ++k) v[k] = std::abs(v[k]) < T(1) ? T(0) : v[k];
            const Vec3<T> x = v * scale;
            const Vec3<T> y = normalized(x);
            const Vec3<T> expected = v.normalized();
            const T eps = std::numeric_limits<T>::epsilon();
            // A denormal entry has fewer digits already on input.
            const T slack = scale == lo ? T(64) : T(4);
            CHECK((y - expected).cwiseAbs().maxCoeff() <= slack * eps);
            if (scale != lo) CHECK(std::abs(norm(x) / scale - v.norm()) <= T(4) * eps);
        }
    }
    const Vec3<T> zero = Vec3<T>::Zero(), g(1, 2, 3);
    CHECK(normalized(zero) == zero);
    CHECK(norm(zero) == T(0));
    CHECK(normalized_vjp(zero, g) == zero);
    const Vec3<T> bad(std::numeric_limits<T>::quiet_NaN(), 1, 2);
    CHECK(std::isnan(normalized(bad)[0]));
}

TEST_CASE("linalg: adjoint of normalising") {
    const auto f = [](const auto& x) {
        auto y = x;
        using S = typename std::decay_t<decltype(x)>::Scalar;
        for (Index i = 0; i < x.cols(); ++i) {
            const Vec3<S> v(x(0, i), x(1, i), x(2, i));
            const Vec3<S> n = normalized(v);
            for (int k = 0; k < 3; ++k) y(k, i) = n[k];
        }
        return y;
    };
    const Columns<double> x = random_columns<double>(3, 50, {1});
    const auto vjp = [&](const Columns<double>& w) {
        Columns<double> g(3, x.cols());
        for (Index i = 0; i < x.cols(); ++i) {
            const Vec3<double> xi = x.col(i), wi = w.col(i);
            const Vec3<double> gi = normalized_vjp(xi, wi);
            g.block<3, 1>(0, i) = gi;
            CHECK(std::abs(dot(xi, gi)) <= 1e-14 * wi.norm());
        }
        return g;
    };
    const Columns<double> dx = random_columns<double>(3, 50, {2});
    const Columns<double> w = random_columns<double>(3, 50, {3});
    CHECK(detail::dot_product_test(f, vjp, x, dx, w) <= 1e-14);
    CHECK(detail::difference_test(f, vjp, x, dx, w) <= 2e-9);
}
