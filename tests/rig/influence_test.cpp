// SPDX-License-Identifier: Apache-2.0
#include <rye/rig/influence.hpp>

#include <doctest/doctest.h>

#include <rye/autodiff/dual.hpp>
#include <rye/backend/lanes.hpp>

using namespace rye;

namespace {

const Ramp<double> face{0.15, 0.25};

struct NoSlope {
    float value(const Ramp<float>&, float) const { return 0; }
};
static_assert(!InfluenceMetric<NoSlope>);

} // namespace

TEST_CASE("influence: golden values of both metrics (D5)") {
    const Ramp<double> parent{0.1, 0.25};
    CHECK(influence(SquaredDistance{}, parent, 0.1) == 1);
    CHECK(influence(SquaredDistance{}, parent, 0.175) == doctest::Approx(0.5));
    CHECK(influence(SquaredDistance{}, parent, 0.25) == 0);
    CHECK(influence(EuclideanDistance{}, face, 0.15 * 0.15) == 1);
    CHECK(influence(EuclideanDistance{}, face, 0.2 * 0.2) == doctest::Approx(0.5));
    CHECK(influence(EuclideanDistance{}, face, 0.25 * 0.25) == 0);
    CHECK(influence(SquaredDistance{}, face, 0.04) == 1);  // the same point, the other metric
}

TEST_CASE_TEMPLATE("influence: in [0, 1], not increasing, continuous", M, SquaredDistance,
                   EuclideanDistance) {
    float last = 1;
    for (float squared = 0; squared < 0.3f; squared += 1e-5f) {
        const float w = influence(M{}, Ramp<float>{0.15f, 0.25f}, squared);
        REQUIRE(w <= last);
        REQUIRE(w >= 0);
        REQUIRE(last - w <= 1e-3f);
        CHECK(w + (1 - w) == 1);  // lambda_pose is the complement (D6)
        last = w;
    }
    CHECK(last == 0);
}

TEST_CASE_TEMPLATE("influence: the slope is the dual's derivative; 0 at the kinks (D2)", M,
                   SquaredDistance, EuclideanDistance) {
    using D = Dual<double, 1>;
    const bool root = std::is_same_v<M, EuclideanDistance>;
    const double near = root ? face.near * face.near : face.near;
    const double far = root ? face.far * face.far : face.far;
    const Ramp<D> ramp{D(face.near), D(face.far)};
    for (const double s : {0., near / 2, near, near * 1.001, (near + far) / 2, far * 0.999,
                           far, 1.}) {
        CAPTURE(s);
        const double slope = detail::influence_slope(M{}, face, s);
        const D w = influence(M{}, ramp, D::variable(s));
        CHECK(w.value == influence(M{}, face, s));
        CHECK(w.d[0] == doctest::Approx(slope).epsilon(1e-13));
        if (s <= near || s >= far) CHECK(slope == 0);
        if (s > near && s < far && !root) CHECK(slope == doctest::Approx(-10));
    }
}

TEST_CASE_TEMPLATE("influence: equal thresholds are a step with derivative 0 (D1)", M,
                   SquaredDistance, EuclideanDistance) {
    const Ramp<float> step{0.5f, 0.5f};
    const float at = std::is_same_v<M, EuclideanDistance> ? 0.25f : 0.5f;
    CHECK(influence(M{}, step, std::nextafter(at, 0.0f)) == 1);
    CHECK(influence(M{}, step, at) == 0);
    CHECK(influence(M{}, step, std::nextafter(at, 1.0f)) == 0);
    for (const float s : {0.0f, at, 1.0f}) CHECK(detail::influence_slope(M{}, step, s) == 0);
    const Ramp<float> sharp{0.5f, std::nextafter(0.5f, 1.0f)};
    for (float s = 0; s < 1; s += 0.01f) CHECK(std::isfinite(influence(M{}, sharp, s)));
}

TEST_CASE_TEMPLATE("influence: on a landmark, without one, and not a number (D3, D7)", M,
                   SquaredDistance, EuclideanDistance) {
    const float inf = std::numeric_limits<float>::infinity();
    const Ramp<float> ramp{0.15f, 0.25f}, from_zero{0, 0.25f};
    CHECK(influence(M{}, ramp, 0.0f) == 1);
    CHECK(detail::influence_slope(M{}, ramp, 0.0f) == 0);
    CHECK(influence(M{}, from_zero, 0.0f) == 1);
    CHECK(std::isfinite(detail::influence_slope(M{}, from_zero, 0.0f)));
    CHECK(influence(M{}, ramp, inf) == 0);
    CHECK(influence(M{}, ramp, std::nanf("")) == 0);
    CHECK(detail::influence_slope(M{}, ramp, std::nanf("")) == 0);
}

TEST_CASE("influence: thresholds that make no ramp are refused") {
    CHECK_THROWS_AS(detail::checked_ramp<float>(0.3f, 0.2f), Error);
    CHECK_THROWS_AS(detail::checked_ramp<float>(-0.1f, 0.2f), Error);
    CHECK_THROWS_AS(detail::checked_ramp<float>(std::nanf(""), 0.2f), Error);
    CHECK_THROWS_AS(detail::checked_ramp<float>(0.1f, std::numeric_limits<float>::infinity()),
                    Error);
}

TEST_CASE("influence: over columns, with its adjoint, and in lanes") {
    Columns<double> squared(1, 6), g(1, 6);
    squared << 0, 0.16, 0.2, 0.24, 0.3, 0.15;
    g << 1, -2, 3, 4, 5, 6;
    const Columns<double> w = influence(SquaredDistance{}, face, squared);
    const Columns<double> back = influence_vjp(SquaredDistance{}, face, squared, g);
    for (Index i = 0; i < 6; ++i) {
        CHECK(w(0, i) == influence(SquaredDistance{}, face, squared(0, i)));
        CHECK(back(0, i) ==
              detail::influence_slope(SquaredDistance{}, face, squared(0, i)) * g(0, i));
    }
    using Batch = XsimdBackend<>::batch<float>;
    const Ramp<Batch> ramp{Batch(0.15f), Batch(0.25f)};
    const Ramp<float> one{0.15f, 0.25f};
#if defined(__aarch64__)  // there the compiler fuses products of numbers and not of vectors
    constexpr float apart = 4 * std::numeric_limits<float>::epsilon();
#else
    constexpr float apart = 0;
#endif
    for (float s = 0; s < 0.3f; s += 0.013f) {
        const float difference = influence(SquaredDistance{}, ramp, Batch(s)).get(1) -
                                 influence(SquaredDistance{}, one, s);
        CHECK(std::abs(difference) <= apart);
        CHECK(detail::influence_slope(EuclideanDistance{}, ramp, Batch(s)).get(1) ==
              doctest::Approx(detail::influence_slope(EuclideanDistance{}, one, s)));
    }
}

TEST_CASE("influence: two gazes that overlap (D8)") {
    Columns<float> left(1, 3), right(1, 3);
    left << 1, 0.5f, 0.75f;
    right << 0, 0.25f, 0.75f;
    Columns<float> l = left, r = right;
    CHECK(detail::resolve_overlap(Overlap::sum, l, r) == 1.5f);
    CHECK(l == left);
    CHECK(detail::resolve_overlap(Overlap::normalized, l, r) == 1.5f);
    CHECK(l(0, 2) + r(0, 2) == 1);
    CHECK(l(0, 1) == 0.5f);
}
