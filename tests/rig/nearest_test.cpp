// SPDX-License-Identifier: Apache-2.0
#include <rye/rig/nearest_landmark.hpp>

#include <doctest/doctest.h>

#include <rye/autodiff/check.hpp>
#include <rye/backend/lanes.hpp>
#include <rye/backend/scalar.hpp>

using namespace rye;

namespace {

using Plain = ScalarBackend<Serial>;
using Lanes = XsimdBackend<DefaultArch, Serial>;
using LanesThreads = XsimdBackend<>;

/// A grid of small integers: every distance is exact, with many ties.
Columns<float> lattice(Index n, std::uint64_t seed) {
    Columns<float> x(3, n);
    for (Index i = 0; i < x.size(); ++i)
        x.data()[i] = static_cast<float>(Random{seed}.below(static_cast<std::uint64_t>(i), 7));
    return x;
}

} // namespace

TEST_CASE_TEMPLATE("nearest: every backend finds the lowest index among equals (D4)", B, Plain,
                   Lanes, LanesThreads) {
    for (const Index n : {0, 1, 7, 16, 17, 5000}) {
        const Columns<float> x = lattice(n, 1), p = lattice(40, 2);
        std::vector<Index> nearest;
        const Columns<float> d = nearest_squared_distance<float>(B{}, x, p, &nearest);
        REQUIRE(d.cols() == n);
        for (Index i = 0; i < n; ++i) {
            Index best = 0;
            float least = (x.col(i) - p.col(0)).squaredNorm();
            for (Index k = 1; k < p.cols(); ++k)
                if ((x.col(i) - p.col(k)).squaredNorm() < least)
                    least = (x.col(i) - p.col(k)).squaredNorm(), best = k;
            REQUIRE(d(0, i) == least);
            REQUIRE(nearest[static_cast<std::size_t>(i)] == best);
        }
    }
}

TEST_CASE("nearest: the order of landmarks does not change distances; threads change nothing") {
    const Columns<float> x = random_columns<float>(3, 9000, {1});
    const Columns<float> p = random_columns<float>(3, 50, {2});
    const Columns<float> reversed = p.rowwise().reverse();
    const Columns<float> d = nearest_squared_distance<float>(Lanes{}, x, p);
    CHECK(d == nearest_squared_distance<float>(Lanes{}, x, reversed));
    CHECK(d == nearest_squared_distance<float>(LanesThreads{}, x, p));
    CHECK((d - nearest_squared_distance<float>(Plain{}, x, p)).cwiseAbs().maxCoeff() <= 4e-6f);
}

TEST_CASE_TEMPLATE("nearest: a point on its landmark, no landmarks, numbers that are none (D3, D7)",
                   B, Plain, Lanes) {
    Columns<float> x = random_columns<float>(3, 20, {1}), p = x.middleCols(3, 5);
    std::vector<Index> nearest;
    CHECK(nearest_squared_distance<float>(B{}, x, p, &nearest)(0, 4) == 0);
    CHECK(nearest[4] == 1);
    const Columns<float> empty(3, 0);
    const Columns<float> none = nearest_squared_distance<float>(B{}, x, empty, &nearest);
    CHECK(std::isinf(none(0, 0)));
    CHECK(nearest[0] == -1);
    x(1, 2) = std::nanf("");
    CHECK(std::isinf(nearest_squared_distance<float>(B{}, x, p, &nearest)(0, 2)));
    CHECK(nearest[2] == -1);
    const NearestGradient<float> g = detail::nearest_squared_distance_vjp<float>(
        B{}, x, p, nearest, Columns<float>(Columns<float>::Ones(1, 20)));
    CHECK(g.points.col(2).isZero());
    CHECK(g.landmarks.allFinite());
    p(0, 1) = std::nanf("");
    CHECK_THROWS_AS((nearest_squared_distance<float>(B{}, x, p)), Error);
}

TEST_CASE_TEMPLATE("nearest: of finite points one is nearest, however far they are", B, Plain,
                   Lanes) {
    const float most = std::numeric_limits<float>::max();
    for (const float far : {1e20F, 1e30F, most}) {
        Columns<float> p(3, 3), x(3, 5);
        p << -far, far, 0, 0, 0, far, 0, 0, 0;
        x << far, 0.5F * far, -0.5F * far, 0, -far, //
            0, 0, 0, -far, -far,                    //
            far, 0, 0, 0, -far;
        x(0, 3) = far / 2;
        std::vector<Index> nearest;
        const Columns<float> d = nearest_squared_distance<float>(B{}, x, p, &nearest);
        CHECK(nearest == std::vector<Index>{1, 1, 0, 1, 0});
        CHECK(d == Columns<float>::Constant(1, 5, most));
        const NearestGradient<float> g = detail::nearest_squared_distance_vjp<float>(
            B{}, x, p, nearest, Columns<float>(Columns<float>::Zero(1, 5)));
        CHECK(g.points.isZero(0));
    }
    // Beside one that is within the range, and of numbers that are none.
    Columns<float> p(3, 2), x(3, 3);
    p << 1e20F, 1e20F, 0, 0, 0, 0;
    p(1, 1) = 1e15F;
    x.setZero();
    x.col(0) << 1e20F, 1e15F, 1;
    x(2, 1) = std::numeric_limits<float>::infinity();
    x(2, 2) = std::nanf("");
    std::vector<Index> nearest;
    const Columns<float> d = nearest_squared_distance<float>(B{}, x, p, &nearest);
    CHECK(nearest == std::vector<Index>{1, -1, -1});
    CHECK(d(0, 0) == 1);
    CHECK(std::isinf(d(0, 1)));
    CHECK(std::isinf(d(0, 2)));
}

TEST_CASE_TEMPLATE("nearest: adjoint to points and landmarks", T, float, double) {
    const Index n = 20000, k = 30;
    const Columns<T> x = random_columns<T>(3, n + k, {1});      // points, then landmarks
    const auto f = [&](const auto& all) {
        using S = typename std::decay_t<decltype(all)>::Scalar;
        const Columns<S> points = all.leftCols(n), landmarks = all.rightCols(k);
        return nearest_squared_distance<S>(Plain{}, points, landmarks);
    };
    const auto vjp = [&](const Columns<T>& w) {
        std::vector<Index> nearest;
        nearest_squared_distance<T>(LanesThreads{}, x.leftCols(n), x.rightCols(k), &nearest);
        const NearestGradient<T> g = detail::nearest_squared_distance_vjp<T>(
            LanesThreads{}, x.leftCols(n), x.rightCols(k), nearest, w);
        Columns<T> all(3, n + k);
        all << g.points, g.landmarks;
        return all;
    };
    const double tolerance = std::is_same_v<T, double> ? 1e-14 : 2e-6;
    const Columns<T> dx = random_columns<T>(3, n + k, {2}), w = random_columns<T>(1, n, {3});
    CHECK(detail::dot_product_test(f, vjp, x, dx, w) <= tolerance);
}
