// SPDX-License-Identifier: Apache-2.0
#include <numbers>

#include <doctest/doctest.h>

#include <rye/autodiff/dual.hpp>
#include <rye/core/random.hpp>
#include <rye/core/thread_pool.hpp>
#include <rye/loss/smoothness.hpp>

#include "../support/random.hpp"

using namespace rye;

namespace {

Columns<double> draws(Index rows, Index columns, std::uint64_t seed) {
    Columns<double> x(rows, columns);
    for (Index i = 0; i < x.size(); ++i)
        x.data()[i] = Random{seed, 0}.normal(static_cast<std::uint64_t>(i));
    return x;
}

} // namespace

TEST_CASE("smoothness: nothing where all are alike, its gradient that of duals") {
    const Columns<double> points = draws(3, 12, 1), values = draws(2, 12, 2), way = draws(2, 12, 3);
    const detail::NeighbourGraph graph = detail::four_nearest(points);
    CHECK(smoothness(Columns<double>(Columns<double>::Constant(2, 12, 0.7)), graph).value == 0);
    const LossGradient<double> l = smoothness(values, graph);
    using D = Dual<double, 1>;
    Columns<D> moved(2, 12);
    for (Index i = 0; i < moved.size(); ++i) {
        moved.data()[i] = D(values.data()[i]);
        moved.data()[i].d[0] = way.data()[i];
    }
    const LossGradient<D> dual = smoothness(moved, graph);
    CHECK(dual.value.value == doctest::Approx(l.value).epsilon(1e-15));
    CHECK(dual.value.d[0] == doctest::Approx(l.gradient.cwiseProduct(way).sum()).epsilon(1e-13));
}

TEST_CASE("four nearest: on a line the two on each side, counted from `first`; too few are refused") {
    Columns<float> line = Columns<float>::Zero(3, 9);
    for (Index i = 0; i < 9; ++i) line(0, i) = static_cast<float>(i);
    auto of_middle = detail::four_nearest(line, 100)[4];
    std::sort(of_middle.begin(), of_middle.end());
    CHECK(of_middle == std::array<Index, 4>{102, 103, 105, 106});
    CHECK_THROWS_AS(detail::four_nearest(Columns<float>(line.leftCols(4))), Error);
}

TEST_CASE("nearest and turned: a ring about +z, and points where a turn leads nowhere new") {
    // 40 points on a ring, a quarter turn is 10 points on; the last two lie on the axis.
    Columns<double> points(3, 42);
    for (Index i = 0; i < 40; ++i) {
        const double a = 2 * std::numbers::pi * static_cast<double>(i) / 40;
        points.col(i) << std::cos(a), std::sin(a), 0.5;
    }
    points.col(40) << 0, 0, 1;
    points.col(41) << 0, 0, 1.1;
    const detail::NeighbourGraph near = detail::four_nearest(points, 7),
                                 graph = detail::nearest_and_turned(points, 7);
    for (Index i = 0; i < 40; ++i) {
        CHECK(graph[static_cast<std::size_t>(i)][3] == 7 + (i + 10) % 40);
        for (std::size_t k = 0; k < 3; ++k)
            CHECK(graph[static_cast<std::size_t>(i)][k] == near[static_cast<std::size_t>(i)][k]);
    }
    CHECK(graph[40] == near[40]);
    CHECK(graph[41] == near[41]);
    CHECK_THROWS_AS(detail::nearest_and_turned(Columns<double>(points.leftCols(4))), Error);
}

TEST_CASE("smoothness: by hand, one point of five that differs from its neighbours") {
    // Points 0, 0, 0, 0 and 1, each with the four others as neighbours: the last differs by 1 from
    // four, each of the others by 1 from one. 8 squares, over 5 numbers.
    Columns<double> values(1, 5);
    values << 0, 0, 0, 0, 1;
    detail::NeighbourGraph graph(5);
    for (Index i = 0; i < 5; ++i)
        for (Index k = 0, n = 0; k < 5; ++k)
            if (k != i) graph[static_cast<std::size_t>(i)][static_cast<std::size_t>(n++)] = k;
    const LossGradient<double> l = smoothness(values, graph);
    CHECK(l.value == doctest::Approx(8.0 / 5).epsilon(1e-14));
    // Each of the 8 squares has the slope 2 / 5 by the last point, and -2 / 5 by the other.
    CHECK(l.gradient(0, 4) == doctest::Approx(16.0 / 5).epsilon(1e-14));
    CHECK(l.gradient(0, 0) == doctest::Approx(-4.0 / 5).epsilon(1e-14));
    CHECK(smoothness(Columns<double>(values.replicate(2, 1)), graph).value ==
          doctest::Approx(8.0 / 5).epsilon(1e-14));  // a mean over channels
}

TEST_CASE("smoothness: the same bits on threads, of more points than a chunk") {
    const Columns<float> points = random_columns<float>(3, 700, 1),
                         values = random_columns<float>(5, 700, 2);
    const detail::NeighbourGraph graph = detail::four_nearest(points);
    ThreadPool pool(3);
    const LossGradient<float> a = smoothness(values, graph),
                              b = smoothness(pool.threads(), values, graph,
                                             detail::neighbour_of(graph));
    CHECK(a.value == b.value);
    CHECK(a.gradient == b.gradient);
    CHECK(a.gradient.rowwise().sum().cwiseAbs().maxCoeff() < 1e-6F);  // no point pulls on itself
}
