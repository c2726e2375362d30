// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/mesh.hpp: a triangle mesh and its uniform Laplacian.
/// Frame and units are those of the vertices. Corners of a face are counter-clockwise as seen from
/// outside, where its normal points. Source: the Laplacian of Gaussian Head Avatar's guidance mesh
/// (every face counts its two edges).
#pragma once

#include <array>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>
#include <rye/math/linalg.hpp>

namespace rye {

using Edge = std::array<Index, 2>;  ///< vertices (a, b)
using Face = std::array<Index, 3>;  ///< vertices (a, b, c)

/// Triangles over shared vertices.
template <Scalar T>
struct TriangleMesh {
    Columns<T> vertices;      ///< 3 x V
    std::vector<Face> faces;  ///< indices of vertices
};

/// Returns (b - a) x (c - a): twice the area times the outward normal. Takes differences first, so
/// a small triangle far from the origin stays accurate.
template <Scalar T>
Vec3<T> area_vector(const Vec3<T>& a, const Vec3<T>& b, const Vec3<T>& c) {
    return cross<T>(Vec3<T>(b - a), Vec3<T>(c - a));
}

namespace detail {

/// Returns the number of faces at each vertex.
inline std::vector<Index> face_counts(Index vertex_count, const std::vector<Face>& faces) {
    std::vector<Index> counts(static_cast<std::size_t>(vertex_count), 0);
    for (const Face& f : faces)
        for (const Index i : f) ++counts[static_cast<std::size_t>(i)];
    return counts;
}

} // namespace detail

/// Returns the Laplacian, D x V, in units of the vertices: at vertex i the sum over its n_i faces
/// (i, j, k) of (x_j - x_i) + (x_k - x_i), divided by 2 n_i; 0 at a vertex without faces.
template <class T>
Columns<T> uniform_laplacian(const ColumnsView<T>& vertices, const std::vector<Face>& faces) {
    const std::vector<Index> counts = detail::face_counts(vertices.cols(), faces);
    Columns<T> sum = Columns<T>::Zero(vertices.rows(), vertices.cols());
    for (const auto& [i, j, k] : faces)
        for (Index r = 0; r < vertices.rows(); ++r) {
            const T ij = vertices(r, j) - vertices(r, i);
            const T jk = vertices(r, k) - vertices(r, j);
            const T ki = vertices(r, i) - vertices(r, k);
            sum(r, i) += ij - ki;
            sum(r, j) += jk - ij;
            sum(r, k) += ki - jk;
        }
    for (Index i = 0; i < sum.cols(); ++i) {
        const Index n = counts[static_cast<std::size_t>(i)];
        if (n > 0) sum.col(i) *= T(0.5 / static_cast<double>(n));
    }
    return sum;
}

/// Returns the gradient of the vertices, D x V, given that of the Laplacian, D x V.
template <class T>
Columns<T> laplacian_vjp(const std::vector<Face>& faces, const ColumnsView<T>& g_laplacian) {
    const std::vector<Index> counts = detail::face_counts(g_laplacian.cols(), faces);
    Columns<T> w = g_laplacian;
    for (Index i = 0; i < w.cols(); ++i) {
        const Index n = counts[static_cast<std::size_t>(i)];
        w.col(i) *= T(n > 0 ? 0.5 / static_cast<double>(n) : 0.0);
    }
    Columns<T> g = Columns<T>::Zero(w.rows(), w.cols());
    for (const auto& [i, j, k] : faces)
        for (Index r = 0; r < w.rows(); ++r) {
            const T wi = w(r, i), wj = w(r, j), wk = w(r, k);
            g(r, i) += (wj - wi) + (wk - wi);
            g(r, j) += (wk - wj) + (wi - wj);
            g(r, k) += (wi - wk) + (wj - wk);
        }
    return g;
}

} // namespace rye
