// SPDX-License-Identifier: Apache-2.0
#include <rye/loss/mesh_terms.hpp>

#include <cmath>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>

#include "../support/laws.hpp"

using namespace rye;

namespace {

using Plain = ScalarBackend<Serial>;
const std::vector<Face> strip{{0, 1, 2}, {2, 1, 3}, {2, 3, 4}};

/// Relative difference between the dual's derivative along a random direction and the gradient's.
template <class T, class Term>
double slope_error(const Columns<T>& x, const Term& term) {
    const Columns<T> dx = random_columns<T>(x.rows(), x.cols(), 77);
    DotProducts d;
    d.add_forward(Columns<T>::Constant(1, 1, term(lifted(x, dx)).value.d[0]),
                  Columns<T>::Ones(1, 1));
    d.add_reverse(term(x).gradient, dx);
    return d.error();
}

/// 0 or 1, in a disc.
template <class T>
Columns<T> disc(int size, double radius) {
    Columns<T> m(1, size * size);
    for (int y = 0; y < size; ++y)
        for (int x = 0; x < size; ++x)
            m(0, y * size + x) = T(std::hypot(x - size / 2, y - size / 2) < radius ? 1 : 0);
    return m;
}

} // namespace

TEST_CASE("mesh terms: values by hand") {
    Columns<double> color(3, 2), target(3, 2), visible(1, 2);
    color << 0.5, 0.2, 0.25, 0.2, 1, 0.2;
    target << 0.25, 9, 0.5, 9, 1, 9;
    visible << 1, 0;
    const LossTerm<double> rgb = detail::color_term<double>(Plain{}, color, target, visible);
    CHECK(rgb.value == doctest::Approx(0.5 / 6));
    CHECK(rgb.count == 6);
    CHECK(rgb.gradient(0, 0) == doctest::Approx(1.0 / 6));
    CHECK(rgb.gradient(1, 0) == doctest::Approx(-1.0 / 6));
    CHECK(rgb.gradient(2, 0) == 0);
    CHECK(rgb.gradient.col(1).norm() == 0);

    Columns<double> a(3, 2), b(3, 2);
    a << 1, 0, 0, 2, 0, 0;
    b.setZero();
    CHECK(detail::deformation_term<double>(a, b).value == doctest::Approx(5.0 / 6));
    CHECK(detail::offset_term<double>(a).value == doctest::Approx(5.0 / 2));
    CHECK(detail::offset_term<double>(a).gradient(1, 1) == doctest::Approx(2.0));
    CHECK(detail::eye_offset_term<double>(a, b).value == doctest::Approx(3.0 / 6));
    Columns<double> sdf(1, 4);
    sdf << 0.5, -0.25, 0, 0.25;
    CHECK(detail::landmark_term<double>(sdf).value == doctest::Approx(0.25));
    CHECK(detail::landmark_term<double>(sdf).gradient == 0.25 * sdf.unaryExpr([](double s) {
        return s > 0 ? 1.0 : s < 0 ? -1.0 : 0.0;
    }));
    Columns<double> triangle(3, 3); // Laplacians (1.5, 1.5), (-3, 1.5), (1.5, -3)
    triangle << 0, 3, 0, 0, 0, 3, 0, 0, 0;
    CHECK(detail::laplacian_term<double>(triangle, {{0, 1, 2}}).value == doctest::Approx(27.0 / 9));
}

TEST_CASE("silhouette_term: intersection over union, also of nothing") {
    const Columns<double> none = Columns<double>::Zero(1, 64), all = Columns<double>::Ones(1, 64);
    CHECK(detail::silhouette_term<double>(Plain{}, all, all, all).value ==
          doctest::Approx(0).epsilon(1e-9));
    CHECK(detail::silhouette_term<double>(Plain{}, none, all, all).value == doctest::Approx(1));
    CHECK(detail::silhouette_term<double>(Plain{}, all, none, all).value == doctest::Approx(1));
    CHECK(detail::silhouette_term<double>(Plain{}, 0.5 * all, all, all).value ==
          doctest::Approx(0.5));
    for (const auto& [soft, mask, visible] :
         {std::tuple{none, none, all},
          {all, all, none},
          {Columns<double>(1, 0), Columns<double>(1, 0), Columns<double>(1, 0)}}) {
        const LossTerm<double> empty =
            detail::silhouette_term<double>(Plain{}, soft, mask, visible);
        CHECK(empty.value == 0);
        CHECK(empty.count == 0);
        CHECK(empty.gradient.norm() == 0);
    }
    const Columns<float> tiny = Columns<float>::Constant(1, 64, 1e-32f);
    const LossTerm<float> faint =
        detail::silhouette_term<float>(Plain{}, tiny, tiny, Columns<float>::Ones(1, 64));
    CHECK(std::isfinite(faint.value));
    CHECK(faint.gradient.allFinite());
    const Columns<float> a = disc<float>(64, 20), b = disc<float>(64, 14);
    const Columns<float> seen = Columns<float>::Ones(1, a.cols());
    CHECK(detail::silhouette_term<float>(Plain{}, a, b, seen).value ==
          doctest::Approx(1 - b.sum() / a.sum()).epsilon(1e-6));
}

TEST_CASE_TEMPLATE("mesh terms: gradients agree with duals", T, float, double) {
    using D = Dual<T, 1>;
    const double bound = std::is_same_v<T, float> ? 2e-6 : 1e-14;
    const auto constant = [](const Columns<T>& c, auto like) {
        return Columns<decltype(like)>(c.template cast<decltype(like)>());
    };
    const Columns<T> target = random_columns<T>(3, 400, 1), visible = disc<T>(20, 8),
                     landmarks = random_columns<T>(3, 424, 2);
    CHECK(slope_error<T>(random_columns<T>(3, 400, 3), [&](const auto& x) {
              using S = typename std::decay_t<decltype(x)>::Scalar;
              return detail::color_term<S>(Plain{}, x, constant(target, S()),
                                           constant(visible, S()));
          }) < bound);
    CHECK(slope_error<T>(random_columns<T>(1, 400, 4).cwiseAbs(), [&](const auto& x) {
              using S = typename std::decay_t<decltype(x)>::Scalar;
              return detail::silhouette_term<S>(Plain{}, x, constant(disc<T>(20, 6), S()),
                                                constant(visible, S()));
          }) < bound);
    CHECK(slope_error<T>(random_columns<T>(3, 424, 5), [&](const auto& x) {
              using S = typename std::decay_t<decltype(x)>::Scalar;
              return detail::deformation_term<S>(x, constant(landmarks, S()));
          }) < bound);
    CHECK(slope_error<T>(random_columns<T>(3, 50, 6), [](const auto& x) {
              return detail::offset_term<typename std::decay_t<decltype(x)>::Scalar>(x);
          }) < bound);
    Columns<T> sdf = random_columns<T>(1, 424, 7);
    sdf(0, 5) = T(0); // slope 0 at the kink, on both sides
    CHECK(slope_error<T>(sdf, [](const auto& x) {
              return detail::landmark_term<typename std::decay_t<decltype(x)>::Scalar>(x);
          }) < bound);
    CHECK(slope_error<T>(random_columns<T>(3, 6, 8), [](const auto& x) { // vertex 5 has no face
              return detail::laplacian_term<typename std::decay_t<decltype(x)>::Scalar>(x, strip);
          }) < bound);
    CHECK(slope_error<T>(random_columns<T>(3, 2, 9), [&](const auto& x) {
              using S = typename std::decay_t<decltype(x)>::Scalar;
              return detail::eye_offset_term<S>(x, constant(landmarks.leftCols(2), S()));
          }) < bound);
    CHECK(detail::landmark_term<D>(lifted(sdf, sdf)).gradient(0, 5).value == T(0));
}

TEST_CASE("mesh terms: nothing to average is 0, counted as 0") {
    const Columns<double> points(3, 0), row(1, 0);
    for (const LossTerm<double>& t :
         {detail::color_term<double>(Plain{}, points, points, row),
          detail::deformation_term<double>(points, points), detail::offset_term<double>(points),
          detail::landmark_term<double>(row), detail::laplacian_term<double>(points, {}),
          detail::eye_offset_term<double>(points, points)}) {
        CHECK(t.value == 0);
        CHECK(t.count == 0);
        CHECK(t.gradient.size() == 0);
    }
    Columns<double> isolated = Columns<double>::Ones(3, 4);
    CHECK(detail::laplacian_term<double>(isolated, {}).gradient.norm() == 0);
}

TEST_CASE("mesh terms: long float sums keep their digits") {
    const Columns<float> x = random_columns<float>(3, 200000, 1) * 0.1f;
    const double truth = x.cast<double>().squaredNorm() / 200000;
    CHECK(std::abs(static_cast<double>(detail::offset_term<float>(x).value) - truth) <
          2.4e-7 * truth);
}
