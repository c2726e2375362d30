// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/tet_grid.hpp: a tetrahedral grid that fills a box: body-centred cubic lattice, and
/// its subdivision. Units are those of the box. Every tetrahedron (a, b, c, d) is positively
/// oriented: det(b - a, c - a, d - a) > 0.
/// Source: the lattice of Labelle and Shewchuk, "Isosurface Stuffing", 2007; subdivision as DMTet.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/geometry/mesh.hpp>

namespace rye {

using Tet = std::array<Index, 4>;  ///< vertices (a, b, c, d)

namespace detail {

/// Corners of a tetrahedron's six edges, in the order of every table of edges.
inline constexpr std::array<std::array<std::size_t, 2>, 6> tet_edge_corners{
    {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}}};

} // namespace detail

/// Vertices of each tetrahedron, and the list of unique edges.
struct TetTopology {
    Index vertex_count = 0;
    std::vector<Tet> tets;
    std::vector<Edge> edges;                      ///< a < b, sorted lexicographically
    std::vector<std::array<Index, 6>> tet_edges;  ///< edge at each of tet_edge_corners
};

/// Tetrahedra with positions of their vertices.
template <Scalar T>
struct TetGrid {
    Columns<T> vertices;  ///< 3 x V
    TetTopology topology;
};

/// Builds the edges. Throws an Error if a vertex index is out of range or repeated in a
/// tetrahedron.
inline TetTopology tet_topology(Index vertex_count, std::vector<Tet> tets) {
    const auto at = [](Index i) { return static_cast<std::size_t>(i); };
    TetTopology out{vertex_count, std::move(tets), {}, {}};
    // Buckets by the lower vertex: two linear passes and short sorts instead of one long sort.
    std::vector<Index> begin(at(vertex_count) + 1, 0);
    const auto for_edges = [&](const Tet& tet, auto&& f) {
        for (std::size_t e = 0; e < 6; ++e) {
            const auto [lo, hi] = std::minmax(tet[detail::tet_edge_corners[e][0]],
                                              tet[detail::tet_edge_corners[e][1]]);
            f(e, Index{lo}, Index{hi});
        }
    };
    for (const Tet& tet : out.tets)
        for_edges(tet, [&](std::size_t, Index a, Index b) {
            if (!(a >= 0 && a < b && b < vertex_count))
                throw Error("tet_topology: edge (" + std::to_string(a) + ", " + std::to_string(b) +
                            ") does not join two different vertices of " +
                            std::to_string(vertex_count));
            ++begin[at(a) + 1];
        });
    for (std::size_t i = 1; i < begin.size(); ++i) begin[i] += begin[i - 1];
    std::vector<Index> upper(at(begin.back())), next(begin.begin(), begin.end() - 1);
    for (const Tet& tet : out.tets)
        for_edges(tet, [&](std::size_t, Index a, Index b) { upper[at(next[at(a)]++)] = b; });

    std::vector<Index> first(at(vertex_count) + 1, 0);  // edges of lower vertex a start at first[a]
    for (Index a = 0; a < vertex_count; ++a) {
        const auto lo = upper.begin() + begin[at(a)], hi = upper.begin() + begin[at(a) + 1];
        std::sort(lo, hi);
        for (auto i = lo, last = std::unique(lo, hi); i != last; ++i) out.edges.push_back({a, *i});
        first[at(a) + 1] = static_cast<Index>(out.edges.size());
    }
    out.tet_edges.resize(out.tets.size());
    for (std::size_t t = 0; t < out.tets.size(); ++t)
        for_edges(out.tets[t], [&](std::size_t e, Index a, Index b) {
            const auto lo = out.edges.begin() + first[at(a)],
                       hi = out.edges.begin() + first[at(a) + 1];
            out.tet_edges[t][e] = std::lower_bound(lo, hi, Edge{a, b}) - out.edges.begin();
        });
    return out;
}

/// Returns the signed volume det(b - a, c - a, d - a) / 6 of a tetrahedron.
template <class T>
T tet_volume(const ColumnsView<T>& vertices, const Tet& tet) {
    const Vec3<T> a = vertices.col(tet[0]), b = vertices.col(tet[1]), c = vertices.col(tet[2]);
    const Vec3<T> ad = Vec3<T>(vertices.col(tet[3])) - a;
    return area_vector<T>(a, b, c).dot(ad) / T(6);
}

/// Returns a body-centred cubic lattice that fills the box [lo, hi] exactly; throws an Error for
/// bad sizes. The cell edge is rounded to fit whole cells. Four tetrahedra surround each cell face:
/// its four sides, joined to the two cell centres (at the box border, to the cell and face
/// centres). Vertices: corners, then centres, then centres of border faces; about 12 tetrahedra per
/// cell.
template <Real T>
TetGrid<T> bcc_grid(const Vec3<T>& lo, const Vec3<T>& hi, T cell) {
    std::array<Index, 3> n{};
    double cells = 1;
    for (int d = 0; d < 3; ++d) {
        const double count = std::round(static_cast<double>((hi[d] - lo[d]) / cell));
        require(cell > T(0) && hi[d] > lo[d] && std::isfinite(count), "bcc_grid", "side ",
                hi[d] - lo[d], " and cell ", cell, " must be positive and finite");
        cells *= std::max(count, 1.0);
        require(cells < 1e8, "bcc_grid", "the cell of ", cell, " gives more than 1e8 cells");
        n[static_cast<std::size_t>(d)] = static_cast<Index>(std::max(count, 1.0));
    }
    const Index nx = n[0], ny = n[1], nz = n[2];
    const Index corners = (nx + 1) * (ny + 1) * (nz + 1), centres = nx * ny * nz;
    const Index count = corners + centres + 2 * (nx * ny + ny * nz + nz * nx);
    const auto corner = [&](const std::array<Index, 3>& i) {
        return (i[2] * (ny + 1) + i[1]) * (nx + 1) + i[0];
    };
    const auto centre = [&](const std::array<Index, 3>& i) {
        return corners + (i[2] * ny + i[1]) * nx + i[0];
    };
    TetGrid<T> grid;
    grid.vertices.resize(3, count);
    // Position of a vertex given in half cells, measured from the nearer side of the box, so that a
    // symmetric box gives a symmetric grid.
    const auto place = [&](Index vertex, const std::array<Index, 3>& half) {
        for (int d = 0; d < 3; ++d) {
            const Index h = half[static_cast<std::size_t>(d)],
                        all = 2 * n[static_cast<std::size_t>(d)];
            const T step = (hi[d] - lo[d]) / static_cast<T>(all);
            grid.vertices(d, vertex) = 2 * h < all   ? lo[d] + static_cast<T>(h) * step
                                       : 2 * h > all ? hi[d] - static_cast<T>(all - h) * step
                                                     : (lo[d] + hi[d]) / T(2);
        }
    };
    for (Index z = 0; z <= nz; ++z)
        for (Index y = 0; y <= ny; ++y)
            for (Index x = 0; x <= nx; ++x) {
                place(corner({x, y, z}), {2 * x, 2 * y, 2 * z});
                if (x < nx && y < ny && z < nz)
                    place(centre({x, y, z}), {2 * x + 1, 2 * y + 1, 2 * z + 1});
            }
    std::vector<Tet> tets;
    tets.reserve(static_cast<std::size_t>(12 * centres + 4 * (nx * ny + ny * nz + nz * nx)));
    Index middle = corners + centres;
    for (std::size_t d = 0; d < 3; ++d) {  // faces across axis d, spanned by axes u, v
        const std::size_t u = (d + 1) % 3, v = (d + 2) % 3;
        for (Index k = 0; k <= n[d]; ++k)
            for (Index j = 0; j < n[v]; ++j)
                for (Index i = 0; i < n[u]; ++i) {
                    std::array<Index, 3> low{}, below{}, half{};
                    low[d] = k, low[u] = i, low[v] = j;
                    below = low, below[d] = k - 1;
                    half[d] = 2 * k, half[u] = 2 * i + 1, half[v] = 2 * j + 1;
                    if (k == 0 || k == n[d]) place(middle, half);
                    const Index from = k == 0 ? middle++ : centre(below);
                    const Index to = k == n[d] ? middle++ : centre(low);
                    std::array<Index, 4> ring{};  // counter-clockwise about +d
                    for (std::size_t s = 0; s < 4; ++s) {
                        std::array<Index, 3> at = low;
                        at[u] += (s == 1 || s == 2) ? 1 : 0;
                        at[v] += s >= 2 ? 1 : 0;
                        ring[s] = corner(at);
                    }
                    for (std::size_t s = 0; s < 4; ++s)
                        tets.push_back({from, ring[s], ring[(s + 1) % 4], to});
                }
    }
    grid.topology = tet_topology(count, std::move(tets));
    return grid;
}

/// Splits every tetrahedron into eight; the midpoint of edge e becomes vertex V + e.
template <Scalar T>
TetGrid<T> subdivide(const TetGrid<T>& grid) {
    const TetTopology& top = grid.topology;
    const Index edge_count = static_cast<Index>(top.edges.size());
    TetGrid<T> out;
    out.vertices.resize(grid.vertices.rows(), top.vertex_count + edge_count);
    out.vertices.leftCols(top.vertex_count) = grid.vertices;
    for (Index e = 0; e < edge_count; ++e) {
        const auto [a, b] = top.edges[static_cast<std::size_t>(e)];
        out.vertices.col(top.vertex_count + e) =
            T(0.5) * (grid.vertices.col(a) + grid.vertices.col(b));
    }
    std::vector<Tet> tets;
    tets.reserve(8 * top.tets.size());
    for (std::size_t t = 0; t < top.tets.size(); ++t) {
        const auto [a, b, c, d] = top.tets[t];
        std::array<Index, 6> middle = top.tet_edges[t];
        for (Index& m : middle) m += top.vertex_count;
        const auto [ab, ac, ad, bc, bd, cd] = middle;
        tets.insert(tets.end(), {Tet{a, ab, ac, ad}, Tet{b, bc, ab, bd}, Tet{c, ac, bc, cd},
                                 Tet{d, ad, cd, bd}, Tet{ab, ac, ad, bd}, Tet{ab, ac, bd, bc},
                                 Tet{cd, ac, bd, ad}, Tet{cd, ac, bc, bd}});
    }
    out.topology = tet_topology(out.vertices.cols(), std::move(tets));
    return out;
}

} // namespace rye
