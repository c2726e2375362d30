// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/makehuman_cut.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

#include "synthetic_capture/makehuman_tables.hpp"

namespace rye::trainer::makehuman {
namespace {

/// Number of the texture island of each texture coordinate.
std::vector<Index> islands(const QuadMesh& mesh) {
    std::vector<Index> parent(static_cast<std::size_t>(mesh.uv.cols()));
    std::iota(parent.begin(), parent.end(), Index(0));
    const auto root = [&](Index i) {
        for (auto k = static_cast<std::size_t>(i); parent[k] != i; k = static_cast<std::size_t>(i))
            i = parent[k] = parent[static_cast<std::size_t>(parent[k])];
        return i;
    };
    for (const Quad& q : mesh.faces)
        for (const Index u : q.uv) parent[static_cast<std::size_t>(root(u))] = root(q.uv[0]);
    std::vector<Index> island;
    for (Index i = 0; i < mesh.uv.cols(); ++i) island.push_back(root(i));
    return island;
}

/// Takes faces with two or more borders off the cut's edge, so that no teeth of a saw are left.
void trim_edge(const QuadMesh& mesh, std::vector<int>& parts) {
    constexpr int rounds = 3;
    for (int round = 0; round < rounds; ++round) {
        std::map<std::pair<Index, Index>, int> faces; // on each edge
        const auto edge = [&](const Quad& q, std::size_t k) {
            return std::minmax(q.vertex[k], q.vertex[(k + 1) % 4]);
        };
        for (std::size_t f = 0; f < parts.size(); ++f)
            for (std::size_t k = 0; parts[f] >= 0 && k < 4; ++k)
                ++faces[std::pair<Index, Index>(edge(mesh.faces[f], k))];
        for (std::size_t f = 0; f < parts.size(); ++f) {
            int borders = 0;
            for (std::size_t k = 0; parts[f] == head_neck && k < 4; ++k)
                borders += faces[std::pair<Index, Index>(edge(mesh.faces[f], k))] == 1;
            if (borders >= 2) parts[f] = elsewhere;
        }
    }
}

} // namespace

std::vector<int> parts_of(const QuadMesh& mesh) {
    const std::vector<Index> island = islands(mesh);
    constexpr std::array<std::pair<Index, int>, 4> known{{{makehuman::nose_tip, face},
                                                          {makehuman::palate, mouth_socket},
                                                          {makehuman::left_socket, socket},
                                                          {makehuman::right_socket, socket}}};
    std::array<Index, 4> known_island{-1, -1, -1, -1};
    for (const Quad& q : mesh.faces)
        for (std::size_t k = 0; k < 4; ++k)
            if (std::find(q.vertex.begin(), q.vertex.end(), known[k].first) != q.vertex.end())
                known_island[k] = island[static_cast<std::size_t>(q.uv[0])];
    std::vector<int> parts;
    for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
        const Quad& q = mesh.faces[f];
        const std::string& group = mesh.groups[mesh.group[f]];
        int part = elsewhere;
        if (group == "helper-tongue") part = tongue;
        if (group == "helper-upper-teeth" || group == "helper-lower-teeth") part = teeth;
        if (group == "helper-l-eye") part = left_eye;
        if (group == "helper-r-eye") part = right_eye;
        const auto near = [&](Index v) {
            return mesh.vertices(1, v) > makehuman::lowest &&
                   std::abs(mesh.vertices(0, v)) < makehuman::widest;
        };
        if (group == "body" && std::all_of(q.vertex.begin(), q.vertex.end(), near)) {
            part = head_neck;
            for (std::size_t k = 0; k < 4; ++k)
                if (known_island[k] == island[static_cast<std::size_t>(q.uv[0])])
                    part = known[k].second;
        }
        parts.push_back(part);
    }
    return parts;
}

Cut cut_head(const QuadMesh& base) {
    std::vector<int> parts = parts_of(base);
    trim_edge(base, parts);
    Cut cut;
    std::vector<Index> place(static_cast<std::size_t>(base.vertices.cols()), -1);
    std::vector<Quad> faces;
    std::vector<int> face_parts;
    for (std::size_t f = 0; f < parts.size(); ++f) {
        if (parts[f] < 0) continue;
        Quad q = base.faces[f];
        for (Index& v : q.vertex) {
            Index& at = place[static_cast<std::size_t>(v)];
            if (at < 0) {
                at = static_cast<Index>(cut.kept.size());
                cut.kept.push_back(v);
            }
            v = at;
        }
        faces.push_back(q);
        for (int k = 0; k < 4; ++k) cut.parts.push_back(parts[f]);
    }
    cut.mesh = subdivided(static_cast<Index>(cut.kept.size()), base.uv, faces);
    // Vertices at seams are of the first of their parts.
    const auto n = static_cast<std::size_t>(cut.mesh.weights.cols());
    std::vector<int> part(n, static_cast<int>(part_names.size()) - 1);
    for (std::size_t f = 0; f < cut.parts.size(); ++f)
        for (const Index v : cut.mesh.faces[f].vertex)
            part[static_cast<std::size_t>(v)] =
                std::min(part[static_cast<std::size_t>(v)], cut.parts[f]);
    cut.order.resize(n);
    std::iota(cut.order.begin(), cut.order.end(), Index(0));
    const auto part_at = [&](Index v) { return part[static_cast<std::size_t>(v)]; };
    std::stable_sort(cut.order.begin(), cut.order.end(),
                     [&](Index a, Index b) { return part_at(a) < part_at(b); });
    cut.place.resize(n);
    for (std::size_t i = 0; i < n; ++i)
        cut.place[static_cast<std::size_t>(cut.order[i])] = static_cast<Index>(i);
    Index at = 0;
    for (std::size_t p = 0; p < part_names.size(); ++p) {
        cut.range[p][0] = at;
        at += std::count(part.begin(), part.end(), static_cast<int>(p));
        cut.range[p][1] = at;
    }
    return cut;
}

} // namespace rye::trainer::makehuman
