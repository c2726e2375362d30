// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/marching_tets.hpp: the zero surface of a signed distance given at the vertices of a
/// tetrahedral grid, and its vjp. sdf > 0 is outside, face normals point outside. The topology is
/// built from values and holds no scalar, so positions can be differentiated on a fixed topology.
/// Frame and units are those of the grid. Some functions also take a backend, on whose threads they
/// run, with the same bits. Source: Doi and Koide, 1991; triangle table of DMTet.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <rye/backend/scalar.hpp>
#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/geometry/mesh.hpp>
#include <rye/geometry/tet_grid.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

namespace detail {

/// Treatment of edges on which the formula t = s_a / (s_a - s_b) is singular or degenerate.
struct EdgeCut {
    /// If |s_a - s_b| is less, t = 1/2 with gradient 0: dt/ds is 1 / |s_a - s_b|, and gradients
    /// above 1e8 would only be noise. [units of the sdf]
    double min_difference = 1e-8;
    /// t is clamped to [min_fraction, 1 - min_fraction], gradient 0 beyond: a distance of exactly 0
    /// at a grid vertex would otherwise give faces without area. 1e-4 of an edge is invisible, yet
    /// hundreds of float ulps in a grid of a thousand cells. [1]
    double min_fraction = 1e-4;
};

} // namespace detail

/// Vertex i of the surface lies on grid edge edges[i] = (a, b), a < b; edges are sorted.
struct SurfaceTopology {
    std::vector<Edge> edges;
    std::vector<Face> faces;  ///< those of tetrahedra with one triangle first; empty: no surface

    Index vertex_count() const { return static_cast<Index>(edges.size()); }
};

/// Surface of zero signed distance, with the positions of its vertices on edges of tetrahedra.
template <Scalar T>
struct Surface {
    Columns<T> positions;  ///< 3 x M
    Columns<T> fraction;   ///< 1 x M: position = x_a + fraction (x_b - x_a)
    SurfaceTopology topology;
};

namespace detail {

/// Number of triangles and their tetrahedron edges for a case: the sum of 2^i over corners with sdf
/// > 0.
struct TetCase {
    int triangles;
    std::array<std::uint8_t, 6> edges;
};
inline constexpr std::array<TetCase, 16> tet_cases{{{0, {}},
                                                    {1, {1, 0, 2}},
                                                    {1, {4, 0, 3}},
                                                    {2, {1, 4, 2, 1, 3, 4}},
                                                    {1, {3, 1, 5}},
                                                    {2, {2, 3, 0, 2, 5, 3}},
                                                    {2, {1, 4, 0, 1, 5, 4}},
                                                    {1, {4, 2, 5}},
                                                    {1, {4, 5, 2}},
                                                    {2, {4, 1, 0, 4, 5, 1}},
                                                    {2, {3, 2, 0, 3, 5, 2}},
                                                    {1, {1, 3, 5}},
                                                    {2, {4, 1, 2, 4, 3, 1}},
                                                    {1, {3, 0, 4}},
                                                    {1, {2, 0, 1}},
                                                    {0, {}}}};

} // namespace detail

/// Returns the topology of the zero surface of sdf, 1 x V; sdf = 0 is inside. Throws an Error if
/// not finite.
template <class T, Backend B>
SurfaceTopology surface_topology(const B& backend, const TetTopology& grid,
                                 const std::type_identity_t<ColumnsView<T>>& sdf) {
    RYE_ASSERT(sdf.rows() == 1 && sdf.cols() == grid.vertex_count,
               "surface_topology: sdf is not 1 x V");
    using std::isfinite;
    constexpr Index grain = 16384;
    const auto at = [](Index i) { return static_cast<std::size_t>(i); };
    const auto count = [](const auto& v) { return static_cast<Index>(v.size()); };
    const auto chunks = [&](Index n) { return at(detail::chunk_count(n, grain)); };
    std::vector<std::uint8_t> outside(at(grid.vertex_count));
    for_chunks(backend.threads, grid.vertex_count, grain, [&](Index begin, Index end, Index) {
        for (Index v = begin; v < end; ++v) {
            if (!isfinite(sdf(0, v)))
                throw Error("surface_topology: the sdf at vertex " + std::to_string(v) + " is " +
                            number_text(static_cast<double>(value_of(sdf(0, v)))) +
                            ", not finite");
            outside[at(v)] = value_of(sdf(0, v)) > 0 ? 1 : 0;
        }
    });
    const std::uint8_t* const out_of = outside.data();
    // Crossing edges of each chunk, then where each chunk's begin.
    std::vector<std::vector<Index>> crossing(chunks(count(grid.edges)));
    for_chunks(backend.threads, count(grid.edges), grain, [&](Index begin, Index end, Index c) {
        std::vector<Index> own;
        const Edge* const edges = grid.edges.data();
        for (Index e = begin; e < end; ++e)
            if (out_of[edges[e][0]] != out_of[edges[e][1]]) own.push_back(e);
        crossing[at(c)] = std::move(own);
    });
    std::vector<Index> first{0};
    for (const std::vector<Index>& of : crossing) first.push_back(first.back() + count(of));
    SurfaceTopology out;
    if (first.back() == 0) return out;
    out.edges.resize(at(first.back()));
    std::vector<Index> vertex(grid.edges.size());  // on the surface, for each crossing grid edge
    for_chunks(backend.threads, count(crossing), 1, [&](Index c, Index, Index) {
        Index next = first[at(c)];
        for (const Index e : crossing[at(c)]) {
            vertex[at(e)] = next;
            out.edges[at(next++)] = grid.edges[at(e)];
        }
    });
    struct Faces {
        std::vector<Face> singles, pairs; ///< faces of tetrahedra with one triangle, with two
    };
    std::vector<Faces> found(chunks(count(grid.tets)));
    for_chunks(backend.threads, count(grid.tets), grain, [&](Index begin, Index end, Index chunk) {
        Faces own;
        const auto* const tets = grid.tets.data();
        for (Index t = begin; t < end; ++t) {
            const auto [a, b, c, d] = tets[t];
            const unsigned bits = out_of[a] | unsigned{out_of[b]} << 1U |
                                  unsigned{out_of[c]} << 2U | unsigned{out_of[d]} << 3U;
            const detail::TetCase& tet = detail::tet_cases[bits];
            if (tet.triangles == 0) continue;
            std::vector<Face>& faces = tet.triangles == 2 ? own.pairs : own.singles;
            const auto corner = [&](int i) {
                const std::uint8_t local = tet.edges[static_cast<std::size_t>(i)];
                return vertex[at(grid.tet_edges[at(t)][local])];
            };
            for (int i = 0; i < 3 * tet.triangles; i += 3)
                faces.push_back({corner(i), corner(i + 1), corner(i + 2)});
        }
        found[at(chunk)] = std::move(own);
    });
    for (const auto of : {&Faces::singles, &Faces::pairs})
        for (const Faces& f : found)
            out.faces.insert(out.faces.end(), (f.*of).begin(), (f.*of).end());
    return out;
}
/// Does the same on the calling thread.
template <class T>
SurfaceTopology surface_topology(const TetTopology& grid, const ColumnsView<T>& sdf) {
    return surface_topology<T>(ScalarBackend{Serial{}}, grid, sdf);
}

namespace detail {

/// Returns t = s_a / (s_a - s_b) of every surface vertex, 1 x M, with the exceptions of EdgeCut.
template <class T>
Columns<T> crossing_fractions(const SurfaceTopology& surface, const ColumnsView<T>& sdf,
                              const EdgeCut& cut = {}) {
    Columns<T> t(1, surface.vertex_count());
    for (Index i = 0; i < t.cols(); ++i) {
        const auto [a, b] = surface.edges[static_cast<std::size_t>(i)];
        const T difference = sdf(0, a) - sdf(0, b);
        const double d = static_cast<double>(value_of(difference));
        if (std::abs(d) < cut.min_difference) {
            t(0, i) = T(0.5);
            continue;
        }
        const T quotient = sdf(0, a) / difference;
        const double q = static_cast<double>(value_of(quotient));
        if (q < cut.min_fraction) t(0, i) = T(cut.min_fraction);
        else if (q > 1 - cut.min_fraction) t(0, i) = T(1 - cut.min_fraction);
        else t(0, i) = quotient;
    }
    return t;
}

/// Adds to g_sdf, 1 x V, the gradient through the fractions, given theirs, 1 x M.
/// dt/ds_a = -s_b / (s_a - s_b)^2 = (1 - t) / (s_a - s_b), dt/ds_b = t / (s_a - s_b).
template <class T>
void crossing_fractions_vjp(const SurfaceTopology& surface, const ColumnsView<T>& sdf,
                            const ColumnsView<T>& g_fraction, Columns<T>& g_sdf,
                            const EdgeCut& cut = {}) {
    for (Index i = 0; i < surface.vertex_count(); ++i) {
        const auto [a, b] = surface.edges[static_cast<std::size_t>(i)];
        const T difference = sdf(0, a) - sdf(0, b);
        if (std::abs(static_cast<double>(value_of(difference))) < cut.min_difference) continue;
        const T t = sdf(0, a) / difference;
        const double q = static_cast<double>(value_of(t));
        if (q < cut.min_fraction || q > 1 - cut.min_fraction) continue;
        const T g = g_fraction(0, i) / difference;
        g_sdf(0, a) += (T(1) - t) * g;
        g_sdf(0, b) += t * g;
    }
}

} // namespace detail

/// Interpolates grid values, C x V, at the surface's vertices, C x M: v_a + t (v_b - v_a).
template <class T, Backend B>
Columns<T> interpolate(const B& backend, const SurfaceTopology& surface,
                       const std::type_identity_t<ColumnsView<T>>& fraction,
                       const std::type_identity_t<ColumnsView<T>>& values) {
    Columns<T> out(values.rows(), surface.vertex_count());
    for_chunks(backend.threads, out.cols(), 1024, [&](Index begin, Index end, Index) {
        for (Index i = begin; i < end; ++i) {
            const auto [a, b] = surface.edges[static_cast<std::size_t>(i)];
            out.col(i) = values.col(a) + fraction(0, i) * (values.col(b) - values.col(a));
        }
    });
    return out;
}
/// Does the same on the calling thread.
template <class T>
Columns<T> interpolate(const SurfaceTopology& surface, const ColumnsView<T>& fraction,
                       const ColumnsView<T>& values) {
    return interpolate<T>(ScalarBackend{Serial{}}, surface, fraction, values);
}

/// Returns the gradient of values, C x V, and adds that of fraction, 1 x M, given that of the
/// result, C x M. Each sum is in the order of the surface's vertices, for any number of threads.
template <class T, Backend B>
Columns<T> interpolate_vjp(const B& backend, const SurfaceTopology& surface,
                           const std::type_identity_t<ColumnsView<T>>& fraction,
                           const std::type_identity_t<ColumnsView<T>>& values,
                           const std::type_identity_t<ColumnsView<T>>& g_out,
                           Columns<T>& g_fraction) {
    Columns<T> g_values = Columns<T>::Zero(values.rows(), values.cols());
    const Index vertices = surface.vertex_count();
    const auto to_fraction = [&](Index i) {
        const auto [a, b] = surface.edges[static_cast<std::size_t>(i)];
        g_fraction(0, i) += g_out.col(i).dot(values.col(b) - values.col(a));
    };
    const auto add = [&](Index i, bool second) {
        const T t = fraction(0, i);
        const Index v = surface.edges[static_cast<std::size_t>(i)][second ? 1 : 0];
        if (second)
            g_values.col(v) += t * g_out.col(i);
        else
            g_values.col(v) += (T(1) - t) * g_out.col(i);
    };
    if (values.rows() < 16 || backend.threads.size() < 4) { // lists would cost more
        for (Index i = 0; i < vertices; ++i) to_fraction(i), add(i, false), add(i, true);
        return g_values;
    }
    for_chunks(backend.threads, vertices, 1024, [&](Index begin, Index end, Index) {
        for (Index i = begin; i < end; ++i) to_fraction(i);
    });
    // Edges share their ends, so each thread takes grid vertices: the edge ends at each, in order.
    std::vector<Index> first(static_cast<std::size_t>(values.cols()) + 1, 0);
    for (const Edge& e : surface.edges)
        for (const Index v : e) ++first[static_cast<std::size_t>(v) + 1];
    for (std::size_t v = 1; v < first.size(); ++v) first[v] += first[v - 1];
    std::vector<Index> next(first.begin(), first.end() - 1), ends(2 * surface.edges.size());
    for (Index i = 0; i < vertices; ++i)
        for (std::size_t k = 0; k < 2; ++k) {
            const Index v = surface.edges[static_cast<std::size_t>(i)][k];
            ends[static_cast<std::size_t>(next[static_cast<std::size_t>(v)]++)] =
                2 * i + static_cast<Index>(k);
        }
    for_chunks(backend.threads, values.cols(), 512, [&](Index begin, Index end, Index) {
        for (Index n = first[static_cast<std::size_t>(begin)];
             n < first[static_cast<std::size_t>(end)]; ++n) {
            const Index of = ends[static_cast<std::size_t>(n)];
            add(of / 2, of % 2 != 0);
        }
    });
    return g_values;
}

/// Returns the vertex positions, 3 x M, on a fixed topology.
template <class T>
Columns<T> surface_positions(const SurfaceTopology& surface, const ColumnsView<T>& vertices,
                             const ColumnsView<T>& sdf, const detail::EdgeCut& cut = {}) {
    return interpolate<T>(surface, detail::crossing_fractions<T>(surface, sdf, cut), vertices);
}

/// Returns the surface where sdf, 1 x V, is zero; vertices is 3 x V and may differ from the grid's
/// own.
template <class T>
Surface<T> marching_tetrahedra(const TetTopology& grid, const ColumnsView<T>& vertices,
                               const ColumnsView<T>& sdf, const detail::EdgeCut& cut = {}) {
    Surface<T> out;
    out.topology = surface_topology<T>(grid, sdf);
    out.fraction = detail::crossing_fractions<T>(out.topology, sdf, cut);
    out.positions = interpolate<T>(out.topology, out.fraction, vertices);
    return out;
}

/// Inputs of a surface and of features on it, at grid vertices.
template <Scalar T>
struct SurfaceInputs {
    ColumnsView<T> vertices;  ///< 3 x V
    ColumnsView<T> sdf;       ///< 1 x V
    ColumnsView<T> features;  ///< C x V, C may be 0
};

namespace detail {

/// Cotangents at the surface's vertices.
template <Scalar T>
struct SurfaceCotangent {
    ColumnsView<T> positions;  ///< 3 x M
    ColumnsView<T> features;   ///< C x M, interpolated
};

} // namespace detail

/// Gradients of a surface's inputs.
template <Scalar T>
struct SurfaceGradient {
    Columns<T> vertices;  ///< 3 x V
    Columns<T> sdf;       ///< 1 x V
    Columns<T> features;  ///< C x V
};

/// Returns the gradients of the grid's vertices, sdf and features, given those at the surface's
/// vertices.
template <class T, Backend B>
SurfaceGradient<T> surface_vjp(const B& backend, const Surface<T>& surface,
                               const std::type_identity_t<SurfaceInputs<T>>& in,
                               const std::type_identity_t<detail::SurfaceCotangent<T>>& g_out,
                               const detail::EdgeCut& cut = {}) {
    const SurfaceTopology& top = surface.topology;
    const ColumnsView<T>& features = in.features;
    Columns<T> g_fraction = Columns<T>::Zero(1, top.vertex_count());
    SurfaceGradient<T> g{interpolate_vjp<T>(backend, top, surface.fraction, in.vertices,
                                            g_out.positions, g_fraction),
                         Columns<T>::Zero(1, in.sdf.cols()),
                         Columns<T>::Zero(features.rows(), features.cols())};
    if (features.rows() > 0)
        g.features = interpolate_vjp<T>(backend, top, surface.fraction, features, g_out.features,
                                        g_fraction);
    detail::crossing_fractions_vjp<T>(top, in.sdf, g_fraction, g.sdf, cut);
    return g;
}
/// Does the same on the calling thread.
template <class T>
SurfaceGradient<T> surface_vjp(const Surface<T>& surface, const SurfaceInputs<T>& in,
                               const detail::SurfaceCotangent<T>& g_out,
                               const detail::EdgeCut& cut = {}) {
    return surface_vjp<T>(ScalarBackend{Serial{}}, surface, in, g_out, cut);
}

namespace detail {

/// Returns the grid vertices on edges that the surface cuts, ascending. Only they have a gradient,
/// so networks over the grid need a trace and a backward pass for them alone.
inline std::vector<Index> touched_vertices(const SurfaceTopology& surface) {
    Index count = 0;
    for (const Edge& e : surface.edges) count = std::max({count, e[0] + 1, e[1] + 1});
    std::vector<std::uint8_t> touched(static_cast<std::size_t>(count), 0);
    for (const Edge& e : surface.edges)
        for (const Index v : e) touched[static_cast<std::size_t>(v)] = 1;
    std::vector<Index> out;
    for (Index v = 0; v < count; ++v)
        if (touched[static_cast<std::size_t>(v)] != 0) out.push_back(v);
    return out;
}

/// Returns the same surface with its edges renumbered to indices into the list `touched`.
inline SurfaceTopology over_touched(SurfaceTopology surface, const std::vector<Index>& touched) {
    std::vector<Index> place(touched.empty() ? 0 : static_cast<std::size_t>(touched.back()) + 1);
    for (std::size_t k = 0; k < touched.size(); ++k)
        place[static_cast<std::size_t>(touched[k])] = static_cast<Index>(k);
    for (Edge& e : surface.edges)
        for (Index& v : e) v = place[static_cast<std::size_t>(v)];
    return surface;
}

} // namespace detail

} // namespace rye
