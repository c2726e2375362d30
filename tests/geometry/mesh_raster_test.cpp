// SPDX-License-Identifier: Apache-2.0
#include <rye/geometry/mesh_raster.hpp>

#include <cmath>
#include <limits>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/geometry/marching_tets.hpp>

#include "../support/laws.hpp"

using namespace rye;

namespace {

using Plain = ScalarBackend<Serial>;

/// At the origin, looking along +z: world and camera frames are equal.
template <class T>
Pinhole<T> straight(int width, int height) {
    Pinhole<T> c;
    c.width = width;
    c.height = height;
    c.fx = c.fy = T(width);
    c.cx = T(width) / T(2);
    c.cy = T(height) / T(2);
    return c;
}

/// A camera in general position.
template <class T>
Pinhole<T> askew(int width, int height) {
    Pinhole<T> c = look_at<T>({T(1.5), T(0.9), T(5)}, {T(0.1), 0, 0}, {T(0.1), 1, 0}, T(0.6),
                              {width, height});
    c.cx += T(2.3);
    c.fy *= T(1.05);
    return c;
}

/// The camera point that `straight` sees at pixel position (u, v) and depth z.
Vec3<double> unprojected(double u, double v, double z, int width, int height) {
    return {(u - 0.5 * width) / width * z, (v - 0.5 * height) / width * z, z};
}

TriangleMesh<double> ball(double cell) {
    const TetGrid<double> g =
        bcc_grid<double>(Vec3<double>::Constant(-1.3), Vec3<double>::Constant(1.3), cell);
    const Columns<double> sdf = (g.vertices.colwise().norm().array() - 1).matrix();
    const Surface<double> s = marching_tetrahedra<double>(g.topology, g.vertices, sdf);
    return {s.positions, s.topology.faces};
}

/// Triangles of all sizes, some edge-on, some without area, some around the near plane.
TriangleMesh<double> soup(Index n, std::uint64_t seed) {
    TriangleMesh<double> m;
    const Columns<double> r = random_columns<double>(3, 4 * n, seed);
    m.vertices.resize(3, 3 * n);
    for (Index i = 0; i < n; ++i) {
        const double size = std::pow(10.0, -1.2 + 1.2 * r(0, 4 * i + 3));
        for (Index k = 0; k < 3; ++k) {
            const Index v = 3 * i + k;
            m.vertices.col(v) = r.col(4 * i) + size * r.col(4 * i + k);
            m.vertices(2, v) = 1.2 * m.vertices(2, v) + 1.5;
        }
        if (i % 17 == 3) m.vertices.col(3 * i + 2) = m.vertices.col(3 * i);
        if (i % 17 == 5)  // a plane through the camera's centre
            m.vertices.col(3 * i + 2) = m.vertices.col(3 * i) * 0.5 + m.vertices.col(3 * i + 1) * 0.6;
        m.faces.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    return m;
}

template <class T>
TriangleMesh<T> cast(const TriangleMesh<double>& m) {
    return {m.vertices.cast<T>(), m.faces};
}

template <class T>
MeshRaster<T> draw(const TriangleMesh<T>& m, const Pinhole<T>& camera, const Columns<T>& attributes,
                   const MeshRasterSettings& settings = {}) {
    return rasterize_mesh<T>(Plain{}, {m.vertices, m.faces, attributes}, camera, settings);
}

/// Pixels whose nearest outlines differ in the second raster. A face with two equal corners has two
/// equally near edges: rounding selects one, and so the edge that gets the gradient.
template <class T, class D>
std::vector<Index> undecided(const MeshRaster<T>& a, const MeshRaster<D>& b) {
    std::vector<Index> pixels;
    REQUIRE(a.silhouettes.size() == b.silhouettes.size());
    for (std::size_t band = 0; band < a.silhouettes.size(); ++band) {
        const SilhouetteTrace &x = a.silhouettes[band], &y = b.silhouettes[band];
        REQUIRE(x.pixel == y.pixel);
        REQUIRE(x.begin == y.begin);
        for (std::size_t i = 0; i < x.pixel.size(); ++i)
            for (Index k = x.begin[i]; k < x.begin[i + 1]; ++k) {
                const auto &u = x.nearest[std::size_t(k)], &v = y.nearest[std::size_t(k)];
                if (u.a == v.a && u.b == v.b) continue;
                pixels.push_back(x.pixel[i]);
                break;
            }
    }
    return pixels;
}

template <class T>
double raster_dot_error(const TriangleMesh<T>& m, const Pinhole<T>& camera, Index channels,
                        const MeshRasterSettings& settings = {}, double depth_weight = 1) {
    using D = Dual<T, 1>;
    const Columns<T> a = random_columns<T>(channels, m.vertices.cols(), 1);
    const Columns<T> dx = random_columns<T>(3, m.vertices.cols(), 2),
                     da = random_columns<T>(channels, m.vertices.cols(), 3);
    const Index pixels = static_cast<Index>(camera.width) * camera.height;
    const Columns<T> wa = random_columns<T>(channels, pixels, 4),
                     wd = random_columns<T>(1, pixels, 6) * T(depth_weight);
    Columns<T> ws = random_columns<T>(1, pixels, 5);
    const MeshRaster<D> moved = rasterize_mesh<D>(
        Plain{}, {lifted(m.vertices, dx), m.faces, lifted(a, da)}, camera, settings);
    const MeshRaster<T> still = draw<T>(m, camera, a, settings);
    CHECK(still.face == moved.face);
    const std::vector<Index> ties = undecided(still, moved);
#ifdef __clang__ // fuses products and sums: a dual's value may round differently
    CHECK(static_cast<Index>(ties.size()) * 8 < pixels);
#else
    CHECK(ties.empty());
#endif
    for (const Index p : ties) ws(0, p) = T(0);
    DotProducts d;
    d.add_forward(tangents<T>(moved.attributes.pixels), wa);
    d.add_forward(tangents<T>(moved.silhouette.pixels), ws);
    d.add_forward(tangents<T>(moved.depth.pixels), wd);
    const MeshRasterGradient<T> g =
        rasterize_mesh_vjp<T>(Plain{}, still, {m.vertices, m.faces, a}, camera, {&wa, &ws, &wd});
    d.add_reverse(g.vertices, dx);
    d.add_reverse(g.attributes, da);
    CHECK(still.mask.pixels.sum() > T(20));
    return d.error();
}

/// The definition, at every pixel for every face.
double plain_silhouette(const Columns<double>& image, const std::vector<Face>& faces, double u,
                        double v, int width, const SilhouetteSettings& s) {
    double outside = 1;
    int count = 0;
    const double reach = s.pixels(width);
    for (const Face& f : faces) {
        Mat<double, 2, 3> q;
        for (int k = 0; k < 3; ++k) q.col(k) = image.col(f[static_cast<std::size_t>(k)]);
        const Vec2<double> p(u, v);
        const Vec2<double> lo = q.rowwise().minCoeff(), hi = q.rowwise().maxCoeff();
        if (((p - lo).array() < -reach).any() || ((p - hi).array() > reach).any()) continue;
        if (count++ == s.max_faces) break;
        double d2 = std::numeric_limits<double>::infinity();
        for (int k = 0; k < 3; ++k) {
            const Vec2<double> a = q.col(k), ab = q.col((k + 1) % 3) - a;
            const double t = ab.norm() > 0
                                 ? std::clamp((p - a).dot(ab) / ab.squaredNorm(), 0.0, 1.0)
                                 : 0.0;
            d2 = std::min(d2, (p - a - t * ab).squaredNorm());
        }
        outside *= 1 - std::exp(-s.sharpness * d2 * 4 / (double(width) * width));
    }
    return 1 - outside;
}

} // namespace

TEST_CASE("rasterize_mesh: the soft mask beside a straight outline, 1 to 4 pixels of 256 away") {
    const int n = 256;
    TriangleMesh<double> m;  // its right side is the line u = 100.5, through pixel centres
    m.vertices.resize(3, 3);
    m.vertices << unprojected(100.5, 20, 3, n, n), unprojected(100.5, 220, 3, n, n),
        unprojected(40, 120, 3, n, n);
    m.faces = {{0, 1, 2}};
    const Columns<double> none(0, 3);
    MeshRasterSettings far;
    far.culling = Culling::none;
    far.silhouette.reach = 0.1;
    const MeshRaster<double> r = draw<double>(m, straight<double>(n, n), none, far);
    const double expected[] = {0.6523, 0.1810, 0.0214, 0.0011};
    for (int d = 1; d <= 4; ++d)
        CHECK(std::abs(r.silhouette.at(100 + d, 120)(0) - expected[d - 1]) < 5e-5);
    CHECK(r.silhouette.at(99, 120)(0) == 1);
    CHECK(r.mask.at(100, 120)(0) == 1);
    far.silhouette.reach = 0.02;  // 2.56 pixels, so the box leaves the third out
    const MeshRaster<double> near = draw<double>(m, straight<double>(n, n), none, far);
    CHECK(near.silhouette.at(102, 120)(0) == r.silhouette.at(102, 120)(0));
    CHECK(near.silhouette.at(103, 120)(0) == 0);
}

TEST_CASE("rasterize_mesh: the soft mask of a ball and of a soup is its definition") {
    for (const TriangleMesh<double>& m : {ball(0.3), soup(60, 3)}) {
        const Pinhole<double> camera =
            m.faces.size() == 60 ? straight<double>(64, 48) : askew<double>(64, 48);
        for (const int faces : {3, 30}) {
            MeshRasterSettings settings;
            settings.silhouette.max_faces = faces;
            settings.silhouette.reach = 0.2;
            settings.silhouette.sharpness = 500;
            const MeshRaster<double> r = draw<double>(m, camera, Columns<double>(0, m.vertices.cols()),
                                                      settings);
            std::vector<Face> in_front;
            for (const Face& f : m.faces)
                if (r.screen.camera(2, f[0]) > 0.01 && r.screen.camera(2, f[1]) > 0.01 &&
                    r.screen.camera(2, f[2]) > 0.01)
                    in_front.push_back(f);
            CHECK(static_cast<Index>(m.faces.size() - in_front.size()) == r.rejected_faces);
            double worst = 0;
            int soft = 0;
            for (int y = 0; y < 48; ++y)
                for (int x = 0; x < 64; ++x) {
                    if (r.mask.at(x, y)(0) == 1) continue;
                    const double s = plain_silhouette(r.screen.image, in_front, x + 0.5, y + 0.5, 64,
                                                      settings.silhouette);
                    soft += s > 1e-3 && s < 1 ? 1 : 0;
                    worst = std::max(worst, std::abs(s - r.silhouette.at(x, y)(0)));
                }
            CHECK(soft > 10);
            CHECK(worst < 1e-12);
        }
    }
}

TEST_CASE("rasterize_mesh: shows the nearest face that a ray meets") {
    for (const Culling culling : {Culling::none, Culling::back_faces, Culling::normal_z}) {
        const TriangleMesh<double> m = soup(80, 11);
        const Pinhole<double> camera = straight<double>(48, 40);
        MeshRasterSettings settings;
        settings.culling = culling;
        const MeshRaster<double> r = draw<double>(m, camera, m.vertices, settings);
        int different = 0, hits = 0;
        for (int y = 0; y < 40; ++y)
            for (int x = 0; x < 48; ++x) {
                const Vec3<double> ray = unprojected(x + 0.5, y + 0.5, 1, 48, 40);
                Index nearest = -1;
                double depth = std::numeric_limits<double>::infinity();
                for (std::size_t f = 0; f < m.faces.size(); ++f) {  // Moeller and Trumbore
                    const Vec3<double> a = m.vertices.col(m.faces[f][0]),
                                       b = m.vertices.col(m.faces[f][1]),
                                       c = m.vertices.col(m.faces[f][2]);
                    if (std::min({a[2], b[2], c[2]}) <= camera.near_depth) continue;
                    const Vec3<double> n = area_vector<double>(a, b, c);
                    if (culling == Culling::back_faces && n.dot(a) >= 0) continue;
                    if (culling == Culling::normal_z && n[2] > 0) continue;
                    if (n.dot(ray) == 0) continue;
                    const double z = n.dot(a) / n.dot(ray);
                    const Vec3<double> p = z * ray;
                    const double wa = area_vector<double>(p, b, c).dot(n),
                                 wb = area_vector<double>(a, p, c).dot(n),
                                 wc = area_vector<double>(a, b, p).dot(n);
                    if (wa < 0 || wb < 0 || wc < 0 || !(n.norm() > 1e-9)) continue;
                    if (z > 0 && z < depth) depth = z, nearest = static_cast<Index>(f);
                }
                hits += nearest >= 0 ? 1 : 0;
                if (nearest != r.face[static_cast<std::size_t>(y * 48 + x)]) ++different;
                else if (nearest >= 0) {
                    CHECK(std::abs(r.depth.at(x, y)(0) - depth) < 1e-9);
                    CHECK((Vec3<double>(r.attributes.at(x, y)) - depth * ray).norm() < 1e-9);
                }
            }
        CHECK(hits > 250);
        CHECK(different <= 1);  // a ray along an edge may hit either face
    }
}

TEST_CASE("rasterize_mesh: a closed surface has no holes, in float too; attributes keep perspective") {
    const TriangleMesh<double> m = ball(0.15);
    const Pinhole<float> camera = askew<float>(96, 96);
    const MeshRaster<float> r = draw<float>(cast<float>(m), camera, m.vertices.cast<float>());
    const MeshRaster<double> truth =
        draw<double>(cast<double>(m), camera.cast<double>(), m.vertices.cast<float>().cast<double>());
    int inside = 0, outside = 0, holes = 0, excess = 0;
    for (int y = 0; y < 96; ++y)
        for (int x = 0; x < 96; ++x) {
            const Vec3<double> o = camera.centre().cast<double>(),
                               d = camera.ray({float(x) + 0.5f, float(y) + 0.5f}).cast<double>();
            const double miss = (o - o.dot(d) * d).norm();  // of the ray and the ball's centre
            const bool covered = r.mask.at(x, y)(0) == 1;
            inside += miss < 0.97 ? 1 : 0;
            outside += miss > 1.0 ? 1 : 0;
            holes += miss < 0.97 && !covered ? 1 : 0;
            excess += miss > 1.0 && covered ? 1 : 0;
            if (!covered) continue;
            const Vec3<float> at = r.attributes.at(x, y);
            const Vec3<float> seen = camera.project_point(at);
            CHECK(std::abs(seen[0] - float(x) - 0.5f) < 1e-3f);
            CHECK(std::abs(seen[1] - float(y) - 0.5f) < 1e-3f);
            CHECK(std::abs(seen[2] - r.depth.at(x, y)(0)) < 2e-6f);
        }
    CHECK(inside > 1000);
    CHECK(outside > 1000);
    CHECK(holes == 0);
    CHECK(excess == 0);
    int other = 0;  // the float camera points differ in the last bit
    for (std::size_t p = 0; p < r.face.size(); ++p) other += r.face[p] != truth.face[p] ? 1 : 0;
    CHECK(other <= 2);
    CHECK((r.silhouette.pixels.cast<double>() - truth.silhouette.pixels).cwiseAbs().maxCoeff() < 1e-4);
}

TEST_CASE("rasterize_mesh: an edge through pixel centres leaves no gap, ties go to the lower index") {
    TriangleMesh<double> m;
    m.vertices.resize(3, 4);
    m.vertices << unprojected(4.5, 4.5, 2, 32, 32), unprojected(27.5, 4.5, 2, 32, 32),
        unprojected(27.5, 27.5, 2, 32, 32), unprojected(4.5, 27.5, 2, 32, 32);
    m.faces = {{0, 2, 1}, {0, 3, 2}};  // y points down, so this turns counter-clockwise to the eye
    const MeshRaster<double> r = draw<double>(m, straight<double>(32, 32), m.vertices);
    bool full = true;
    for (int y = 5; y < 27; ++y)
        for (int x = 5; x < 27; ++x) full = full && r.mask.at(x, y)(0) == 1;
    CHECK(full);
    CHECK(r.face[10 * 32 + 10] == 0);
    CHECK(r.mask.at(3, 10)(0) == 0);
    for (Face& f : m.faces) std::swap(f[1], f[2]);
    CHECK(draw<double>(m, straight<double>(32, 32), m.vertices).mask.pixels.sum() == 0);
}

TEST_CASE("rasterize_mesh: faces behind, edge-on, without area or not finite are left out, counted") {
    const Pinhole<double> camera = straight<double>(32, 32);
    TriangleMesh<double> m;
    m.vertices.resize(3, 12);
    m.vertices << Columns<double>(random_columns<double>(3, 12, 1));
    m.vertices.row(2).setConstant(2);
    m.vertices.row(2).head(3).setConstant(-1);                    // behind
    m.vertices(2, 3) = 0.005;                                     // across the near plane
    m.vertices.col(8) = 0.5 * (m.vertices.col(6) + m.vertices.col(7)) * 1.5;  // edge-on
    m.vertices(0, 10) = std::nan("");
    m.faces = {{0, 1, 2}, {3, 4, 5}, {6, 7, 8}, {9, 10, 11}, {9, 9, 11}};
    const MeshRaster<double> r = draw<double>(m, camera, m.vertices);
    CHECK(r.rejected_faces == 3);
    CHECK(r.degenerate_faces == 2);
    CHECK(r.mask.pixels.sum() == 0);
    CHECK(r.silhouette.pixels.allFinite());
    CHECK(r.silhouette.pixels.maxCoeff() > 0);  // an edge still has an outline
    const Columns<double> w = Columns<double>::Ones(1, 32 * 32), w3 = w.replicate(3, 1);
    const MeshRasterGradient<double> g =
        rasterize_mesh_vjp<double>(Plain{}, r, {m.vertices, m.faces, m.vertices}, camera,
                                   {&w3, &w, &w});
    CHECK(g.vertices.allFinite());
    CHECK(g.vertices.leftCols(6).norm() == 0);
    CHECK(g.vertices.middleCols(6, 3).norm() > 0);
    for (const double far : {1e200, -1e200}) {  // huge, or beside the image
        m.vertices.setConstant(far);
        m.vertices.row(2).setConstant(2);
        const MeshRaster<double> away = draw<double>(m, camera, m.vertices);
        CHECK(away.silhouette.pixels.sum() == 0);
    }
}

TEST_CASE("rasterize_mesh: no faces and no attributes make an empty image") {
    const Pinhole<float> camera = straight<float>(20, 17);
    const TriangleMesh<float> none{Columns<float>(3, 0), {}};
    const MeshRaster<float> r = draw<float>(none, camera, Columns<float>(32, 0));
    CHECK(r.attributes.channels() == 32);
    CHECK(r.attributes.pixels.norm() == 0);
    CHECK(r.silhouette.pixels.norm() == 0);
    const Columns<float> w = Columns<float>::Ones(32, 20 * 17), w1 = w.topRows(1);
    const MeshRasterGradient<float> g =
        rasterize_mesh_vjp<float>(Plain{}, r, {none.vertices, none.faces, Columns<float>(32, 0)},
                                  camera, {&w, &w1});
    CHECK(g.vertices.cols() == 0);
    CHECK(g.attributes.cols() == 0);
}

TEST_CASE("rasterize_mesh: covered pixels give the silhouette no gradient; it pulls the outline") {
    const TriangleMesh<double> m = ball(0.3);
    const Pinhole<double> camera = look_at<double>({0, 0, 6}, {0, 0, 0}, {0, 1, 0}, 0.5, {64, 64});
    const Columns<double> none(0, m.vertices.cols());
    const MeshRaster<double> r = draw<double>(m, camera, none);
    const auto pull = [&](const Columns<double>& w) {
        return rasterize_mesh_vjp<double>(Plain{}, r, {m.vertices, m.faces, none}, camera,
                                          {nullptr, &w})
            .vertices;
    };
    CHECK(pull(r.mask.pixels).norm() == 0);
    const Columns<double> g = pull((1 - r.mask.pixels.array()).matrix());
    CHECK(g.cwiseProduct(m.vertices).sum() > 0);  // a larger ball covers more
}

TEST_CASE("rasterize_mesh: the vjp is the transpose of the jvp on duals") {
    CHECK(raster_dot_error<double>(ball(0.3), askew<double>(64, 48), 5) < 1e-13);
    CHECK(raster_dot_error<double>(ball(0.12), askew<double>(40, 40), 35) < 1e-13);  // tiny faces
    CHECK(raster_dot_error<double>(soup(80, 3), straight<double>(48, 40), 4) < 1e-13);
    MeshRasterSettings crowded;
    crowded.culling = Culling::none;
    crowded.silhouette = {500, 0.3, 7};
    CHECK(raster_dot_error<double>(soup(80, 5), straight<double>(48, 40), 0, crowded) < 1e-13);
    CHECK(raster_dot_error<float>(cast<float>(ball(0.3)), askew<float>(64, 48), 5) < 2e-6);
    CHECK(raster_dot_error<float>(cast<float>(soup(80, 3)), straight<float>(48, 40), 4) < 1e-5);
}

TEST_CASE("rasterize_mesh: duals agree with central differences where no visibility changes") {
    TriangleMesh<double> m;  // one large face, so that only its outline could change a pixel's face
    m.vertices.resize(3, 3);
    m.vertices << unprojected(5.3, 3.9, 2, 32, 32), unprojected(7.1, 27.7, 2.6, 32, 32),
        unprojected(26.2, 14.4, 1.7, 32, 32);
    m.faces = {{0, 1, 2}};
    const Pinhole<double> camera = straight<double>(32, 32);
    const Columns<double> dx = random_columns<double>(3, 3, 1), a = random_columns<double>(4, 3, 2);
    const MeshRaster<Dual<double, 1>> exact =
        rasterize_mesh<Dual<double, 1>>(
            Plain{},
            {lifted(m.vertices, dx), m.faces, lifted<double>(a, Columns<double>::Zero(4, 3))},
            camera);
    const double h = 1e-6;
    const auto at = [&](double s) {
        return draw<double>({m.vertices + s * dx, m.faces}, camera, a);
    };
    const MeshRaster<double> more = at(h), less = at(-h);
    CHECK(more.face == less.face);
    const auto difference = [&](const Image<double>& x, const Image<double>& y) {
        return Columns<double>((x.pixels - y.pixels) / (2 * h));
    };
    CHECK(more.mask.pixels.sum() > 100);
    CHECK((difference(more.attributes, less.attributes) - tangents<double>(exact.attributes.pixels))
              .cwiseAbs().maxCoeff() < 1e-7);
    CHECK((difference(more.depth, less.depth) - tangents<double>(exact.depth.pixels))
              .cwiseAbs().maxCoeff() < 1e-7);
    CHECK((difference(more.silhouette, less.silhouette) - tangents<double>(exact.silhouette.pixels))
              .cwiseAbs().maxCoeff() < 1e-6);
}

TEST_CASE("rasterize_mesh: threads change no bit") {
    using Threaded = ScalarBackend<DefaultThreads>;
    const TriangleMesh<float> m = cast<float>(ball(0.15));
    const Pinhole<float> camera = askew<float>(96, 90);
    const Columns<float> a = random_columns<float>(35, m.vertices.cols(), 1),
                         wa = random_columns<float>(35, 96 * 90, 2),
                         ws = random_columns<float>(1, 96 * 90, 3);
    const MeshRaster<float> one = draw<float>(m, camera, a),
                            many =
                                rasterize_mesh<float>(Threaded{}, {m.vertices, m.faces, a}, camera);
    CHECK(one.face == many.face);
    CHECK(one.attributes.pixels == many.attributes.pixels);
    CHECK(one.silhouette.pixels == many.silhouette.pixels);
    const AttributeMesh<float> mesh{m.vertices, m.faces, a};
    const MeshRasterGradient<float> g = rasterize_mesh_vjp<float>(Plain{}, one, mesh, camera,
                                                                  {&wa, &ws}),
                                    h = rasterize_mesh_vjp<float>(Threaded{}, many, mesh, camera,
                                                                  {&wa, &ws});
    CHECK(g.vertices == h.vertices);
    CHECK(g.attributes == h.attributes);
}

TEST_CASE("rasterize_mesh_into: what an image had before, of any size or settings, leaves nothing") {
    const TriangleMesh<float> small = cast<float>(ball(0.3)), fine = cast<float>(ball(0.15));
    const auto colours = [](const TriangleMesh<float>& m, Index channels) {
        return random_columns<float>(channels, m.vertices.cols(), 4);
    };
    const auto of = [&](const TriangleMesh<float>& m, const Pinhole<float>& camera, Index channels,
                        const MeshRasterSettings& settings, MeshRaster<float>& out) {
        const Columns<float> a = colours(m, channels);
        detail::rasterize_mesh_into<float>(Plain{}, {m.vertices, m.faces, a}, camera, settings,
                                           out);
        const Columns<float> ws = random_columns<float>(1, out.mask.size(), 5);
        return rasterize_mesh_vjp<float>(Plain{}, out, {m.vertices, m.faces, a}, camera,
                                         {nullptr, &ws});
    };
    MeshRasterSettings hard;
    hard.silhouette.max_faces = 0;
    MeshRaster<float> used, fresh;
    of(fine, askew<float>(96, 90), 5, {}, used);
    const MeshRasterGradient<float> without = of(fine, askew<float>(96, 90), 5, hard, used);
    CHECK(without.vertices.isZero(0));
    const MeshRasterGradient<float> g = of(small, askew<float>(64, 50), 2, {}, used),
                                    h = of(small, askew<float>(64, 50), 2, {}, fresh);
    CHECK(used.face == fresh.face);
    CHECK(used.attributes.pixels == fresh.attributes.pixels);
    CHECK(used.mask.pixels == fresh.mask.pixels);
    CHECK(used.depth.pixels == fresh.depth.pixels);
    CHECK(used.silhouette.pixels == fresh.silhouette.pixels);
    CHECK(used.barycentric == fresh.barycentric);
    CHECK(g.vertices == h.vertices);
    CHECK(h.vertices.norm() > 0);
}
