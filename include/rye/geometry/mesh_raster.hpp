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

/// Gradients of the images of a MeshRaster; null means 0.
template <Scalar T>
struct MeshRasterCotangent {
    const Columns<T>* attributes = nullptr;  ///< C x pixels
    const Columns<T>* silhouette = nullptr;  ///< 1 x pixels
    const Columns<T>* depth = nullptr;       ///< 1 x pixels
};

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

/// Rasterizes a mesh; without faces the images are empty.
template <class T, Backend B>
MeshRaster<T> rasterize_mesh(const B& backend, const AttributeMesh<T>& mesh,
                             const Pinhole<real_t<T>>& camera,
                             const MeshRasterSettings& settings = {}) {
    using W = widened_t<T>;
    const ColumnsView<T>&vertices = mesh.vertices, &attributes = mesh.attributes;
    const std::vector<Face>& faces = mesh.faces;
    RYE_ASSERT(vertices.rows() == 3 && vertices.cols() == attributes.cols(),
               "rasterize_mesh: vertices are not 3 x M or attributes not C x M");
    const int width = camera.width, height = camera.height;
    const Pinhole<double> view = camera.template cast<double>();
    MeshRaster<T> out;
    out.settings = settings;
    out.attributes = Image<T>(width, height, static_cast<int>(attributes.rows()));
    out.mask = out.depth = out.silhouette = Image<T>(width, height, 1);
    out.face.assign(static_cast<std::size_t>(out.mask.size()), -1);
    out.barycentric = Columns<T>::Zero(3, out.mask.size());
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
        if (settings.silhouette.max_faces <= 0) return;
        SilhouetteTrace& trace = out.silhouettes[number];
        trace = silhouette_trace(screen, band, covered, width, settings.silhouette);
        for (std::size_t i = 0; i < trace.pixel.size(); ++i)
            out.silhouette.pixels(0, trace.pixel[i]) = scalar_cast<T>(silhouette_value(
                out.screen, {trace, i, width, settings.silhouette.sharpness}));
    });
    return out;
}

/// Returns the gradients of vertices and attributes, given those of the images, with the same mesh
/// and camera.
template <class T, Backend B>
MeshRasterGradient<T> rasterize_mesh_vjp(const B& backend, const MeshRaster<T>& raster,
                                         const AttributeMesh<T>& mesh,
                                         const Pinhole<real_t<T>>& camera,
                                         const MeshRasterCotangent<T>& g) {
    using W = widened_t<T>;
    const std::vector<Face>& faces = mesh.faces;
    const ColumnsView<T>& attributes = mesh.attributes;
    const Pinhole<double> view = camera.template cast<double>();
    const Columns<W>& points = raster.screen.camera;
    const int width = raster.mask.width;
    const Index pixels = raster.mask.size();
    std::vector<Index> drawn, band_begin;  // pixels with a face; first of them of each band
    for (Index p = 0; p < pixels; ++p) {
        if (p % (static_cast<Index>(width) * FaceBands::rows) == 0)
            band_begin.push_back(static_cast<Index>(drawn.size()));
        if (raster.face[static_cast<std::size_t>(p)] >= 0) drawn.push_back(p);
    }
    band_begin.push_back(static_cast<Index>(drawn.size()));

    // Contributions of every pixel first, in parallel; then sums over pixels, in parallel over
    // channels and ranges of vertices, so that each sum is in the order of the pixels.
    struct ImageShare {
        Index vertex;
        Vec2<W> g;
    };
    Columns<W> corner(9,
                      static_cast<Index>(drawn.size())); // gradients of the corners, camera frame
    std::vector<std::vector<ImageShare>> outline(raster.silhouettes.size());
    for_chunks(backend.threads, static_cast<Index>(outline.size()), 1, [&](Index b, Index, Index) {
        const std::size_t band = static_cast<std::size_t>(b);
        for (Index i = band_begin[band]; i < band_begin[band + 1]; ++i) {
            const Index p = drawn[static_cast<std::size_t>(i)];
            const Face& f =
                faces[static_cast<std::size_t>(raster.face[static_cast<std::size_t>(p)])];
            const double ray[2] = {(static_cast<double>(p % width) + 0.5 - view.cx) / view.fx,
                                   (static_cast<double>(p / width) + 0.5 - view.cy) / view.fy};
            const detail::PixelFace<W> at(points, f, ray[0], ray[1]);
            const W g_depth = g.depth ? scalar_cast<W>((*g.depth)(0, p)) : W(0);
            std::array<W, 3> g_b;
            W mean(0);
            for (std::size_t k = 0; k < 3; ++k) {
                g_b[k] = g_depth * points(2, f[k]);
                if (g.attributes)
                    g_b[k] += scalar_cast<W>(T(g.attributes->col(p).dot(attributes.col(f[k]))));
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
                const Index row = 3 * static_cast<Index>(k);
                corner(row, i) = g_r[k][0];
                corner(row + 1, i) = g_r[k][1];
                corner(row + 2, i) = g_depth * at.barycentric[k] -
                                     (g_r[k][0] * W(ray[0]) + g_r[k][1] * W(ray[1]));
            }
        }
        if (!g.silhouette) return;
        const SilhouetteTrace& trace = raster.silhouettes[band];
        for (std::size_t i = 0; i < trace.pixel.size(); ++i) {
            const W g_soft = scalar_cast<W>((*g.silhouette)(0, trace.pixel[i]));
            if (value_of(g_soft) == 0) continue;
            silhouette_vjp(raster.screen,
                           {trace, i, width, raster.settings.silhouette.sharpness}, g_soft,
                           [&](Index v, const Vec2<W>& share) {
                               outline[band].push_back({v, share});
                           });
        }
    });

    MeshRasterGradient<T> out{{}, Columns<T>::Zero(attributes.rows(), attributes.cols())};
    constexpr int block = 16;  // channels per task: one cache line of floats
    const Index blocks = g.attributes ? chunk_count(attributes.rows(), block) : 0;
    const Index ranges = std::clamp<Index>(backend.threads.size(), 1, 8);
    Columns<W> g_camera = Columns<W>::Zero(3, points.cols());
    Columns<W> g_image = Columns<W>::Zero(2, points.cols());
    for_chunks(backend.threads, 1 + (1 + blocks) * ranges, 1, [&](Index task, Index, Index) {
        if (task == 0) {
            for (const auto& shares : outline)
                for (const ImageShare& s : shares) g_image.col(s.vertex) += s.g;
            return;
        }
        const Index range = (task - 1) % ranges, kind = (task - 1) / ranges;
        const Index first = points.cols() * range / ranges,
                    end = points.cols() * (range + 1) / ranges;
        // Calls add(pixel's number, pixel, corner, vertex) for corners in the range.
        const auto each_corner = [&](const auto& add) {
            for (std::size_t i = 0; i < drawn.size(); ++i) {
                const Index p = drawn[i];
                const Face& f =
                    faces[static_cast<std::size_t>(raster.face[static_cast<std::size_t>(p)])];
                for (std::size_t k = 0; k < 3; ++k)
                    if (f[k] >= first && f[k] < end)
                        add(static_cast<Index>(i), p, static_cast<Index>(k), f[k]);
            }
        };
        if (kind == 0)
            return each_corner([&](Index i, Index, Index k, Index vertex) {
                g_camera.col(vertex) += corner.col(i).template segment<3>(3 * k);
            });
        const Index c = (kind - 1) * block;
        const auto add = [&](auto size) {
            each_corner([&](Index, Index p, Index k, Index vertex) {
                out.attributes.col(vertex).segment(c, size) +=
                    raster.barycentric(k, p) * g.attributes->col(p).segment(c, size);
            });
        };
        if (attributes.rows() - c >= block) return add(Eigen::fix<block>);
        add(attributes.rows() - c);
    });
    out.vertices =
        screen_mesh_vjp(backend.threads, raster.screen, camera, std::move(g_camera), g_image);
    return out;
}

} // namespace rye
