// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/mesh_raster.hpp: z-buffer rasterisation of a triangle mesh with interpolated
/// attributes, and its vjp. Vertices in the world [world units], images as in core/columns.hpp,
/// depth = camera z. A face is visible if normal . view < 0, its outside towards the camera
/// (corners are counter-clockwise seen from outside). Gradients reach the attributes, and the
/// vertices through perspective-correct barycentrics and the soft silhouette; not the visibility
/// nor the camera. Source: kaolin's DIB-R as Gaussian Head Avatar uses it; homogeneous edge
/// functions as in Olano and Greer, "Triangle Scan Conversion using 2D Homogeneous Coordinates",
/// 1997.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include <rye/backend/backend.hpp>
#include <rye/geometry/screen_mesh.hpp>
#include <rye/geometry/silhouette.hpp>

namespace rye {

/// Faces that the z-buffer skips. The silhouette includes all faces in front of the camera.
enum class Culling {
    back_faces,  ///< normal . view >= 0: no gap at the silhouette of a closed mesh
    normal_z,    ///< normals pointing away from the image plane, as in the reference
    none
};

/// Settings of a mesh's rasterizer: its outputs and the softness of its silhouette.
struct MeshRasterSettings {
    Culling culling = Culling::back_faces;
    /// Smallest area [px^2] of a face that is not skipped: barycentrics divide by the area, and a
    /// smaller face covers a pixel centre only by chance.
    double min_area = 1e-8;
    SilhouetteSettings silhouette = {};
};

/// Images of a mesh, and intermediate values for the vjp.
template <Scalar T>
struct MeshRaster {
    Image<T> attributes;         ///< C channels, 0 without a face
    Image<T> mask;               ///< 1 with a face, else 0
    Image<T> depth;              ///< camera z [world units], 0 without a face
    Image<T> silhouette;         ///< soft mask, in 0..1
    std::vector<Index> face;     ///< index of the face per pixel, -1 for none
    Columns<T> barycentric;      ///< 3 x pixels, perspective-correct, 0 without a face
    Index rejected_faces = 0;    ///< at or behind near_depth, or not finite
    Index degenerate_faces = 0;  ///< in front, but smaller than min_area

    ScreenMesh<T> screen;                      ///< kept for the vjp, like the next two
    std::vector<SilhouetteTrace> silhouettes;  ///< one per band
    MeshRasterSettings settings;
};

namespace detail {

/// Gradients of the images of a MeshRaster; null means 0.
template <Scalar T>
struct MeshRasterCotangent {
    const Columns<T>* attributes = nullptr;  ///< C x pixels
    const Columns<T>* silhouette = nullptr;  ///< 1 x pixels
    const Columns<T>* depth = nullptr;       ///< 1 x pixels
};

} // namespace detail

/// Gradients of a mesh's vertices and attributes.
template <Scalar T>
struct MeshRasterGradient {
    Columns<T> vertices;    ///< 3 x M
    Columns<T> attributes;  ///< C x M
};

namespace detail {

/// Face with its corners moved along z so that the pixel's ray is the axis, r_k = xy_k - z_k ray:
/// then e_k = r_(k+1) x r_(k+2) are the homogeneous edge functions, and e_k / sum e the
/// perspective-correct barycentrics, without a division by depth.
template <class W>
struct PixelFace {
    std::array<Vec2<W>, 3> r;
    std::array<W, 3> barycentric;
    W sum;  // sum of e_k

    PixelFace(const Columns<W>& camera, const Face& f, double ray_x, double ray_y) {
        for (std::size_t k = 0; k < 3; ++k)
            r[k] = {camera(0, f[k]) - camera(2, f[k]) * W(ray_x),
                    camera(1, f[k]) - camera(2, f[k]) * W(ray_y)};
        for (std::size_t k = 0; k < 3; ++k) {
            const Vec2<W>&u = r[(k + 1) % 3], &v = r[(k + 2) % 3];
            barycentric[k] = u[0] * v[1] - u[1] * v[0];
        }
        sum = barycentric[0] + barycentric[1] + barycentric[2];
        const W scale = W(1) / sum;
        for (W& b : barycentric) b = b * scale;
    }
};

/// Fills the z-buffer of one band of rows, from values alone.
template <class T>
void nearest_faces(const ScreenFaces<T>& screen, const FaceBand& band, const Pinhole<double>& view,
                   const MeshRasterSettings& settings, Index* pixel_face) {
    const auto& camera = screen.mesh.camera;
    const int row = band.row, rows = band.rows;
    std::vector<double> rays(static_cast<std::size_t>(view.width));
    for (std::size_t px = 0; px < rays.size(); ++px)
        rays[px] = (static_cast<double>(px) + 0.5 - view.cx) / view.fx;
    std::vector<double> nearest(static_cast<std::size_t>(rows * view.width),
                                std::numeric_limits<double>::infinity());
    for (const Index* it = band.first; it != band.last; ++it) {
        const ScreenFace& box = screen.boxes[static_cast<std::size_t>(*it)];
        if (std::abs(box.area) < settings.min_area) continue;
        if (settings.culling == Culling::back_faces && box.area < 0) continue;
        if (settings.culling == Culling::normal_z && box.normal_z > 0) continue;
        // Edge functions are evaluated from the lower to the higher vertex index: the two faces of
        // an edge get exactly opposite values, and no pixel falls between them.
        Face f = screen.faces[static_cast<std::size_t>(*it)];
        bool even = true;
        for (const auto& [i, j] : {std::pair<std::size_t, std::size_t>{0, 1}, {1, 2}, {0, 1}})
            if (f[i] > f[j]) std::swap(f[i], f[j]), even = !even;
        const double sign =
            (box.area > 0) == even ? -1 : 1; // e < 0 inside a face seen from outside
        double x[3], y[3], z[3];
        for (std::size_t k = 0; k < 3; ++k) {
            x[k] = static_cast<double>(value_of(camera(0, f[k])));
            y[k] = static_cast<double>(value_of(camera(1, f[k])));
            z[k] = static_cast<double>(value_of(camera(2, f[k])));
        }
        const PixelRange xs = pixel_range(box.left, box.right, view.width);
        const PixelRange ys = pixel_range(box.top - row, box.bottom - row, rows);
        for (int py = ys.first; py <= ys.last; ++py) {
            const double ray_y = (py + row + 0.5 - view.cy) / view.fy;
            const double r0y = y[0] - z[0] * ray_y, r1y = y[1] - z[1] * ray_y,
                         r2y = y[2] - z[2] * ray_y;
            for (int px = xs.first; px <= xs.last; ++px) {
                const double ray_x = rays[static_cast<std::size_t>(px)];
                const double r0x = x[0] - z[0] * ray_x, r1x = x[1] - z[1] * ray_x,
                             r2x = x[2] - z[2] * ray_x;
                const double e2 = sign * (r0x * r1y - r0y * r1x);
                const double e1 = -sign * (r0x * r2y - r0y * r2x);
                const double e0 = sign * (r1x * r2y - r1y * r2x);
                const double sum = e0 + e1 + e2;
                if (!(e0 >= 0 && e1 >= 0 && e2 >= 0 && sum > 0)) continue;
                const double depth = (e0 * z[0] + e1 * z[1] + e2 * z[2]) / sum;
                const std::size_t at = static_cast<std::size_t>(py * view.width + px);
                if (depth < nearest[at]) nearest[at] = depth, pixel_face[at] = *it;
            }
        }
    }
}

} // namespace detail

/// Mesh with attributes at its vertices.
template <class T>
struct AttributeMesh {
    ColumnsView<T> vertices;         ///< 3 x M, world
    const std::vector<Face>& faces;
    ColumnsView<T> attributes;       ///< C x M
};

namespace detail {

/// Rasterizes a mesh into `out`, whose memory is used again; without faces the images are empty.
template <class T, Backend B>
void rasterize_mesh_into(const B& backend, const AttributeMesh<T>& mesh,
                         const Pinhole<real_t<T>>& camera, const MeshRasterSettings& settings,
                         MeshRaster<T>& out) {
    using W = widened_t<T>;
    const ColumnsView<T>&vertices = mesh.vertices, &attributes = mesh.attributes;
    const std::vector<Face>& faces = mesh.faces;
    RYE_ASSERT(vertices.rows() == 3 && vertices.cols() == attributes.cols(),
               "rasterize_mesh: vertices are not 3 x M or attributes not C x M");
    const int width = camera.width, height = camera.height;
    const Pinhole<double> view = camera.template cast<double>();
    const Index pixels = static_cast<Index>(width) * height;
    out.settings = settings;
    for (Image<T>* image : {&out.attributes, &out.mask, &out.depth, &out.silhouette}) {
        image->width = width;
        image->height = height;
        image->pixels.resize(image == &out.attributes ? attributes.rows() : 1, pixels);
    }
    out.face.resize(static_cast<std::size_t>(pixels));
    out.barycentric.resize(3, pixels);
    out.rejected_faces = out.degenerate_faces = 0;
    const auto& threads = backend.threads;
    out.screen = screen_mesh<T>(threads, vertices, camera);
    const std::vector<ScreenFace> boxes =
        screen_faces(threads, out.screen, faces, view.near_depth);
    for (const ScreenFace& s : boxes) {
        out.rejected_faces += s.in_front ? 0 : 1;
        out.degenerate_faces += s.in_front && std::abs(s.area) < settings.min_area ? 1 : 0;
    }
    const FaceBands bands =
        face_bands(threads, boxes, {width, height}, settings.silhouette.pixels(width));
    out.silhouettes.resize(static_cast<std::size_t>(bands.count()));
    const ScreenFaces<T> screen{out.screen, faces, boxes};

    for_chunks(threads, height, FaceBands::rows, [&](Index y0, Index y1, Index b) {
        const std::size_t number = static_cast<std::size_t>(b);
        const FaceBand band{bands.faces.data() + bands.begin[number],
                            bands.faces.data() + bands.begin[number + 1], static_cast<int>(y0),
                            static_cast<int>(y1 - y0)};
        const Index begin = y0 * width, end = y1 * width;
        for (Columns<T>* image : {&out.attributes.pixels, &out.mask.pixels, &out.depth.pixels,
                                  &out.silhouette.pixels, &out.barycentric})
            image->middleCols(begin, end - begin).setZero();
        std::fill(out.face.begin() + begin, out.face.begin() + end, Index{-1});
        detail::nearest_faces(screen, band, view, settings, out.face.data() + begin);
        std::vector<std::uint8_t> covered(static_cast<std::size_t>(end - begin));
        for (Index p = begin; p < end; ++p) {
            const Index found = out.face[static_cast<std::size_t>(p)];
            covered[static_cast<std::size_t>(p - begin)] = found >= 0 ? 1 : 0;
            if (found < 0) continue;
            const Face& f = faces[static_cast<std::size_t>(found)];
            const detail::PixelFace<W> at(
                out.screen.camera, f, (static_cast<double>(p % width) + 0.5 - view.cx) / view.fx,
                (static_cast<double>(p / width) + 0.5 - view.cy) / view.fy);
            W depth(0);
            for (std::size_t k = 0; k < 3; ++k) {
                depth += at.barycentric[k] * out.screen.camera(2, f[k]);
                out.barycentric(static_cast<Index>(k), p) = scalar_cast<T>(at.barycentric[k]);
            }
            out.depth.pixels(0, p) = scalar_cast<T>(depth);
            out.mask.pixels(0, p) = out.silhouette.pixels(0, p) = T(1);
            out.attributes.pixels.col(p) = out.barycentric(0, p) * attributes.col(f[0]) +
                                           out.barycentric(1, p) * attributes.col(f[1]) +
                                           out.barycentric(2, p) * attributes.col(f[2]);
        }
        SilhouetteTrace& trace = out.silhouettes[number] = {};
        if (settings.silhouette.max_faces <= 0) return;
        trace = silhouette_trace(screen, band, covered, width, settings.silhouette);
        for (std::size_t i = 0; i < trace.pixel.size(); ++i)
            out.silhouette.pixels(0, trace.pixel[i]) = scalar_cast<T>(silhouette_value(
                out.screen, {trace, i, width, settings.silhouette.sharpness}));
    });
}

} // namespace detail

/// Returns the images of a mesh; without faces they are empty.
template <class T, Backend B>
MeshRaster<T> rasterize_mesh(const B& backend, const AttributeMesh<T>& mesh,
                             const Pinhole<real_t<T>>& camera,
                             const MeshRasterSettings& settings = {}) {
    MeshRaster<T> out;
    detail::rasterize_mesh_into(backend, mesh, camera, settings, out);
    return out;
}

namespace detail {

/// Sums of gradients of some of a mesh's vertices, in the order in which they come.
template <class T>
class VertexShares {
    using W = widened_t<T>;

  public:
    std::vector<Index> vertex;    ///< each once
    std::vector<Vec3<W>> camera;  ///< gradient of its point in the camera frame
    std::vector<Vec2<W>> image;   ///< gradient of its point in the image
    std::vector<T> attributes;    ///< C a vertex

    VertexShares() = default;
    VertexShares(Index vertices, Index channels)
        : channels_(channels),
          place_(static_cast<std::size_t>(vertices), -1) {}
    /// Returns the place of a vertex, whose sums begin with 0.
    std::size_t place(Index v) {
        std::int32_t& at = place_[static_cast<std::size_t>(v)];
        if (at < 0) {
            at = static_cast<std::int32_t>(vertex.size());
            vertex.push_back(v);
            camera.push_back(Vec3<W>(W(0), W(0), W(0)));
            image.push_back(Vec2<W>(W(0), W(0)));
            attributes.resize(attributes.size() + static_cast<std::size_t>(channels_), T(0));
        }
        return static_cast<std::size_t>(at);
    }
    Eigen::Map<Columns<T>> attributes_at(std::size_t place) {
        return {attributes.data() + static_cast<Index>(place) * channels_, channels_, 1};
    }

  private:
    Index channels_ = 0;
    std::vector<std::int32_t> place_;  ///< -1 for none
};

} // namespace detail

/// Returns the gradients of vertices and attributes, given those of the images, with the same mesh
/// and camera. Sums are those of the bands of rows, in their order.
template <class T, Backend B>
MeshRasterGradient<T> rasterize_mesh_vjp(const B& backend, const MeshRaster<T>& raster,
                                         const AttributeMesh<T>& mesh,
                                         const Pinhole<real_t<T>>& camera,
                                         const detail::MeshRasterCotangent<T>& g) {
    using W = detail::widened_t<T>;
    const std::vector<Face>& faces = mesh.faces;
    const ColumnsView<T>& attributes = mesh.attributes;
    const Pinhole<double> view = camera.template cast<double>();
    const Columns<W>& points = raster.screen.camera;
    const int width = raster.mask.width;
    std::vector<detail::VertexShares<T>> bands(raster.silhouettes.size());
    for_chunks(
        backend.threads, raster.mask.height, detail::FaceBands::rows,
        [&](Index y0, Index y1, Index band) {
            detail::VertexShares<T>& sums = bands[static_cast<std::size_t>(band)];
            sums = {points.cols(), g.attributes ? attributes.rows() : 0};
            for (Index p = y0 * width; p < y1 * width; ++p) {
                const Index shown = raster.face[static_cast<std::size_t>(p)];
                if (shown < 0) continue;
                const Face& f = faces[static_cast<std::size_t>(shown)];
                const double ray[2] = {(static_cast<double>(p % width) + 0.5 - view.cx) / view.fx,
                                       (static_cast<double>(p / width) + 0.5 - view.cy) / view.fy};
                const detail::PixelFace<W> at(points, f, ray[0], ray[1]);
                const W g_depth = g.depth ? detail::scalar_cast<W>((*g.depth)(0, p)) : W(0);
                std::array<W, 3> g_b;
                W mean(0);
                for (std::size_t k = 0; k < 3; ++k) {
                    g_b[k] = g_depth * points(2, f[k]);
                    if (g.attributes)
                        g_b[k] += detail::scalar_cast<W>(
                            T(g.attributes->col(p).dot(attributes.col(f[k]))));
                    mean += g_b[k] * at.barycentric[k];
                }
                std::array<Vec2<W>, 3> g_r;
                for (Vec2<W>& v : g_r) v = {W(0), W(0)};
                for (std::size_t k = 0; k < 3; ++k) {
                    const W g_e = (g_b[k] - mean) / at.sum;
                    const std::size_t u = (k + 1) % 3, v = (k + 2) % 3;
                    g_r[u] += Vec2<W>(g_e * at.r[v][1], -g_e * at.r[v][0]);
                    g_r[v] += Vec2<W>(-g_e * at.r[u][1], g_e * at.r[u][0]);
                }
                for (std::size_t k = 0; k < 3; ++k) {
                    const std::size_t place = sums.place(f[k]);
                    sums.camera[place] +=
                        Vec3<W>(g_r[k][0], g_r[k][1],
                                g_depth * at.barycentric[k] -
                                    (g_r[k][0] * W(ray[0]) + g_r[k][1] * W(ray[1])));
                    if (g.attributes)
                        sums.attributes_at(place) +=
                            raster.barycentric(static_cast<Index>(k), p) * g.attributes->col(p);
                }
            }
            if (!g.silhouette) return;
            const SilhouetteTrace& trace = raster.silhouettes[static_cast<std::size_t>(band)];
            for (std::size_t i = 0; i < trace.pixel.size(); ++i) {
                const W g_soft = detail::scalar_cast<W>((*g.silhouette)(0, trace.pixel[i]));
                if (value_of(g_soft) == 0) continue;
                silhouette_vjp(raster.screen,
                               {trace, i, width, raster.settings.silhouette.sharpness}, g_soft,
                               [&](Index v, const Vec2<W>& share) {
                                   sums.image[sums.place(v)] += share;
                               });
            }
        });

    MeshRasterGradient<T> out{{}, Columns<T>::Zero(attributes.rows(), attributes.cols())};
    Columns<W> g_camera = Columns<W>::Zero(3, points.cols());
    Columns<W> g_image = Columns<W>::Zero(2, points.cols());
    for (detail::VertexShares<T>& sums : bands)
        for (std::size_t i = 0; i < sums.vertex.size(); ++i) {
            const Index v = sums.vertex[i];
            g_camera.col(v) += sums.camera[i];
            g_image.col(v) += sums.image[i];
            if (g.attributes) out.attributes.col(v) += sums.attributes_at(i);
        }
    out.vertices =
        screen_mesh_vjp(backend.threads, raster.screen, camera, std::move(g_camera), g_image);
    return out;
}

} // namespace rye
