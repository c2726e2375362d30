// SPDX-License-Identifier: Apache-2.0
#include <rye/geometry/mesh.hpp>

#include <cmath>

#include <doctest/doctest.h>

#include "../support/laws.hpp"

using namespace rye;

namespace {

/// A flat n x n sheet of squares, each cut along the same diagonal.
TriangleMesh<double> sheet(Index n) {
    TriangleMesh<double> m;
    m.vertices.resize(3, (n + 1) * (n + 1));
    const auto at = [&](Index x, Index y) { return y * (n + 1) + x; };
    for (Index y = 0; y <= n; ++y)
        for (Index x = 0; x <= n; ++x)
            m.vertices.col(at(x, y)) << static_cast<double>(x), static_cast<double>(y), 7;
    for (Index y = 0; y < n; ++y)
        for (Index x = 0; x < n; ++x) {
            m.faces.push_back({at(x, y), at(x + 1, y), at(x + 1, y + 1)});
            m.faces.push_back({at(x, y), at(x + 1, y + 1), at(x, y + 1)});
        }
    return m;
}

double laplacian_dot_error(const Columns<double>& x, const std::vector<Face>& faces) {
    const Columns<double> dx = random_columns<double>(x.rows(), x.cols(), 2);
    const Columns<double> w = random_columns<double>(x.rows(), x.cols(), 3);
    DotProducts d;
    d.add_forward(tangents<double>(uniform_laplacian<Dual<double, 1>>(lifted(x, dx), faces)), w);
    d.add_reverse(laplacian_vjp<double>(faces, w), dx);
    return d.error();
}

} // namespace

TEST_CASE("uniform_laplacian: 0 inside a regular flat sheet, towards the sheet at its rim") {
    const TriangleMesh<double> m = sheet(4);
    const Columns<double> l = uniform_laplacian<double>(m.vertices, m.faces);
    for (Index y = 1; y < 4; ++y)
        for (Index x = 1; x < 4; ++x) CHECK(l.col(y * 5 + x).norm() == 0);
    CHECK(l(1, 2) > 0);   // upward at the lower rim
    CHECK(l(1, 22) < 0);  // downward at the upper rim
    CHECK(l.row(2).norm() == 0);
}

TEST_CASE("uniform_laplacian: one triangle, an isolated vertex, a bow-tie") {
    Columns<double> x(3, 6);
    x << 0, 3, 0, -3, 0, 9,  //
        0, 0, 3, 0, -3, 9,   //
        0, 0, 0, 0, 0, 9;
    const std::vector<Face> one{{0, 1, 2}}, bow_tie{{0, 1, 2}, {0, 3, 4}};
    Columns<double> l = uniform_laplacian<double>(x, one);
    CHECK(l.col(0) == Vec3<double>(1.5, 1.5, 0));
    CHECK(l.col(1) == Vec3<double>(-3, 1.5, 0));
    CHECK(l.rightCols(3).norm() == 0);  // vertices without faces: no division by 0
    l = uniform_laplacian<double>(x, bow_tie);
    CHECK(l.col(0).norm() == 0);
    CHECK(l.col(5).norm() == 0);
    CHECK(laplacian_vjp<double>(bow_tie, Columns<double>::Ones(3, 6)).allFinite());
    CHECK(uniform_laplacian<double>(x, {}).norm() == 0);
    CHECK(uniform_laplacian<double>(Columns<double>(3, 0), {}).cols() == 0);
}

TEST_CASE("uniform_laplacian: the vjp is the transpose") {
    const TriangleMesh<double> m = sheet(6);
    CHECK(laplacian_dot_error(random_columns<double>(3, m.vertices.cols(), 1), m.faces) < 1e-14);
    CHECK(laplacian_dot_error(random_columns<double>(2, 7, 1), {{0, 1, 2}, {0, 3, 4}, {0, 1, 2}}) <
          1e-14);
}

TEST_CASE("area_vector: a sliver keeps its area far from the origin") {
    for (const float offset : {0.0f, 1000.0f})
        for (const float h : {1e-1f, 1e-2f, 1e-3f, 1e-4f, 1e-6f, 1e-8f, 0.0f}) {
            const Vec3<float> a(offset, offset, offset), b(offset + 1, offset, offset),
                c(offset + 0.5f, offset + h, offset);
            const double area = area_vector<float>(a, b, c).cast<double>().norm();
            const double truth =
                area_vector<double>(a.cast<double>(), b.cast<double>(), c.cast<double>()).norm();
            CHECK(std::abs(area - truth) <= 1e-6 * truth);
        }
    CHECK(area_vector<double>({0, 0, 0}, {1, 0, 0}, {0, 1, 0}) == Vec3<double>(0, 0, 1));
}
