// SPDX-License-Identifier: Apache-2.0
// The zero surface, degenerate triangles, silhouettes (G1-G7).
#include <limits>
#include <map>

#include <rye/backend/scalar.hpp>
#include <rye/geometry/marching_tets.hpp>
#include <rye/geometry/mesh_raster.hpp>
#include <rye/geometry/silhouette.hpp>

#include "report.hpp"

namespace rye::hard {
namespace {

template <class T>
TetGrid<T> cube(double cell) {
    return bcc_grid<T>(Vec3<T>::Constant(T(-1)), Vec3<T>::Constant(T(1)), static_cast<T>(cell));
}
template <class T>
double area(const Columns<T>& x, const Face& f) {
    return 0.5 * double(norm(area_vector<T>(x.col(f[0]), x.col(f[1]), x.col(f[2]))));
}

template <class T>
void g1_g3(Report& report) {
    const TetGrid<T> grid = cube<T>(0.5);
    // The plane z = 0 goes through grid vertices.
    const Columns<T> plane = grid.vertices.row(2);
    const auto s = marching_tetrahedra<T>(grid.topology, grid.vertices, plane);
    double least = 1, naive_least = 1;
    for (const Face& f : s.topology.faces) least = std::min(least, area(s.positions, f));
    Columns<T> naive(3, s.topology.vertex_count());
    for (Index i = 0; i < naive.cols(); ++i) {
        const auto [a, b] = s.topology.edges[static_cast<std::size_t>(i)];
        const T t = plane(0, a) / (plane(0, a) - plane(0, b));
        naive.col(i) = grid.vertices.col(a) + t * (grid.vertices.col(b) - grid.vertices.col(a));
    }
    for (const Face& f : s.topology.faces) naive_least = std::min(naive_least, area(naive, f));
    report.holds("G1", kind_of<T>(), "plane through grid vertices: every face has an area",
                 least > 0 && s.positions.allFinite());
    report.textbook_fails("G1", kind_of<T>(), "t = s0 / (s0 - s1) unclamped: least area > 0",
                          naive_least > 0);
    Columns<T> faint(1, grid.vertices.cols());
    const T tiny = static_cast<T>(1e-40);
    for (Index i = 0; i < faint.cols(); ++i)
        faint(0, i) = grid.vertices(2, i) + T(0.1) > T(0) ? tiny : T(-tiny);
    const auto f = marching_tetrahedra<T>(grid.topology, grid.vertices, faint);
    report.holds("G1", kind_of<T>(), "all |s| = 1e-40: finite, halfway",
                 f.positions.allFinite() && f.fraction.isConstant(T(0.5)));
    bool empty = true;
    for (const T v : {T(1), T(-1), T(0)}) {
        const Columns<T> all = Columns<T>::Constant(1, grid.vertices.cols(), v);
        const auto none = marching_tetrahedra<T>(grid.topology, grid.vertices, all);
        const auto g = surface_vjp<T>(none, {grid.vertices, all, Columns<T>(0, all.cols())},
                                      {Columns<T>(3, 0), Columns<T>(0, 0)});
        empty = empty && none.topology.faces.empty() && g.sdf.isZero(0) && g.vertices.isZero(0);
    }
    report.holds("G3", kind_of<T>(), "all outside, all inside, all 0: no face, gradient 0", empty);
    const T faces = T(0);
    report.textbook_fails("G3", kind_of<T>(), "mean over the vertices of no surface",
                          std::isfinite(faces / faces));
}

template <class T>
void g2(Report& report) {
    SurfaceTopology one;
    one.edges.push_back({0, 1});
    bool half = true, finite = true, textbook = true;
    for (const double e : {1e-3, 1e-20, 1e-38, 1e-45}) {
        Columns<T> s(1, 2), g = Columns<T>::Zero(1, 2);
        s << static_cast<T>(e), static_cast<T>(-e);
        const Columns<T> t = detail::crossing_fractions<T>(one, s);
        half = half && t(0, 0) == T(0.5);
        detail::crossing_fractions_vjp<T>(one, s, Columns<T>::Ones(1, 1), g);
        finite = finite && g.allFinite() && (e > 1e-8 || g.isZero(0));
        const T difference = s(0, 0) - s(0, 1);
        textbook = textbook && std::isfinite(-s(0, 1) / (difference * difference));
    }
    report.holds("G2", kind_of<T>(), "s = +-{1e-3, 1e-20, 1e-38, 1e-45}: t = 1/2", half);
    report.holds("G2", kind_of<T>(), "the same: gradient finite, 0 below the floor", finite);
    if (sizeof(T) == 4) report.textbook_fails("G2", kind_of<T>(), "-s1 / (s0 - s1)^2", textbook);
}

template <class T>
void g4(Report& report) {
    double worst = 0, naive = 0;
    for (const double offset : {0.0, 1e3})
        for (const double h : {1e-1, 1e-2, 1e-3, 1e-4}) {
            const T o = static_cast<T>(offset), top = static_cast<T>(offset + h);
            const Vec3<T> a(o, o, o), b(o + T(1), o, o), c(o, top, o);
            const double truth = 0.5 * (double(top) - double(o)) * 1.0; // of the given floats
            if (truth == 0) continue;
            worsen(worst, std::abs(0.5 * double(norm(area_vector(a, b, c))) / truth - 1));
            // Twice the area as a x b + b x c + c x a.
            const Vec3<T> n = cross(a, b) + cross(b, c) + cross(c, a);
            worsen(naive, std::abs(0.5 * double(norm(n)) / truth - 1));
        }
    report.at_most("G4", kind_of<T>(), "base 1, h to 1e-4, at 0 and 1e3: area, relative",
                   sizeof(T) == 4 ? 1e-5 : 1e-13, worst);
    report.textbook("G4", kind_of<T>(), "a x b + b x c + c x a", sizeof(T) == 4 ? 1e-5 : 1e-13,
                    naive);
    // A face without area is skipped.
    Columns<T> x(3, 3);
    x << T(-1), T(1), T(0), T(0), T(0), T(0), T(2), T(2), T(2);
    Pinhole<T> camera;
    camera.fx = camera.fy = T(8), camera.cx = camera.cy = T(8);
    camera.width = camera.height = 16;
    Columns<T> values = Columns<T>::Ones(1, 3);
    const std::vector<Face> one{{0, 1, 2}};
    const auto r = rasterize_mesh<T>(ScalarBackend<>{}, {x, one, values}, camera);
    report.holds("G4", kind_of<T>(), "h = 0: not drawn, all finite",
                 r.attributes.pixels.allFinite() && r.mask.pixels.isZero(0));
}

template <class T>
void g5(Report& report) {
    Columns<T> x(3, 6);
    x << T(0), T(1), T(0), T(5), T(2), T(1), T(0), T(0), T(1), T(5), T(0), T(2), T(0), T(0), T(0),
        T(5), T(0), T(1);
    const std::vector<Face> faces{{0, 1, 2}, {0, 4, 5}}; // a bow-tie; vertex 3 is alone
    const Columns<T> l = uniform_laplacian<T>(x, faces);
    const Columns<T> g = laplacian_vjp<T>(faces, Columns<T>::Ones(3, 6));
    report.holds("G5", kind_of<T>(), "isolated vertex, bow-tie: Laplacian 0 there, all finite",
                 l.allFinite() && l.col(3).isZero(0) && g.allFinite() && g.col(3).isZero(0));
    const T degree = T(0);
    report.textbook_fails("G5", kind_of<T>(), "sum / degree of an isolated vertex",
                          std::isfinite(degree / degree));
}

template <class T>
void g6(Report& report) {
    bool closed = true, round = true;
    for (const double cell : {0.6, 0.35, 0.2}) {
        const TetGrid<T> grid = cube<T>(cell);
        Columns<T> sphere(1, grid.vertices.cols());
        for (Index i = 0; i < sphere.cols(); ++i)
            sphere(0, i) = norm(Vec3<T>(grid.vertices.col(i))) - T(0.7);
        const auto s = marching_tetrahedra<T>(grid.topology, grid.vertices, sphere);
        std::map<Edge, int> uses;
        for (const Face& f : s.topology.faces)
            for (std::size_t k = 0; k < 3; ++k) ++uses[{f[k], f[(k + 1) % 3]}];
        for (const auto& [e, n] : uses) closed = closed && n == 1 && uses.count({e[1], e[0]}) == 1;
        const auto faces = static_cast<Index>(s.topology.faces.size());
        round = round && s.topology.vertex_count() - 3 * faces / 2 + faces == 2;
    }
    report.holds("G6", kind_of<T>(), "sphere in 3 grids: each directed edge once, its reverse once",
                 closed);
    report.holds("G6", kind_of<T>(), "the same: Euler characteristic 2", round);
}

template <class T>
void g7(Report& report) {
    // Edge-on, behind the camera, and far outside: the soft mask and its gradient stay finite.
    bool finite = true;
    Pinhole<T> camera;
    camera.fx = camera.fy = T(8), camera.cx = camera.cy = T(8);
    camera.width = camera.height = 16;
    Columns<T> edge(3, 3), behind(3, 3), far(3, 3);
    edge << T(0), T(0), T(0), T(-1), T(1), T(0), T(2), T(2), T(4);
    behind << T(-1), T(1), T(0), T(0), T(0), T(1), T(-2), T(-2), T(-2);
    far << T(1e6), T(1e6), T(2e6), T(0), T(1e6), T(0), T(2), T(2), T(2);
    for (const Columns<T>& x : {edge, behind, far}) {
        const Columns<T> values = Columns<T>::Ones(1, 3);
        const std::vector<Face> one{{0, 1, 2}};
        const auto r = rasterize_mesh<T>(ScalarBackend<>{}, {x, one, values}, camera);
        finite = finite && r.attributes.pixels.allFinite() && r.silhouette.pixels.allFinite();
        const Columns<T> ones = Columns<T>::Ones(1, 256);
        const auto g = rasterize_mesh_vjp<T>(ScalarBackend<>{}, r, {x, one, values}, camera,
                                             {&ones, &ones, &ones});
        finite = finite && g.vertices.allFinite();
    }
    report.holds("G7", kind_of<T>(), "edge-on, behind, 1e6 beside: mask and gradient finite",
                 finite);
    const T w = T(0);
    report.textbook_fails("G7", kind_of<T>(), "x / w on the camera's plane", std::isfinite(w / w));
}

} // namespace

void surfaces(Report& report) {
    const auto both = [&]<class T>() {
        g1_g3<T>(report);
        g2<T>(report);
        g4<T>(report);
        g5<T>(report);
        g6<T>(report);
        g7<T>(report);
    };
    both.operator()<float>();
    both.operator()<double>();
}

} // namespace rye::hard
