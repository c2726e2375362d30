// SPDX-License-Identifier: Apache-2.0
#include <rye/autodiff/check.hpp>

#include <doctest/doctest.h>

using namespace rye;

namespace {

struct Cubic {
    template <class T>
    Columns<T> operator()(const Columns<T>& x) const {
        Columns<T> y = x;
        for (Index i = 0; i < x.size(); ++i) {
            const T v = x.data()[i];
            y.data()[i] = v * v * v + x.data()[0] * v;
        }
        return y;
    }
};

/// Its adjoint, and the same with a fault in one place.
Columns<double> cubic_vjp(const Columns<double>& x, const Columns<double>& w, double fault = 1) {
    Columns<double> g(x.rows(), x.cols());
    double first = 0;
    for (Index i = 0; i < x.size(); ++i) {
        const double v = x.data()[i], wi = w.data()[i];
        g.data()[i] = (3 * v * v + x.data()[0]) * wi;
        first += v * wi;
    }
    g.data()[0] += fault * first;
    return g;
}

struct Pair {
    Columns<double> a = Columns<double>::Constant(2, 3, 1.);
    Columns<double> b = Columns<double>::Constant(4, 1, 2.);
    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        f("a", p.a...);
        f("b", p.b...);
    }
};

} // namespace

TEST_CASE("check: accepts an adjoint, and finds the fault in a wrong one") {
    const Columns<double> x = random_columns<double>(3, 5, {1});
    const Columns<double> dx = random_columns<double>(3, 5, {2});
    const Columns<double> w = random_columns<double>(3, 5, {3});
    const auto right = [&](const Columns<double>& g) { return cubic_vjp(x, g); };
    const auto wrong = [&](const Columns<double>& g) { return cubic_vjp(x, g, 0.5); };
    CHECK(detail::dot_product_test(Cubic{}, right, x, dx, w) <= 1e-15);
    CHECK(detail::difference_test(Cubic{}, right, x, dx, w) <= 5e-10);
    CHECK(detail::dot_product_test(Cubic{}, wrong, x, dx, w) > 1e-4);
    CHECK(detail::difference_test(Cubic{}, wrong, x, dx, w) > 1e-4);
}

TEST_CASE("check: not a number never passes") {
    const Columns<double> x = random_columns<double>(2, 2, {1});
    const auto nan = [&](const Columns<double>& g) { return Columns<double>(g * std::nan("")); };
    CHECK(std::isinf(detail::dot_product_test(Cubic{}, nan, x, x, x)));
    CHECK(disagreement(DotSum{1, 0}, DotSum{0, 0}) == std::numeric_limits<double>::infinity());
    CHECK(disagreement(DotSum{}, DotSum{}) == 0);
}

TEST_CASE("check: jvp, jacobian and differences agree") {
    const Columns<double> x = random_columns<double>(2, 3, {4});
    const Columns<double> dx = random_columns<double>(2, 3, {5});
    const Columns<double> j = jacobian(Cubic{}, x), forward = jvp(Cubic{}, x, dx);
    const VecX<double> product = j * dx.reshaped();
    CHECK((product - VecX<double>(forward.reshaped())).norm() <= 1e-14);
    CHECK((central_difference(Cubic{}, x, dx) - forward).norm() <= 1e-8);
}

TEST_CASE("check: dot products and random directions over parameter structs") {
    const Pair p, q = random_like(p, {7}), r = random_like(p, {8});
    CHECK(q.a.rows() == 2);
    CHECK(q.a != r.a);
    DotSum s;
    s.add_all(q, r);
    CHECK(s.sum == doctest::Approx(q.a.cwiseProduct(r.a).sum() + q.b.cwiseProduct(r.b).sum()));
    CHECK(s.magnitude >= std::abs(s.sum));
}
