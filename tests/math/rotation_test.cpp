// SPDX-License-Identifier: Apache-2.0
#include <rye/math/rotation.hpp>

#include <doctest/doctest.h>

#include <numbers>

#include <rye/autodiff/check.hpp>
#include <rye/backend/lanes.hpp>

#include "../support/lane_samples.hpp"

using namespace rye;
using std::numbers::pi;

namespace {

/// Angle between two directions, in double.
double angle_between(const Vec3<double>& a, const Vec3<double>& b) {
    return 2 * std::atan2((a - b).norm(), (a + b).norm());
}

template <class T>
double unequal(const Mat3<T>& a, const Mat3<double>& b) {
    return (a.template cast<double>() - b).cwiseAbs().maxCoeff();
}

Mat3<double> exact_exp(const Vec3<double>& w) {
    const long double t = std::sqrt((long double)(w.squaredNorm()));
    Mat3<double> k;
    k << 0, -w[2], w[1], w[2], 0, -w[0], -w[1], w[0], 0;
    if (t == 0) return Mat3<double>::Identity();
    const long double h = std::sin(t / 2) / (t / 2);
    return Mat3<double>::Identity() + double(std::sin(t) / t) * k + double(h * h / 2) * k * k;
}

} // namespace

TEST_CASE("rotation: golden values") {
    const Mat3<double> r = so3_exp(Vec3<double>(0, -0.2, 0)) * so3_exp(Vec3<double>(0.3, 0, 0));
    Mat3<double> golden;
    golden << .980067, -.058711, -.189796, 0, .955336, -.295520, .198669, .289629, .936293;
    CHECK(unequal(r, golden) <= 5e-7);
    const Quat<double> q =
        shortest_arc(Vec3<double>(0, 0, 1), normalized(Vec3<double>(.189796, .295520, .936293)));
    CHECK((q - Quat<double>(.983944, -.150171, .096447, 0)).cwiseAbs().maxCoeff() <= 1e-6);
    // A quarter turn about x takes y to z.
    const double h = std::sqrt(0.5);
    const Vec3<double> z = quat_rotate(Quat<double>(h, h, 0, 0), Vec3<double>(0, 1, 0));
    CHECK((z - Vec3<double>(0, 0, 1)).norm() <= 1e-15);
}

TEST_CASE_TEMPLATE("rotation: matrix, product and rotate agree", T, float, double) {
    const double tolerance = 8.0 * double(std::numeric_limits<T>::epsilon());
    for (std::uint64_t i = 0; i < 500; ++i) {
        const Quat<T> a = unit_vec<T, 4>(i), b = unit_vec<T, 4>(i, 2);
        const Vec3<T> v = unit_vec<T, 3>(i, 3);
        const Mat3<T> ab = quat_matrix(quat_product(a, b)), m = quat_matrix(a) * quat_matrix(b);
        CHECK(unequal(ab, Mat3<double>(m.template cast<double>())) <= tolerance);
        CHECK(double((quat_rotate(a, v) - quat_matrix(a) * v).norm()) <= tolerance);
        const Mat3<T> identity = quat_matrix(a) * quat_matrix(a).transpose();
        CHECK(unequal(identity, Mat3<double>::Identity()) <= tolerance);
        const Vec3<T> c0 = m.col(0), c1 = m.col(1), c2 = m.col(2);
        CHECK(std::abs(double(dot(cross(c0, c1), c2)) - 1) <= 2 * tolerance);
    }
}

TEST_CASE("rotation: quaternions of every magnitude; zero is the identity (C1)") {
    for (int e = -126; e <= 126; e += 7) {
        for (std::uint64_t i = 0; i < 50; ++i) {
            Quat<float> q = unit_vec<float, 4>(i);
            for (int k = 0; k < 4; ++k)
                q[k] = std::copysign(std::ldexp(0.5f + std::abs(q[k]), e), q[k]);
            const Vec4<double> truth = q.cast<double>().normalized();
            const Quat<float> n = quat_normalized(q);
            CHECK((n.cast<double>() - truth).cwiseAbs().maxCoeff() <= 3 * 0x1p-24);
        }
    }
    const Quat<float> zero = Quat<float>::Zero(), g(1, 2, 3, 4);
    CHECK(quat_normalized(zero) == quat_identity<float>());
    CHECK(quat_normalized_vjp(zero, g) == zero);
    const Quat<float> bad(1, std::numeric_limits<float>::quiet_NaN(), 0, 0);
    CHECK(std::isnan(quat_normalized(bad)[0]));
    const Quat<float> huge(std::numeric_limits<float>::infinity(), 1, 0, 0);
    CHECK(std::isnan(quat_normalized(huge)[0]));
}

TEST_CASE("rotation: a sum of quaternions that cancels (C4)") {
    const Quat<float> q = unit_vec<float, 4>(3);
    CHECK(quat_normalized(Quat<float>(q - q)) == quat_identity<float>());
    for (const float s : {1e-7f, -1e-7f, 1e-3f}) {
        const Quat<float> rest = q - q * (1 + s);
        const Quat<float> n = quat_normalized(rest);
        CHECK(n.norm() == doctest::Approx(1.0));
        CHECK(quat_normalized_vjp(rest, Quat<float>(1, 2, 3, 4)).allFinite());
    }
}

TEST_CASE_TEMPLATE("rotation: adjoints of normalise, matrix and product (C3)", T, float, double) {
    const double tolerance = std::is_same_v<T, double> ? 1e-13 : 2e-6;
    const Index n = 40;
    const auto f = [](const auto& x) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        Columns<S> y(13, x.cols());
        for (Index i = 0; i < x.cols(); ++i) {
            const Quat<S> a(x(0, i), x(1, i), x(2, i), x(3, i));
            const Quat<S> b(x(4, i), x(5, i), x(6, i), x(7, i));
            const Quat<S> q = quat_normalized(a), p = quat_product(q, b);
            const Mat3<S> r = quat_matrix(q);
            for (int k = 0; k < 9; ++k) y(k, i) = r(k % 3, k / 3);
            for (int k = 0; k < 4; ++k) y(9 + k, i) = p[k];
        }
        return y;
    };
    Columns<T> x = random_columns<T>(8, n, {1});
    x.template block<4, 1>(0, 1) *= T(1e-12);                  // tiny, and nearly an axis
    x.template block<4, 1>(0, 2) << T(1), T(1e-9), T(0), T(0);
    const auto vjp = [&](const Columns<T>& w) {
        Columns<T> g(8, n);
        for (Index i = 0; i < n; ++i) {
            const Quat<T> a = x.template block<4, 1>(0, i), b = x.template block<4, 1>(4, i);
            const Quat<T> q = quat_normalized(a), gp = w.template block<4, 1>(9, i);
            const Mat3<T> gr = w.template block<9, 1>(0, i).reshaped(3, 3);
            const Quat<T> gq = quat_matrix_vjp(q, gr) + quat_product_vjp_left(b, gp);
            const Quat<T> ga = quat_normalized_vjp(a, gq);
            CHECK(std::abs(double(dot(q, ga))) <= 16 * double(std::numeric_limits<T>::epsilon()) *
                                                      double(ga.norm()));
            g.template block<4, 1>(0, i) = ga;
            g.template block<4, 1>(4, i) = quat_product_vjp_right(q, gp);
        }
        return g;
    };
    Columns<T> dx = random_columns<T>(8, n, {2});
    dx.template block<4, 1>(0, 1) *= T(1e-12);
    CHECK(detail::dot_product_test(f, vjp, x, dx, random_columns<T>(13, n, {3})) <= tolerance);
}

TEST_CASE_TEMPLATE("rotation: shortest arc at every angle, the antipode too (C5)", T, float,
                   double) {
    const double tolerance = std::is_same_v<T, double> ? 2e-15 : 6e-7;
    double worst = 0;
    for (const double from_antipode : {0., 1e-9, 1e-7, 1e-5, 1e-3, 1e-1, 1., pi / 2, 2., 3., 3.1,
                                       pi - 1e-5, pi - 1e-9, pi}) {
        for (std::uint64_t i = 0; i < 200; ++i) {
            const Vec3<double> a = i < 3 ? Vec3<double>(Vec3<double>::Unit(Index(i)))
                                         : unit_vec<double, 3>(i);
            const Vec3<double> axis = cross(a, unit_vec<double, 3>(i, 5)).normalized();
            const Vec3<double> b = exact_exp(axis * (pi - from_antipode)) * a;
            const Vec3<T> at = a.cast<T>(), bt = from_antipode == 0 ? Vec3<T>(-at) : b.cast<T>();
            const Quat<T> q = shortest_arc(at, bt);
            REQUIRE(q.allFinite());
            CHECK(std::abs(double(dot(q, q)) - 1) <= 4 * double(std::numeric_limits<T>::epsilon()));
            const Vec3<double> moved = quat_rotate<double>(q.template cast<double>(),
                                                           at.template cast<double>());
            worst = std::max(worst, angle_between(moved, bt.template cast<double>()));
            // No torsion: the axis is orthogonal to both.
            CHECK(std::abs(double(q.template tail<3>().dot(at))) <= tolerance);
        }
    }
    CHECK(worst <= tolerance);
}

TEST_CASE("rotation: shortest arc has the derivative of its formula") {
    const Vec3<double> a(0, 0, 1);
    for (std::uint64_t i = 0; i < 20; ++i) {
        Vec3<double> b = unit_vec<double, 3>(i);
        if (i == 0) b = a;
        const auto f = [](const auto& x) {
            using S = typename std::decay_t<decltype(x)>::Scalar;
            const Vec3<S> v(x(0, 0), x(1, 0), x(2, 0));
            const Vec3<S> z(S(0), S(0), S(1));
            return Columns<S>(shortest_arc(z, normalized(v)));
        };
        const Columns<double> x = b, dx = random_columns<double>(3, 1, {i});
        const Columns<double> gap = jvp(f, x, dx) - central_difference(f, x, dx);
        CHECK(gap.cwiseAbs().maxCoeff() <= 1e-9 / (1.0001 + b[2]));
    }
}

TEST_CASE_TEMPLATE("rotation: exponential map at every angle (C10)", T, float, double) {
    const double tolerance = 8.0 * double(std::numeric_limits<T>::epsilon());
    for (const double angle : {0., 1e-30, 1e-12, 1e-8, 1e-4, 1e-3, 0.1, 0.49, 0.51, 0.999, 1.001,
                               1.99, 2.01, 3., pi, 4., 6.28, 20.}) {
        for (std::uint64_t i = 0; i < 30; ++i) {
            const Vec3<T> w = unit_vec<T, 3>(i) * static_cast<T>(angle);
            const Mat3<T> r = so3_exp(w);
            CHECK(unequal(r, exact_exp(w.template cast<double>())) <=
                  tolerance * std::max(1., angle));
            CHECK(unequal(quat_matrix(so3_exp_quat(w)), Mat3<double>(r.template cast<double>())) <=
                  tolerance * std::max(1., angle));
        }
    }
}

TEST_CASE_TEMPLATE("rotation: adjoint of the exponential map", T, float, double) {
    const double tolerance = std::is_same_v<T, double> ? 1e-12 : 1e-5;
    const auto f = [](const auto& x) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        const Mat3<S> r = so3_exp(Vec3<S>(x(0, 0), x(1, 0), x(2, 0)));
        return Columns<S>(r);
    };
    for (const double angle : {0., 1e-20, 1e-8, 1e-4, 0.1, 0.9999, 1.0001, 1.9999, 2.0001, pi,
                               6.}) {
        for (std::uint64_t i = 0; i < 10; ++i) {
            const Columns<T> w = unit_vec<T, 3>(i) * static_cast<T>(angle);
            const auto vjp = [&](const Columns<T>& g) {
                return Columns<T>(so3_exp_vjp(Vec3<T>(w), Mat3<T>(g)));
            };
            CAPTURE(angle);
            CHECK(detail::dot_product_test(f, vjp, w, random_columns<T>(3, 1, {i, 5}),
                                           random_columns<T>(3, 3, {i, 7})) <= tolerance);
            if constexpr (std::is_same_v<T, double>)
                CHECK(detail::difference_test(f, vjp, w, random_columns<T>(3, 1, {i, 5}),
                                              random_columns<T>(3, 3, {i, 7})) <= 1e-9);
        }
    }
}

TEST_CASE_TEMPLATE("rotation: logarithm near 0 and at pi (C11)", T, float, double) {
    const double tolerance = std::is_same_v<T, double> ? 4e-15 : 1e-6;
    for (const double angle : {0., 1e-12, 1e-8, 1e-4, 1e-3, 0.1, 0.2, 0.25, 0.26, 1., 3., pi - 1e-3,
                               pi - 1e-4, pi - 1e-5}) {
        for (std::uint64_t i = 0; i < 300; ++i) {
            const Vec3<T> w = unit_vec<T, 3>(i) * static_cast<T>(angle);
            const Vec3<T> back = quat_log(so3_exp_quat(w));
            CHECK(double((back - w).norm()) <= tolerance);
            const Vec3<T> through_matrix = so3_log(so3_exp(w));
            // Within rounding of pi both signs are correct.
            const double gap = std::min(double((through_matrix - w).norm()),
                                        angle > 3.14 ? double((through_matrix + w).norm()) : 1e9);
            CHECK(gap <= (angle > 3.14 ? 3e-5 : tolerance));
        }
    }
    for (std::uint64_t i = 0; i < 10000; ++i) {                    // Ceres' set
        const Vec3<T> w = unit_vec<T, 3>(i) * T(1e-8);
        REQUIRE(double((so3_log(so3_exp(w)) - w).norm()) <= 1e-8 * tolerance + 1e-14);
    }
    for (int k = 0; k < 3; ++k) {                                  // exactly pi about each axis
        Quat<T> q = Quat<T>::Zero();
        q[k + 1] = T(1);
        const Vec3<T> w = so3_log(quat_matrix(q));
        CHECK(std::abs(std::abs(double(w[k])) - pi) <= tolerance);
        CHECK(double(w.norm()) == doctest::Approx(pi));
    }
}

TEST_CASE("rotation: matrices to quaternions at every pivot, with finite derivatives (C12)") {
    const double h = std::sqrt(0.5);
    std::vector<Quat<double>> hard{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1},
                                   {h, h, 0, 0}, {0, h, h, 0}, {0.5, 0.5, -0.5, 0.5}};
    for (std::uint64_t i = 0; i < 100; ++i) hard.push_back(unit_vec<double, 4>(i));
    for (const Quat<double>& q : hard) {
        const Quat<double> back = matrix_quat(quat_matrix(q));
        CHECK(std::min((back - q).norm(), (back + q).norm()) <= 1e-15);
        CHECK(back[0] >= 0);
        const Quat<float> backf = matrix_quat(quat_matrix(Quat<float>(q.cast<float>())));
        const Quat<double> near = backf.cast<double>();
        CHECK(std::min((near - q).norm(), (near + q).norm()) <= 4e-7);
        using D = Dual<double, 3>;
        const Vec3<D> w(D::variable(0, 0), D::variable(0, 1), D::variable(0, 2));
        const Quat<D> moved = quat_product(so3_exp_quat(w), Quat<D>(q.cast<D>()));
        const Quat<D> again = matrix_quat(quat_matrix(moved));
        const double sign = back.dot(q) < 0 ? -1 : 1;
        for (int i = 0; i < 4; ++i)
            for (std::size_t k = 0; k < 3; ++k)
                CHECK(std::abs(again[i].d[k] - sign * moved[i].d[k]) <= 1e-14);
    }
}

TEST_CASE_TEMPLATE("rotation: slerp (C9)", T, float, double) {
    const double tolerance = std::is_same_v<T, double> ? 2e-15 : 4e-7;
    const Quat<T> a = unit_vec<T, 4>(1);
    const Vec3<T> axis = unit_vec<T, 3>(2);
    for (const double angle : {0., 1e-8, 1e-4, 0.1, 1., 2., 3., 3.1}) {
        for (const double t : {0., 0.25, 0.5, 1.}) {
            const Quat<T> b = quat_product(a, so3_exp_quat(Vec3<T>(axis * static_cast<T>(angle))));
            const Quat<T> expected =
                quat_product(a, so3_exp_quat(Vec3<T>(axis * static_cast<T>(angle * t))));
            const Quat<T> q = quat_slerp(a, b, static_cast<T>(t));
            const Quat<T> flipped = quat_slerp(a, Quat<T>(-b), static_cast<T>(t));
            CHECK(double((q - expected).norm()) <= 2 * tolerance);
            CHECK(double((flipped - expected).norm()) <= 2 * tolerance);
        }
    }
}

TEST_CASE("rotation: lanes compute what scalars compute") {
    using Batch = XsimdBackend<>::batch<float>;
    const auto a = [](std::size_t l) { return unit_vec<float, 3>(l); };
    const auto b = [](std::size_t l) {  // lanes on both sides of every branch
        return l == 0 ? Vec3<float>(-unit_vec<float, 3>(0))
                      : l == 1 ? unit_vec<float, 3>(1) : unit_vec<float, 3>(l, 2);
    };
    const auto w = [](std::size_t l) {
        return Vec3<float>(unit_vec<float, 3>(l) * (l == 0 ? 0.0f : 0.45f * float(l)));
    };
    const Vec3<Batch> av = lanes_of<Batch, 3>(a), bv = lanes_of<Batch, 3>(b);
    const Vec3<Batch> wv = lanes_of<Batch, 3>(w);
    CHECK(lane_gap(shortest_arc(av, bv), [&](std::size_t l) { return shortest_arc(a(l), b(l)); }) <=
          4e-7);
    CHECK(lane_gap(so3_exp_quat(wv), [&](std::size_t l) { return so3_exp_quat(w(l)); }) <= 4e-7);
    CHECK(lane_gap(quat_log(so3_exp_quat(wv)), [&](std::size_t l) {
              return quat_log(so3_exp_quat(w(l)));
          }) <= 1e-6);
    const Mat3<Batch> r = so3_exp(wv);
    CHECK(lane_gap(matrix_quat(r), [&](std::size_t l) {
              return matrix_quat(so3_exp(w(l)));
          }) <= 6e-7);
}
