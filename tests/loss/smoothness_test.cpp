// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <rye/autodiff/dual.hpp>
#include <rye/core/random.hpp>
#include <rye/loss/smoothness.hpp>

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
    const NeighbourGraph graph = four_nearest(points);
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
    auto of_middle = four_nearest(line, 100)[4];
    std::sort(of_middle.begin(), of_middle.end());
    CHECK(of_middle == std::array<Index, 4>{102, 103, 105, 106});
    CHECK_THROWS_AS(four_nearest(Columns<float>(line.leftCols(4))), Error);
}

TEST_CASE("smoothness: by hand, one point of five that differs from its neighbours") {
    // Points 0, 0, 0, 0 and 1, each with the four others as neighbours: the last differs by 1 from
    // four, each of the others by 1 from one. 8 squares, over 5 numbers.
    Columns<double> values(1, 5);
    values << 0, 0, 0, 0, 1;
    NeighbourGraph graph(5);
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
