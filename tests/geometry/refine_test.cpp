// SPDX-License-Identifier: Apache-2.0
#include <rye/geometry/refine.hpp>

#include <doctest/doctest.h>

#include <cmath>
#include <map>

using namespace rye;

namespace {

TriangleMesh<double> octahedron() {
    TriangleMesh<double> m;
    m.vertices.resize(3, 6);
    m.vertices << 1, -1, 0, 0, 0, 0,  //
        0, 0, 1, -1, 0, 0,            //
        0, 0, 0, 0, 1, -1;
    m.faces = {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4},
               {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};
    return m;
}

/// Six times the enclosed volume, and whether each edge is met once in either direction.
double volume(const TriangleMesh<double>& m) {
    double sum = 0;
    for (const auto& [a, b, c] : m.faces)
        sum += m.vertices.col(a).dot(
            cross<double>(Vec3<double>(m.vertices.col(b)), Vec3<double>(m.vertices.col(c))));
    return sum;
}

bool closed(const TriangleMesh<double>& m) {
    std::map<Edge, int> met;
    for (const auto& [a, b, c] : m.faces) ++met[{a, b}], ++met[{b, c}], ++met[{c, a}];
    for (const auto& [edge, count] : met)
        if (count != 1 || met.count({edge[1], edge[0]}) != 1) return false;
    return true;
}

} // namespace

TEST_CASE("refined where it is wanted, a closed surface stays closed and keeps its volume") {
    TriangleMesh<double> m = octahedron();
    Columns<double> twice = 2 * m.vertices;
    const auto limit = [](const Vec3<double>& x) { return 0.3 + 0.4 * std::abs(x.z() - 1); };
    refine(m, twice, limit, 8);
    CHECK(m.vertices.cols() > 30);
    CHECK(closed(m));
    CHECK(volume(m) == doctest::Approx(volume(octahedron())).epsilon(1e-12));
    CHECK(twice.isApprox(2 * m.vertices, 1e-15));
    double longest = 0;
    for (const auto& f : m.faces)
        for (std::size_t k = 0; k < 3; ++k) {
            const Vec3<double> a = m.vertices.col(f[k]), b = m.vertices.col(f[(k + 1) % 3]);
            longest = std::max(longest, (a - b).norm() / limit(Vec3<double>(0.5 * (a + b))));
        }
    CHECK(longest <= 1);
}

TEST_CASE("a surface that is fine already stays as it is") {
    TriangleMesh<double> m = octahedron();
    Columns<double> none(1, 6);
    none.setZero();
    refine(m, none, [](const Vec3<double>&) { return 2.0; }, 6);
    CHECK(m.vertices == octahedron().vertices);
    CHECK(m.faces == octahedron().faces);
}
