// SPDX-License-Identifier: Apache-2.0
#include <rye/geometry/rigid.hpp>

#include <doctest/doctest.h>

#include <rye/autodiff/dual.hpp>
#include <rye/math/rotation.hpp>

using namespace rye;

namespace {

template <class T>
Rigid<T> some_motion(double a, double b, double c) {
    return {so3_exp(Vec3<T>(T(a), T(b), T(c))), Vec3<T>(T(c), T(a), T(b))};
}

} // namespace

TEST_CASE_TEMPLATE("rigid: inverse and composition", T, float, double) {
    const double tolerance = 8 * double(std::numeric_limits<T>::epsilon());
    const Rigid<T> a_from_b = some_motion<T>(0.3, -0.7, 0.5);
    const Rigid<T> b_from_c = some_motion<T>(1.1, 0.2, -2);
    const Vec3<T> x(T(0.4), T(-0.6), T(0.9));
    const Vec3<T> there = a_from_b.apply(b_from_c.apply(x));
    CHECK(double((compose(a_from_b, b_from_c).apply(x) - there).norm()) <= tolerance);
    CHECK(double((a_from_b.inverse().apply(a_from_b.apply(x)) - x).norm()) <= tolerance);
    CHECK(double((a_from_b.turn_back(a_from_b.turn(x)) - x).norm()) <= tolerance);
    const Rigid<T> none = compose(a_from_b, a_from_b.inverse());
    CHECK(double((none.rotation - Rigid<T>::identity_rotation()).norm()) <= tolerance);
    CHECK(double(none.translation.norm()) <= tolerance);
}

TEST_CASE("rigid: order matters, rotation before translation") {
    Rigid<double> turn, shift;
    turn.rotation = so3_exp(Vec3<double>(0, 0, std::acos(0.0)));
    shift.translation = Vec3<double>(1, 0, 0);
    const Vec3<double> x(1, 0, 0);
    CHECK((compose(shift, turn).apply(x) - Vec3<double>(1, 1, 0)).norm() <= 1e-15);
    CHECK((compose(turn, shift).apply(x) - Vec3<double>(0, 2, 0)).norm() <= 1e-15);
}

TEST_CASE("rigid: duals pass through, and turn_back is the adjoint of apply") {
    using D = Dual<double, 1>;
    const Rigid<double> a = some_motion<double>(0.3, -0.7, 0.5);
    const Rigid<D> d = a.cast<D>();
    const Vec3<double> dx(0.1, 0.2, -0.3), w(1, -2, 3);
    Vec3<D> x(D(1), D(2), D(3));
    for (int i = 0; i < 3; ++i) x[i].d[0] = dx[i];
    const Vec3<D> y = d.apply(x);
    const double forward = y[0].d[0] * w[0] + y[1].d[0] * w[1] + y[2].d[0] * w[2];
    CHECK(forward == doctest::Approx(dx.dot(a.turn_back(w))).epsilon(1e-14));
}
