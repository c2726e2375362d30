// SPDX-License-Identifier: Apache-2.0
#include <rye/geometry/tet_grid.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>

#include <doctest/doctest.h>

#include "../support/unit_tetrahedron.hpp"

using namespace rye;

namespace {

double total_volume(const TetGrid<double>& g) {
    double sum = 0;
    for (const Tet& t : g.topology.tets) sum += tet_volume<double>(g.vertices, t);
    return sum;
}

double least_volume(const TetGrid<double>& g) {
    double least = std::numeric_limits<double>::infinity();
    for (const Tet& t : g.topology.tets) least = std::min(least, tet_volume<double>(g.vertices, t));
    return least;
}

/// Area of the triangles that belong to one tetrahedron only; -1 if any belongs to more than two.
double boundary_area(const TetGrid<double>& g) {
    std::map<Face, int> uses;
    for (const Tet& t : g.topology.tets)
        for (std::size_t skip = 0; skip < 4; ++skip) {
            Face f{t[(skip + 1) % 4], t[(skip + 2) % 4], t[(skip + 3) % 4]};
            std::sort(f.begin(), f.end());
            ++uses[f];
        }
    double area = 0;
    for (const auto& [f, n] : uses) {
        if (n > 2) return -1;
        if (n == 1)
            area += 0.5 * area_vector<double>(g.vertices.col(f[0]), g.vertices.col(f[1]),
                                              g.vertices.col(f[2]))
                              .norm();
    }
    return area;
}

void check_edges(const TetTopology& t) {
    CHECK(std::is_sorted(t.edges.begin(), t.edges.end()));
    CHECK(std::adjacent_find(t.edges.begin(), t.edges.end()) == t.edges.end());
    std::set<Index> used;
    bool right = t.tet_edges.size() == t.tets.size();
    for (std::size_t i = 0; right && i < t.tets.size(); ++i)
        for (std::size_t e = 0; e < 6; ++e) {
            const auto [a, b] = t.edges[static_cast<std::size_t>(t.tet_edges[i][e])];
            const Index p = t.tets[i][detail::tet_edge_corners[e][0]],
                        q = t.tets[i][detail::tet_edge_corners[e][1]];
            right = right && a == std::min(p, q) && b == std::max(p, q);
            used.insert(t.tet_edges[i][e]);
        }
    CHECK(right);
    CHECK(used.size() == t.edges.size());
}

} // namespace

TEST_CASE("subdivide: one tetrahedron becomes the eight of the published example") {
    const TetGrid<double> g = subdivide(test::unit_tet());
    CHECK(g.vertices.cols() == 10);
    CHECK(g.vertices.col(7) == Vec3<double>(0.5, 0.5, 0));
    const std::vector<Tet> expected{{0, 4, 5, 6}, {1, 7, 4, 8}, {2, 5, 7, 9}, {3, 6, 9, 8},
                                    {4, 5, 6, 8}, {4, 5, 8, 7}, {9, 5, 8, 6}, {9, 5, 7, 8}};
    CHECK(g.topology.tets == expected);
    CHECK(total_volume(g) == doctest::Approx(1.0 / 6).epsilon(1e-14));
    CHECK(least_volume(g) == doctest::Approx(1.0 / 48).epsilon(1e-14));
}

TEST_CASE("bcc_grid: fills the box once, conformingly, with positive tetrahedra") {
    struct Box {
        Vec3<double> lo, hi;
        double cell;
    };
    for (const Box& box : {Box{{0, 0, 0}, {1, 1, 1}, 2.0}, Box{{-1, -2, 3}, {0.5, 1, 4}, 0.4},
                           Box{{-1.75, -1.75, -1.75}, {1.75, 1.75, 1.75}, 0.5}}) {
        const TetGrid<double> g = bcc_grid<double>(box.lo, box.hi, box.cell);
        const Vec3<double> side = box.hi - box.lo;
        CHECK(total_volume(g) == doctest::Approx(side.prod()).epsilon(1e-12));
        CHECK(least_volume(g) > 0);
        const double surface =
            2 * (side[0] * side[1] + side[1] * side[2] + side[2] * side[0]);
        CHECK(boundary_area(g) == doctest::Approx(surface).epsilon(1e-12));
        CHECK((g.vertices.rowwise().minCoeff() - box.lo).norm() == 0);
        CHECK((g.vertices.rowwise().maxCoeff() - box.hi).norm() == 0);
        check_edges(g.topology);
        const Index v = g.vertices.cols(), e = static_cast<Index>(g.topology.edges.size());
        const TetGrid<double> fine = subdivide(g);
        CHECK(fine.vertices.cols() == v + e);
        CHECK(fine.topology.tets.size() == 8 * g.topology.tets.size());
        CHECK(total_volume(fine) == doctest::Approx(side.prod()).epsilon(1e-12));
        CHECK(least_volume(fine) > 0);
        CHECK(boundary_area(fine) == doctest::Approx(surface).epsilon(1e-12));
        check_edges(fine.topology);
    }
}

TEST_CASE("bcc_grid: twelve tetrahedra, two vertices and fourteen edges a cell, but for the border") {
    // Differences over n of cubic counts, three times, leave 6 times the leading coefficient.
    double v[4], t[4], e[4];
    for (int n = 2; n < 6; ++n) {
        const TetGrid<float> g = bcc_grid<float>({0, 0, 0}, {1, 1, 1}, 1.0f / static_cast<float>(n));
        v[n - 2] = static_cast<double>(g.vertices.cols());
        t[n - 2] = static_cast<double>(g.topology.tets.size());
        e[n - 2] = static_cast<double>(g.topology.edges.size());
    }
    const auto leading = [](const double* x) { return (x[3] - 3 * x[2] + 3 * x[1] - x[0]) / 6; };
    CHECK(leading(v) == 2);
    CHECK(leading(t) == 12);
    CHECK(leading(e) == 14);
}

TEST_CASE("bcc_grid: a symmetric box gives a symmetric lattice, to the last bit") {
    const TetGrid<float> g = bcc_grid<float>({-1.7f, -1, -1}, {1.7f, 1, 1}, 0.3f);
    std::set<std::array<float, 3>> points;
    for (Index i = 0; i < g.vertices.cols(); ++i)
        points.insert({g.vertices(0, i), g.vertices(1, i), g.vertices(2, i)});
    CHECK(points.size() == static_cast<std::size_t>(g.vertices.cols()));
    bool mirrored = true;
    for (const auto& [x, y, z] : points) mirrored = mirrored && points.count({-x, y, z}) == 1;
    CHECK(mirrored);
}

TEST_CASE("tet grids: bad input is refused in words") {
    const Vec3<double> zero(0, 0, 0), one(1, 1, 1);
    CHECK_THROWS_AS(bcc_grid<double>(zero, one, 0.0), Error);
    CHECK_THROWS_AS(bcc_grid<double>(zero, one, -0.1), Error);
    CHECK_THROWS_AS(bcc_grid<double>(zero, one, std::nan("")), Error);
    CHECK_THROWS_AS(bcc_grid<double>(one, zero, 0.1), Error);
    CHECK_THROWS_AS(bcc_grid<double>(zero, one, 1e-9), Error);
    CHECK_THROWS_AS(tet_topology(3, {{0, 1, 2, 3}}), Error);
    CHECK_THROWS_AS(tet_topology(4, {{0, 1, 1, 3}}), Error);
    CHECK_THROWS_AS(tet_topology(4, {{-1, 1, 2, 3}}), Error);
    CHECK(tet_topology(0, {}).edges.empty());
}
