// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/screen_mesh.hpp: a mesh projected by a pinhole camera: vertices in the camera and
/// image frames, bounding box and facing of each face, faces binned into bands of rows.
/// Frames: world [world units]; camera (x right, y down, z forward); image [px], centres at +0.5.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include <rye/autodiff/widen.hpp>
#include <rye/core/parallel.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/geometry/mesh.hpp>

namespace rye {

/// Projected vertices. Faces are a few pixels wide and far away, so their barycentrics subtract
/// nearly equal numbers: everything is kept widened (double for float).
template <Scalar T>
struct ScreenMesh {
    Columns<widened_t<T>> camera;  ///< 3 x M, camera frame
    Columns<widened_t<T>> image;   ///< 2 x M [px]; 0 for vertices that are not beyond near_depth
};

/// Screen-space properties of a face, from values alone.
struct ScreenFace {
    double left = 0, right = -1, top = 0, bottom = -1;  ///< box [px]; empty if not in front
    double area = 0;        ///< [px^2], positive if the outside is seen (normal . view < 0)
    double normal_z = 0;    ///< z of the unnormalised normal, in the camera frame
    bool in_front = false;  ///< all three corners are finite and beyond near_depth
};

/// Pixels whose centres lie in [lo, hi], clamped to 0 ... n - 1; empty if first > last.
struct PixelRange {
    int first, last;
};
/// Returns the pixels of [lo, hi] of a row or column of n.
inline PixelRange pixel_range(double lo, double hi, int n) {
    return {static_cast<int>(std::ceil(std::clamp(lo - 0.5, 0.0, static_cast<double>(n)))),
            static_cast<int>(std::floor(std::clamp(hi - 0.5, -1.0, n - 1.0)))};
}

/// Returns the vertices (3 x M, world) as a camera sees them.
template <class T>
ScreenMesh<T> screen_mesh(const ColumnsView<T>& vertices, const Pinhole<real_t<T>>& view) {
    using W = widened_t<T>;
    const Pinhole<double> p = view.template cast<double>();
    const Mat3<double>& r = p.camera_from_world.rotation;
    ScreenMesh<T> out{Columns<W>(3, vertices.cols()), Columns<W>::Zero(2, vertices.cols())};
    for (Index i = 0; i < vertices.cols(); ++i) {
        const W x = scalar_cast<W>(T(vertices(0, i))), y = scalar_cast<W>(T(vertices(1, i))),
                z = scalar_cast<W>(T(vertices(2, i)));
        for (int d = 0; d < 3; ++d)
            out.camera(d, i) = W(r(d, 0)) * x + W(r(d, 1)) * y + W(r(d, 2)) * z +
                               W(p.camera_from_world.translation[d]);
        if (!(value_of(out.camera(2, i)) > p.near_depth)) continue;
        const W iz = W(1) / out.camera(2, i);
        out.image(0, i) = W(p.fx) * out.camera(0, i) * iz + W(p.cx);                       // [px]
        out.image(1, i) = W(p.fy) * out.camera(1, i) * iz + W(p.cy);                       // [px]
    }
    return out;
}

/// Returns the gradient of the vertices, 3 x M, given those of their camera points, 3 x M, and
/// image points, 2 x M, the latter being 0 for vertices that are not beyond near_depth.
template <class T>
Columns<T> screen_mesh_vjp(const ScreenMesh<T>& mesh, const Pinhole<real_t<T>>& view,
                           Columns<widened_t<T>> g_camera, const Columns<widened_t<T>>& g_image) {
    using W = widened_t<T>;
    const Pinhole<double> p = view.template cast<double>();
    const Mat3<double>& r = p.camera_from_world.rotation;
    Columns<T> g(3, g_camera.cols());
    for (Index i = 0; i < g.cols(); ++i) {
        if (value_of(mesh.camera(2, i)) > p.near_depth) {
            const W iz = W(1) / mesh.camera(2, i);
            const W gx = W(p.fx) * g_image(0, i) * iz, gy = W(p.fy) * g_image(1, i) * iz;
            g_camera(0, i) += gx;
            g_camera(1, i) += gy;
            g_camera(2, i) -= (gx * mesh.camera(0, i) + gy * mesh.camera(1, i)) * iz;
        }
        for (int d = 0; d < 3; ++d)
            g(d, i) = scalar_cast<T>(W(W(r(0, d)) * g_camera(0, i) + W(r(1, d)) * g_camera(1, i) +
                                       W(r(2, d)) * g_camera(2, i)));
    }
    return g;
}

/// Returns the box, area and side of each face.
template <class T>
std::vector<ScreenFace> screen_faces(const ScreenMesh<T>& mesh, const std::vector<Face>& faces,
                                     double near_depth) {
    std::vector<ScreenFace> out(faces.size());
    const auto value = [](const auto& m, Index row, Index i) {
        return static_cast<double>(value_of(m(row, i)));
    };
    for (std::size_t f = 0; f < faces.size(); ++f) {
        Mat3<double> c;  // corners in the camera frame
        Mat<double, 2, 3> q;
        bool ok = true;
        for (int k = 0; k < 3; ++k) {
            const Index i = faces[f][static_cast<std::size_t>(k)];
            for (int d = 0; d < 3; ++d) c(d, k) = value(mesh.camera, d, i);
            for (int d = 0; d < 2; ++d) q(d, k) = value(mesh.image, d, i);
            ok = ok && c(2, k) > near_depth && std::isfinite(q(0, k)) && std::isfinite(q(1, k)) &&
                 std::isfinite(c(2, k));
        }
        if (!ok) continue;
        ScreenFace& s = out[f];
        s.in_front = true;
        s.left = std::min({q(0, 0), q(0, 1), q(0, 2)});
        s.right = std::max({q(0, 0), q(0, 1), q(0, 2)});
        s.top = std::min({q(1, 0), q(1, 1), q(1, 2)});
        s.bottom = std::max({q(1, 0), q(1, 1), q(1, 2)});
        const auto turn = [](const auto& m) {
            return (m(0, 1) - m(0, 0)) * (m(1, 2) - m(1, 0)) -
                   (m(1, 1) - m(1, 0)) * (m(0, 2) - m(0, 0));
        };
        s.area = -0.5 * turn(q);  // y points down, so a front face is clockwise: negative
        s.normal_z = turn(c);
    }
    return out;
}

/// Faces, by index, whose boxes plus a margin overlap a band of rows.
struct FaceBands {
    static constexpr int rows = 16;  ///< fixed, so results do not depend on the number of threads
    std::vector<Index> begin;        ///< faces[begin[b]] ... faces[begin[b + 1] - 1] are in band b
    std::vector<Index> faces;

    Index count() const { return static_cast<Index>(begin.size()) - 1; }
};

/// Band of rows and its faces.
struct FaceBand {
    const Index *first, *last;  ///< indices of its faces
    int row, rows;              ///< first row, number of rows
};

/// Faces of a projected mesh, with their boxes.
template <Scalar T>
struct ScreenFaces {
    const ScreenMesh<T>& mesh;
    const std::vector<Face>& faces;
    const std::vector<ScreenFace>& boxes;
};

/// Returns the faces that each band of rows may show, with a margin around their boxes [px].
inline FaceBands face_bands(const std::vector<ScreenFace>& faces, int width, int height,
                            double margin_px) {
    FaceBands out;
    out.begin.assign(static_cast<std::size_t>(chunk_count(height, FaceBands::rows)) + 1, 0);
    const auto visit = [&](auto&& f) {
        for (std::size_t i = 0; i < faces.size(); ++i) {
            const ScreenFace& s = faces[i];
            if (!s.in_front) continue;
            const PixelRange x = pixel_range(s.left - margin_px, s.right + margin_px, width);
            const PixelRange y = pixel_range(s.top - margin_px, s.bottom + margin_px, height);
            if (x.first > x.last || y.first > y.last) continue;
            for (int b = y.first / FaceBands::rows; b <= y.last / FaceBands::rows; ++b)
                f(static_cast<std::size_t>(b), static_cast<Index>(i));
        }
    };
    visit([&](std::size_t b, Index) { ++out.begin[b + 1]; });
    for (std::size_t b = 1; b < out.begin.size(); ++b) out.begin[b] += out.begin[b - 1];
    out.faces.resize(static_cast<std::size_t>(out.begin.back()));
    std::vector<Index> next = out.begin;
    visit([&](std::size_t b, Index i) { out.faces[static_cast<std::size_t>(next[b]++)] = i; });
    return out;
}

} // namespace rye
