// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/subdivision.hpp"

#include <map>
#include <utility>

namespace rye::trainer {
namespace {

using Pair = std::pair<Index, Index>;
using Weights = std::map<Index, double>; // of the vertices before

Pair edge(Index a, Index b) { return {std::min(a, b), std::max(a, b)}; }

void add(Weights& to, const Weights& from, double by) {
    for (const auto& [vertex, weight] : from) to[vertex] += by * weight;
}

struct Edge {
    Index number = 0;
    std::vector<std::size_t> faces;
};
using Edges = std::map<Pair, Edge>;

Edges edges_of(const std::vector<Quad>& faces) {
    Edges edges;
    for (std::size_t f = 0; f < faces.size(); ++f)
        for (std::size_t k = 0; k < 4; ++k) {
            const auto& v = faces[f].vertex;
            const auto [at, fresh] = edges.try_emplace(edge(v[k], v[(k + 1) % 4]));
            if (fresh) at->second.number = static_cast<Index>(edges.size()) - 1;
            at->second.faces.push_back(f);
        }
    return edges;
}

/// Weights of a vertex after the step, from the middles of its faces and edges.
std::vector<Weights> moved_vertices(Index count, const std::vector<Quad>& faces,
                                    const std::vector<Weights>& middles, const Edges& edges) {
    const auto n = static_cast<std::size_t>(count);
    std::vector<Weights> moved(n), rim(n);
    std::vector<int> valence(n, 0), rims(n, 0);
    for (std::size_t f = 0; f < faces.size(); ++f)
        for (const Index v : faces[f].vertex) {
            const auto i = static_cast<std::size_t>(v);
            add(moved[i], middles[f], 1);
            ++valence[i];
        }
    for (const auto& [ends, e] : edges)
        for (const auto& [from, to] : {ends, Pair(ends.second, ends.first)}) {
            const auto i = static_cast<std::size_t>(from);
            moved[i][to] += 1; // twice the middle, less the vertex
            moved[i][from] += 1;
            if (e.faces.size() != 1) continue;
            rim[i][to] += 1.0 / 8;
            ++rims[i];
        }
    for (std::size_t i = 0; i < n; ++i) {
        const auto v = static_cast<Index>(i);
        if (rims[i] > 0 || valence[i] == 0) {
            moved[i] = rims[i] == 2 ? rim[i] : Weights{};
            moved[i][v] += rims[i] == 2 ? 3.0 / 4 : 1;
            continue;
        }
        const double k = valence[i];
        for (auto& [vertex, weight] : moved[i]) weight /= k * k;
        moved[i][v] += (k - 3) / k;
    }
    return moved;
}

} // namespace

Subdivision subdivided(Index vertices, const Columns<double>& uv, const std::vector<Quad>& faces) {
    const Edges edges = edges_of(faces);
    std::vector<Weights> middles(faces.size());
    for (std::size_t f = 0; f < faces.size(); ++f)
        for (const Index v : faces[f].vertex) middles[f][v] += 0.25;
    std::vector<Weights> all = moved_vertices(vertices, faces, middles, edges);
    const Index first_edge = vertices, first_face = vertices + static_cast<Index>(edges.size());
    all.resize(static_cast<std::size_t>(first_face) + faces.size());
    for (const auto& [ends, e] : edges) {
        Weights& w = all[static_cast<std::size_t>(first_edge + e.number)];
        const double share = e.faces.size() == 2 ? 0.25 : 0.5;
        w[ends.first] += share;
        w[ends.second] += share;
        if (e.faces.size() == 2)
            for (const std::size_t f : e.faces) add(w, middles[f], 0.25);
    }
    for (std::size_t f = 0; f < faces.size(); ++f)
        all[static_cast<std::size_t>(first_face) + f] = middles[f];

    Subdivision out;
    std::vector<Eigen::Triplet<double>> triplets;
    for (std::size_t i = 0; i < all.size(); ++i)
        for (const auto& [vertex, weight] : all[i])
            triplets.emplace_back(vertex, static_cast<Index>(i), weight);
    out.weights.resize(vertices, static_cast<Index>(all.size()));
    out.weights.setFromTriplets(triplets.begin(), triplets.end());

    std::vector<Vec2<double>> places;
    for (Index i = 0; i < uv.cols(); ++i) places.emplace_back(uv.col(i));
    std::map<Pair, Index> halves;
    for (std::size_t f = 0; f < faces.size(); ++f) {
        const Quad& q = faces[f];
        std::array<Index, 4> half{}, half_uv{};
        Vec2<double> sum(0, 0);
        for (std::size_t k = 0; k < 4; ++k) {
            const std::size_t next = (k + 1) % 4;
            half[k] = first_edge + edges.at(edge(q.vertex[k], q.vertex[next])).number;
            const auto [at, fresh] =
                halves.try_emplace(edge(q.uv[k], q.uv[next]), static_cast<Index>(places.size()));
            if (fresh) places.emplace_back(0.5 * (uv.col(q.uv[k]) + uv.col(q.uv[next])));
            half_uv[k] = at->second;
            sum += uv.col(q.uv[k]);
        }
        const Index middle = first_face + static_cast<Index>(f);
        const auto middle_uv = static_cast<Index>(places.size());
        places.emplace_back(0.25 * sum);
        for (std::size_t k = 0; k < 4; ++k) {
            const std::size_t before = (k + 3) % 4;
            out.faces.push_back({{q.vertex[k], half[k], middle, half[before]},
                                 {q.uv[k], half_uv[k], middle_uv, half_uv[before]}});
        }
    }
    out.uv.resize(2, static_cast<Index>(places.size()));
    for (std::size_t i = 0; i < places.size(); ++i) out.uv.col(static_cast<Index>(i)) = places[i];
    return out;
}

} // namespace rye::trainer
