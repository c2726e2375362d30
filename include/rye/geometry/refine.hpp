// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/refine.hpp: adaptive refinement of a triangle mesh by edge bisection.
/// Units are those of the vertices; orientation is preserved (see rye/geometry/mesh.hpp).
/// Source: edge bisection with the usual 1-, 2- and 3-edge templates.
#pragma once

#include <algorithm>
#include <cstddef>
#include <unordered_map>
#include <utility>
#include <vector>

#include <rye/geometry/mesh.hpp>

namespace rye {

namespace detail {

/// Hash of an edge, for maps whose order does not matter.
struct EdgeHash {
    std::size_t operator()(const Edge& e) const {
        return static_cast<std::size_t>(e[0]) * 0x9E3779B1U + static_cast<std::size_t>(e[1]);
    }
};

} // namespace detail

/// Halves every edge longer than spacing(midpoint), up to `passes` times. `attributes` (D x V) are
/// interpolated linearly. New vertices follow the old ones, in an order that depends on the faces'
/// order alone. spacing: Vec3<T> -> T, in the units of the vertices.
template <Scalar T, class Spacing>
void refine(TriangleMesh<T>& mesh, Columns<T>& attributes, Spacing&& spacing, int passes) {
    const auto at = [](Index i) { return static_cast<std::size_t>(i); };
    for (int pass = 0; pass < passes; ++pass) {
        // Midpoints of edges (smaller, larger); -1 for those that are not halved.
        std::unordered_map<Edge, Index, detail::EdgeHash> middle;
        middle.reserve(mesh.faces.size() * 3 / 2 + 1);
        std::vector<Edge> halved;
        const Index before = mesh.vertices.cols();
        const auto split = [&](Index a, Index b) -> Index {
            const Edge edge{std::min(a, b), std::max(a, b)};
            const auto [found, fresh] = middle.try_emplace(edge, Index(-1));
            if (!fresh) return found->second;
            const Vec3<T> d = mesh.vertices.col(a) - mesh.vertices.col(b);
            const Vec3<T> centre = T(0.5) * (mesh.vertices.col(a) + mesh.vertices.col(b));
            const T limit = spacing(centre);
            if (d.squaredNorm() > limit * limit) {
                found->second = before + static_cast<Index>(halved.size());
                halved.push_back(edge);
            }
            return found->second;
        };
        std::vector<Face> faces;
        faces.reserve(mesh.faces.size());
        for (const Face& f : mesh.faces) {
            std::array<Index, 3> m{split(f[0], f[1]), split(f[1], f[2]), split(f[2], f[0])};
            const auto count = std::count_if(m.begin(), m.end(), [](Index i) { return i >= 0; });
            std::array<Index, 3> v{f[0], f[1], f[2]};
            // Rotates the corners until edge 0 is halved, and edge 2 is not unless all are.
            for (int turn = 0; turn < 3 && count > 0 && count < 3 && (m[0] < 0 || m[2] >= 0);
                 ++turn) {
                std::rotate(m.begin(), m.begin() + 1, m.end());
                std::rotate(v.begin(), v.begin() + 1, v.end());
            }
            if (count == 0) {
                faces.push_back(f);
            } else if (count == 1) {
                faces.insert(faces.end(), {{v[0], m[0], v[2]}, {m[0], v[1], v[2]}});
            } else if (count == 2) {
                faces.insert(faces.end(),
                             {{m[0], v[1], m[1]}, {v[0], m[0], m[1]}, {v[0], m[1], v[2]}});
            } else {
                faces.insert(faces.end(), {{v[0], m[0], m[2]}, {m[0], v[1], m[1]},
                                           {m[2], m[1], v[2]}, {m[0], m[1], m[2]}});
            }
        }
        if (halved.empty()) return;
        const auto extend = [&](Columns<T>& c) {
            Columns<T> all(c.rows(), before + static_cast<Index>(halved.size()));
            all.leftCols(before) = c;
            for (Index i = before; i < all.cols(); ++i) {
                const auto [a, b] = halved[at(i - before)];
                all.col(i) = T(0.5) * (c.col(a) + c.col(b));
            }
            c = std::move(all);
        };
        extend(mesh.vertices);
        extend(attributes);
        mesh.faces = std::move(faces);
    }
}

} // namespace rye
