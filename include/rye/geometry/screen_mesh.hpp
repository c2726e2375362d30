// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/screen_mesh.hpp: a mesh projected by a pinhole camera: vertices in the camera and
/// image frames, bounding box and facing of each face, faces binned into bands of rows.
/// Frames: world [world units]; camera (x right, y down, z forward); image [px], centres at +0.5.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>
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
    Columns<detail::widened_t<T>> camera; ///< 3 x M, camera frame
    Columns<detail::widened_t<T>>
        image; ///< 2 x M [px]; 0 for vertices that are not beyond near_depth
};

namespace detail {

/// Screen-space properties of a face, from values alone.
struct ScreenFace {
    double left = 0, right = -1, top = 0, bottom = -1;  ///< box [px]; empty if not in front
    double area = 0;        ///< [px^2], positive if the outside is seen (normal . view < 0)
    double normal_z = 0;    ///< z of the unnormalised normal, in the camera frame
    bool in_front = false;  ///< all three corners are finite and beyond near_depth
};

/// Vertices or faces of a task.
inline constexpr Index screen_grain = 512;

/// Pixels whose centres lie in [lo, hi], clamped to 0 ... n - 1; empty if first > last.
struct PixelRange {
    int first, last;
};
/// Returns the pixels of [lo, hi] of a row or column of n.
inline PixelRange pixel_range(double lo, double hi, int n) {
    return {static_cast<int>(std::ceil(std::clamp(lo - 0.5, 0.0, static_cast<double>(n)))),
            static_cast<int>(std::floor(std::clamp(hi - 0.5, -1.0, n - 1.0)))};
}

} // namespace detail

/// Returns the vertices (3 x M, world) as a camera sees them.
template <class T, Threads P>
ScreenMesh<T> screen_mesh(const P& threads, const ColumnsView<T>& vertices,
                          const Pinhole<real_t<T>>& view) {
    using W = detail::widened_t<T>;
    const Pinhole<double> p = view.template cast<double>();
    const Mat3<double>& r = p.camera_from_world.rotation;
    ScreenMesh<T> out{Columns<W>(3, vertices.cols()), Columns<W>::Zero(2, vertices.cols())};
    const auto project = [&](Index i) {
        const W x = detail::scalar_cast<W>(T(vertices(0, i))),
                y = detail::scalar_cast<W>(T(vertices(1, i))),
                z = detail::scalar_cast<W>(T(vertices(2, i)));
        for (int d = 0; d < 3; ++d)
            out.camera(d, i) = W(r(d, 0)) * x + W(r(d, 1)) * y + W(r(d, 2)) * z +
                               W(p.camera_from_world.translation[d]);
        if (!(value_of(out.camera(2, i)) > p.near_depth)) return;
        const W iz = W(1) / out.camera(2, i);
        out.image(0, i) = W(p.fx) * out.camera(0, i) * iz + W(p.cx);                       // [px]
        out.image(1, i) = W(p.fy) * out.camera(1, i) * iz + W(p.cy);                       // [px]
    };
    for_chunks(threads, vertices.cols(), detail::screen_grain, [&](Index b, Index e, Index) {
        for (Index i = b; i < e; ++i) project(i);
    });
    return out;
}

/// Returns the gradient of the vertices, 3 x M, given those of their camera points, 3 x M, and
/// image points, 2 x M, the latter being 0 for vertices that are not beyond near_depth.
template <class T, Threads P>
Columns<T> screen_mesh_vjp(const P& threads, const ScreenMesh<T>& mesh,
                           const Pinhole<real_t<T>>& view, Columns<detail::widened_t<T>> g_camera,
                           const Columns<detail::widened_t<T>>& g_image) {
    using W = detail::widened_t<T>;
    const Pinhole<double> p = view.template cast<double>();
    const Mat3<double>& r = p.camera_from_world.rotation;
    Columns<T> g(3, g_camera.cols());
    const auto pull = [&](Index i) {
        if (value_of(mesh.camera(2, i)) > p.near_depth) {
            const W iz = W(1) / mesh.camera(2, i);
            const W gx = W(p.fx) * g_image(0, i) * iz, gy = W(p.fy) * g_image(1, i) * iz;
            g_camera(0, i) += gx;
            g_camera(1, i) += gy;
            g_camera(2, i) -= (gx * mesh.camera(0, i) + gy * mesh.camera(1, i)) * iz;
        }
        for (int d = 0; d < 3; ++d)
            g(d, i) =
                detail::scalar_cast<T>(W(W(r(0, d)) * g_camera(0, i) + W(r(1, d)) * g_camera(1, i) +
                                         W(r(2, d)) * g_camera(2, i)));
    };
    for_chunks(threads, g.cols(), detail::screen_grain, [&](Index b, Index e, Index) {
        for (Index i = b; i < e; ++i) pull(i);
    });
    return g;
}

namespace detail {

/// Returns the box, area and side of each face.
template <class T, Threads P>
std::vector<ScreenFace> screen_faces(const P& threads, const ScreenMesh<T>& mesh,
                                     const std::vector<Face>& faces, double near_depth) {
    std::vector<ScreenFace> out(faces.size());
    const auto value = [](const auto& m, Index row, Index i) {
        return static_cast<double>(value_of(m(row, i)));
    };
    const auto place = [&](std::size_t f) {
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
        if (!ok) return;
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
    };
    for_chunks(threads, static_cast<Index>(faces.size()), detail::screen_grain,
               [&](Index b, Index e, Index) {
                   for (Index f = b; f < e; ++f) place(static_cast<std::size_t>(f));
               });
    return out;
}

/// Faces, by index, whose boxes plus a margin overlap a band of rows.
struct FaceBands {
    static constexpr int rows = 8;   ///< fixed, so results do not depend on the number of threads
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
template <Threads P>
FaceBands face_bands(const P& threads, const std::vector<ScreenFace>& faces,
                     const ImageSize& size, double margin_px) {
    FaceBands out;
    const auto bands = static_cast<std::size_t>(chunk_count(size.height, FaceBands::rows));
    const auto count = static_cast<Index>(faces.size());
    const auto visit = [&](Index begin, Index end, const auto& f) {
        for (Index i = begin; i < end; ++i) {
            const ScreenFace& s = faces[static_cast<std::size_t>(i)];
            if (!s.in_front) continue;
            const PixelRange x = pixel_range(s.left - margin_px, s.right + margin_px, size.width);
            const PixelRange y = pixel_range(s.top - margin_px, s.bottom + margin_px, size.height);
            if (x.first > x.last || y.first > y.last) continue;
            for (int b = y.first / FaceBands::rows; b <= y.last / FaceBands::rows; ++b)
                f(static_cast<std::size_t>(b), i);
        }
    };
    // Faces of each chunk in each band, then where these begin.
    std::vector<std::vector<Index>> at(
        static_cast<std::size_t>(chunk_count(count, detail::screen_grain)),
        std::vector<Index>(bands, 0));
    const auto chunks = [&](const auto& f) {
        for_chunks(threads, count, detail::screen_grain, [&](Index b, Index e, Index c) {
            f(b, e, at[static_cast<std::size_t>(c)]);
        });
    };
    chunks([&](Index begin, Index end, std::vector<Index>& own) {
        visit(begin, end, [&](std::size_t b, Index) { ++own[b]; });
    });
    Index next = 0;
    for (std::size_t b = 0; b < bands; ++b) {
        out.begin.push_back(next);
        for (std::vector<Index>& own : at) next += std::exchange(own[b], next);
    }
    out.begin.push_back(next);
    out.faces.resize(static_cast<std::size_t>(next));
    chunks([&](Index begin, Index end, std::vector<Index>& own) {
        visit(begin, end, [&](std::size_t b, Index i) {
            out.faces[static_cast<std::size_t>(own[b]++)] = i;
        });
    });
    return out;
}

} // namespace detail

} // namespace rye
