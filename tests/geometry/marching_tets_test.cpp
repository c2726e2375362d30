// SPDX-License-Identifier: Apache-2.0
#include <rye/geometry/marching_tets.hpp>

#include <cmath>
#include <limits>
#include <map>

#include <doctest/doctest.h>

#include <rye/core/thread_pool.hpp>

#include "../support/flush_to_zero.hpp"
#include "../support/laws.hpp"
#include "../support/unit_tetrahedron.hpp"

using namespace rye;

namespace {

template <class T>
TetGrid<T> cube(T half, T cell) {
    return bcc_grid<T>(Vec3<T>::Constant(-half), Vec3<T>::Constant(half), cell);
}

template <class T>
Columns<T> sphere_sdf(const Columns<T>& x, T radius) {
    return (x.colwise().norm().array() - radius).matrix();
}

template <class T>
T face_area(const Surface<T>& s, const Face& f) {
    return area_vector<T>(s.positions.col(f[0]), s.positions.col(f[1]), s.positions.col(f[2])).norm();
}

/// Whether each directed edge occurs once and so does its reverse: closed, consistently oriented.
bool watertight(const std::vector<Face>& faces) {
    std::map<Edge, int> uses;
    for (const Face& f : faces)
        for (std::size_t k = 0; k < 3; ++k) ++uses[{f[k], f[(k + 1) % 3]}];
    for (const auto& [e, n] : uses) {
        const auto back = uses.find({e[1], e[0]});
        if (n != 1 || back == uses.end() || back->second != 1) return false;
    }
    return true;
}

Index euler(const SurfaceTopology& s) {
    return s.vertex_count() - static_cast<Index>(3 * s.faces.size() / 2) +
           static_cast<Index>(s.faces.size());
}

/// The dot-product test of positions and features on a fixed topology.
template <class T>
double surface_dot_error(const TetGrid<T>& grid, const Columns<T>& sdf, Index channels) {
    using D = Dual<T, 1>;
    const Index v = grid.vertices.cols();
    const Columns<T> features = random_columns<T>(channels, v, 1);
    const Columns<T> dx = random_columns<T>(3, v, 2), ds = random_columns<T>(1, v, 3),
                     df = random_columns<T>(channels, v, 4);
    const Surface<T> s = marching_tetrahedra<T>(grid.topology, grid.vertices, sdf);
    const Index m = s.topology.vertex_count();
    const Columns<T> wx = random_columns<T>(3, m, 5), wf = random_columns<T>(channels, m, 6);
    const Columns<D> fraction = detail::crossing_fractions<D>(s.topology, lifted(sdf, ds));
    DotProducts d;
    d.add_forward(tangents<T>(surface_positions<D>(s.topology, lifted(grid.vertices, dx),
                                                   lifted(sdf, ds))), wx);
    d.add_forward(tangents<T>(interpolate<D>(s.topology, fraction, lifted(features, df))), wf);
    const SurfaceGradient<T> g = surface_vjp<T>(s, {grid.vertices, sdf, features}, {wx, wf});
    d.add_reverse(g.vertices, dx);
    d.add_reverse(g.sdf, ds);
    d.add_reverse(g.features, df);
    return d.error();
}

} // namespace

TEST_CASE("marching_tetrahedra: the published example") {
    const TetGrid<double> g = test::unit_tet();
    Columns<double> sdf(1, 4), expected(3, 4);
    sdf << -1, -1, 0.5, 0.5;
    const Surface<double> s = marching_tetrahedra<double>(g.topology, g.vertices, sdf);
    const double a = 2.0 / 3, b = 1.0 / 3;
    expected << 0, 0, b, b, a, 0, a, 0, 0, a, 0, a;
    CHECK((s.positions - expected).norm() < 1e-15);
    CHECK(s.topology.faces == std::vector<Face>{{3, 0, 1}, {3, 2, 0}});
    CHECK(s.topology.edges == std::vector<Edge>{{0, 2}, {0, 3}, {1, 2}, {1, 3}});
}

TEST_CASE("marching_tetrahedra: in all sixteen cases normals point outside") {
    const TetGrid<double> g = test::unit_tet();
    for (int bits = 0; bits < 16; ++bits) {
        Columns<double> sdf(1, 4);
        for (int i = 0; i < 4; ++i) sdf(0, i) = (bits >> i & 1) != 0 ? 0.7 : -0.4;
        const Surface<double> s = marching_tetrahedra<double>(g.topology, g.vertices, sdf);
        const int outside = (bits & 1) + (bits >> 1 & 1) + (bits >> 2 & 1) + (bits >> 3 & 1);
        const int triangles = outside == 0 || outside == 4 ? 0 : outside == 2 ? 2 : 1;
        CHECK(s.topology.faces.size() == static_cast<std::size_t>(triangles));
        CHECK(s.topology.edges.size() == static_cast<std::size_t>(outside * (4 - outside)));
        // sdf = linear function with that sdf at the corners: its gradient points outside.
        const Vec3<double> gradient(sdf(0, 1) - sdf(0, 0), sdf(0, 2) - sdf(0, 0),
                                    sdf(0, 3) - sdf(0, 0));
        for (const Face& f : s.topology.faces)
            CHECK(area_vector<double>(s.positions.col(f[0]), s.positions.col(f[1]),
                                      s.positions.col(f[2])).dot(gradient) > 0);
    }
}

TEST_CASE("marching_tetrahedra: a sphere is closed, of Euler characteristic 2, on three grids") {
    double last_error = 1;
    for (const double cell : {0.5, 0.25, 0.125}) {
        const TetGrid<double> g = cube(1.5, cell);
        const Surface<double> s =
            marching_tetrahedra<double>(g.topology, g.vertices, sphere_sdf<double>(g.vertices, 1));
        CHECK(watertight(s.topology.faces));
        CHECK(euler(s.topology) == 2);
        double volume = 0;
        for (const Face& f : s.topology.faces) {
            const Vec3<double> a = s.positions.col(f[0]);
            volume += a.dot(area_vector<double>(a, s.positions.col(f[1]), s.positions.col(f[2]))) / 6;
        }
        const double error = std::abs(volume - 4.18879020478639) / 4.18879020478639;
        CHECK(error < last_error / 3);  // second order: a quarter each time
        last_error = error;
    }
    CHECK(last_error < 0.01);
}

TEST_CASE("marching_tetrahedra: a torus has Euler characteristic 0, random signs stay closed") {
    const TetGrid<float> g = cube(1.5f, 0.2f);
    Columns<float> torus(1, g.vertices.cols());
    for (Index i = 0; i < torus.cols(); ++i)
        torus(0, i) = std::hypot(std::hypot(g.vertices(0, i), g.vertices(1, i)) - 0.8f,
                                 g.vertices(2, i)) - 0.4f;
    const SurfaceTopology ring = surface_topology<float>(g.topology, torus);
    CHECK(watertight(ring.faces));
    CHECK(euler(ring) == 0);

    Columns<float> noise = random_columns<float>(1, g.vertices.cols(), 7);
    for (Index i = 0; i < noise.cols(); ++i)  // outside at the border: closed surface
        if (g.vertices.col(i).cwiseAbs().maxCoeff() > 1.45f) noise(0, i) = 0.5f;
    CHECK(watertight(surface_topology<float>(g.topology, noise).faces));
}

TEST_CASE("marching_tetrahedra: a surface through lattice vertices has no face without area") {
    const TetGrid<float> g = cube(1.0f, 0.25f);
    for (const float scale : {1.0f, 1e-3f}) {
        const Columns<float> plane = scale * g.vertices.row(2);  // exactly 0 on a layer of vertices
        const Surface<float> s = marching_tetrahedra<float>(g.topology, g.vertices, plane);
        CHECK(!s.topology.faces.empty());
        float least = 1, reach = 0;
        for (const Face& f : s.topology.faces) least = std::min(least, face_area(s, f));
        reach = s.positions.row(2).cwiseAbs().maxCoeff();
        CHECK(least > 0);
        CHECK(reach < 1e-4f);
    }
}

TEST_CASE("marching_tetrahedra: values too small to divide give the middle and no gradient") {
    const TetGrid<float> g = [] {
        TetGrid<float> t;
        const TetGrid<double> d = test::unit_tet();
        t.vertices = d.vertices.cast<float>();
        t.topology = d.topology;
        return t;
    }();
    for (const float e : {1e-3f, 1e-20f, 1e-38f, 1e-45f}) {
        Columns<float> sdf(1, 4);
        sdf << -e, e, e, e;
        const Surface<float> s = marching_tetrahedra<float>(g.topology, g.vertices, sdf);
        if (flushed() && e < std::numeric_limits<float>::min()) {
            CHECK(s.topology.faces.empty()); // denormals are 0, which is inside
            continue;
        }
        CHECK(s.topology.faces.size() == 1);
        CHECK((s.fraction.array() == 0.5f).all());
        const Columns<float> w = Columns<float>::Ones(3, 3), none(0, 3), no_features(0, 4);
        const SurfaceGradient<float> gradient =
            surface_vjp<float>(s, {g.vertices, sdf, no_features}, {w, none});
        CHECK(gradient.sdf.allFinite());
        CHECK((gradient.sdf.norm() > 0) == (e > 1e-8f));
        CHECK(gradient.vertices.sum() == doctest::Approx(9));
    }
}

TEST_CASE("marching_tetrahedra: no surface, one tetrahedron, values that are not finite") {
    const TetGrid<double> g = test::unit_tet();
    for (const double value : {1.0, -1.0, 0.0}) {
        const Columns<double> sdf = Columns<double>::Constant(1, 4, value);
        const Surface<double> s = marching_tetrahedra<double>(g.topology, g.vertices, sdf);
        CHECK(s.topology.faces.empty());
        CHECK(s.positions.cols() == 0);
        CHECK(interpolate<double>(s.topology, s.fraction, Columns<double>::Ones(5, 4)).rows() == 5);
        const Columns<double> none(3, 0), no_features(2, 0);
        const SurfaceGradient<double> gradient = surface_vjp<double>(
            s, {g.vertices, sdf, Columns<double>::Ones(2, 4)}, {none, no_features});
        CHECK(gradient.sdf.norm() == 0);
        CHECK(gradient.vertices.norm() == 0);
        CHECK(detail::touched_vertices(s.topology).empty());
    }
    for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity()}) {
        Columns<double> sdf = Columns<double>::Constant(1, 4, 1.0);
        sdf(0, 2) = bad;
        CHECK_THROWS_AS(marching_tetrahedra<double>(g.topology, g.vertices, sdf), Error);
    }
}

TEST_CASE("marching_tetrahedra: the vjp is the transpose of the jvp on duals") {
    const TetGrid<double> g = cube(1.5, 0.3);
    const TetGrid<float> gf = cube(1.5f, 0.3f);
    CHECK(surface_dot_error<double>(g, sphere_sdf<double>(g.vertices, 1), 5) < 1e-14);
    CHECK(surface_dot_error<double>(g, random_columns<double>(1, g.vertices.cols(), 9), 5) < 1e-13);
    CHECK(surface_dot_error<double>(g, g.vertices.row(1), 5) < 1e-14);  // through vertices
    CHECK(surface_dot_error<double>(g, 1e-9 * g.vertices.row(1), 5) < 1e-14);
    CHECK(surface_dot_error<float>(gf, sphere_sdf<float>(gf.vertices, 1), 5) < 2e-6);
    CHECK(surface_dot_error<float>(gf, random_columns<float>(1, gf.vertices.cols(), 9), 5) < 1e-5);
}

TEST_CASE("touched_vertices: the surface over them alone is the same surface") {
    const TetGrid<double> g = cube(1.5, 0.3);
    const Columns<double> sdf = sphere_sdf<double>(g.vertices, 1);
    const Surface<double> s = marching_tetrahedra<double>(g.topology, g.vertices, sdf);
    const std::vector<Index> touched = detail::touched_vertices(s.topology);
    CHECK(touched.size() < static_cast<std::size_t>(g.vertices.cols() / 2));
    Columns<double> x(3, static_cast<Index>(touched.size())), d(1, x.cols());
    for (Index i = 0; i < x.cols(); ++i) {
        x.col(i) = g.vertices.col(touched[static_cast<std::size_t>(i)]);
        d.col(i) = sdf.col(touched[static_cast<std::size_t>(i)]);
    }
    const SurfaceTopology small = detail::over_touched(s.topology, touched);
    CHECK(small.faces == s.topology.faces);
    CHECK(surface_positions<double>(small, x, d) == s.positions);
}

TEST_CASE("marching_tetrahedra: any number of threads, the same surface and gradient to the bit") {
    // More edges and tetrahedra than a chunk has, and as many features as go by grid vertex.
    const TetGrid<float> g = cube<float>(1.5F, 0.2F);
    const Columns<float> sdf = sphere_sdf<float>(g.vertices, 1);
    REQUIRE(g.topology.tets.size() > 2 * 16384);
    ThreadPool pool(5);
    const ScalarBackend many{pool.threads()};
    const SurfaceTopology top = surface_topology<float>(g.topology, sdf);
    const SurfaceTopology same = surface_topology<float>(many, g.topology, sdf);
    CHECK(same.edges == top.edges);
    CHECK(same.faces == top.faces);
    const Surface<float> s = marching_tetrahedra<float>(g.topology, g.vertices, sdf);
    const Index m = s.positions.cols();
    const Columns<float> features = random_columns<float>(33, sdf.cols(), 1),
                         wf = random_columns<float>(33, m, 2), wx = random_columns<float>(3, m, 3);
    CHECK(interpolate<float>(many, top, s.fraction, features) ==
          interpolate<float>(top, s.fraction, features));
    const auto one = surface_vjp<float>(s, {g.vertices, sdf, features}, {wx, wf});
    const auto five = surface_vjp<float>(many, s, {g.vertices, sdf, features}, {wx, wf});
    CHECK(five.vertices == one.vertices);
    CHECK(five.sdf == one.sdf);
    CHECK(five.features == one.features);
    Columns<float> bad = sdf;
    bad(0, 70) = bad(0, bad.cols() - 1) = std::numeric_limits<float>::infinity();
    CHECK_THROWS_WITH_AS(surface_topology<float>(many, g.topology, bad),
                         doctest::Contains("vertex 70 is"), Error);
}
