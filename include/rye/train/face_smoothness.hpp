// SPDX-License-Identifier: Apache-2.0
/// rye/train/face_smoothness.hpp: priors of the face's features, for parts that no picture shows:
/// the smoothness of loss/smoothness.hpp between neighbours on the face, and between the two sides
/// of the head. Observations outweigh them. Neighbours are those of the positions at which stage 2
/// begins, and stay the same. Not in the paper; see docs/deviations.md.
#pragma once

#include <utility>
#include <vector>

#include <rye/backend/backend.hpp>
#include <rye/geometry/neighbours.hpp>
#include <rye/loss/smoothness.hpp>
#include <rye/train/avatar_objective.hpp>

namespace rye {

/// Neighbours of the face's Gaussians; a graph is empty if its weight is 0.
struct FaceNeighbours {
    detail::NeighbourGraph near;   ///< the four nearest others
    detail::NeighbourGraph mirror; ///< mirrored_nearest
};

namespace detail {

/// Returns the four nearest others of each point (3 x N, N > 4), as four_nearest, by a grid.
template <Real T, Backend B>
NeighbourGraph four_nearest_by_grid(const B& backend, const Columns<T>& points) {
    require(points.cols() > 4, "four_nearest_by_grid", "got ", points.cols(),
            " points, expected at least 5");
    const PointGrid<T> grid(points);
    NeighbourGraph graph(static_cast<std::size_t>(points.cols()));
    for_chunks(backend.threads, points.cols(), 1024, [&](Index b, Index e, Index) {
        for (Index i = b; i < e; ++i)
            graph[static_cast<std::size_t>(i)] = grid.template nearest<4>(points.col(i), i);
    });
    return graph;
}

} // namespace detail

/// Returns, for each point (3 x N, N > 0, the subject's left toward +x), the one nearest to it
/// mirrored at x = 0, and three times the point itself, from which it does not differ.
template <Real T, Backend B>
detail::NeighbourGraph mirrored_nearest(const B& backend, const Columns<T>& points) {
    require(points.cols() > 0, "mirrored_nearest", "got no points, expected at least one");
    const detail::PointGrid<T> grid(points);
    detail::NeighbourGraph graph(static_cast<std::size_t>(points.cols()));
    for_chunks(backend.threads, points.cols(), 1024, [&](Index b, Index e, Index) {
        for (Index i = b; i < e; ++i) {
            const Vec3<T> across(-points(0, i), points(1, i), points(2, i));
            graph[static_cast<std::size_t>(i)] = {grid.template nearest<1>(across)[0], i, i, i};
        }
    });
    return graph;
}

/// Returns the graphs whose weights are above 0. positions: those at which the face's Gaussians
/// begin, head frame, canonical units, 3 x N.
template <Real T, Backend B>
FaceNeighbours face_neighbours(const B& backend, const Columns<T>& positions,
                               const AvatarLossConfig& weights) {
    FaceNeighbours n;
    if (weights.face_smooth > 0) n.near = detail::four_nearest_by_grid(backend, positions);
    if (weights.face_mirror > 0) n.mirror = mirrored_nearest(backend, positions);
    return n;
}

namespace detail {

/// Throws an Error unless each graph whose weight is above 0 has `points` points.
inline void require_face_neighbours(const AvatarLossConfig& weights, const FaceNeighbours& n,
                                    Index points) {
    const auto fits = [&](const char* name, double weight, const NeighbourGraph& graph) {
        require(!(weight > 0) || static_cast<Index>(graph.size()) == points, "face_neighbours",
                "weights.", name, " is ", weight, " and its graph has ", graph.size(),
                " points, expected those of the face, ", points,
                ", where stage 2 began; after a change of density there is no such graph");
    };
    fits("face_smooth", weights.face_smooth, n.near);
    fits("face_mirror", weights.face_mirror, n.mirror);
}

} // namespace detail

/// Returns what the priors are of, C x N: the features of a face with drivers, else its colours.
template <class Face>
auto& face_features(Face& face) {
    if constexpr (requires { face.feature.rows(); })
        return face.feature;
    else
        return face.rest_color;
}

/// The priors as terms of a step on the host.
class FaceSmoothness {
  public:
    FaceSmoothness() = default;
    /// Throws an Error for graphs that do not fit a face of `points`.
    FaceSmoothness(const AvatarLossConfig& weights, FaceNeighbours neighbours, Index points)
        : smooth_(weights.face_smooth), mirror_(weights.face_mirror) {
        detail::require_face_neighbours(weights, neighbours, points);
        graphs_ = std::move(neighbours);
        if (smooth_ > 0) near_of_ = detail::neighbour_of(graphs_.near);
        if (mirror_ > 0) mirror_of_ = detail::neighbour_of(graphs_.mirror);
    }

    /// Adds the terms that are on to the losses, and their weighted gradient to that of the
    /// features; both C x N.
    template <Real T, Threads P>
    void add(const P& threads, const Columns<T>& features, AvatarLosses<T>& losses,
             Columns<T>& gradient) const {
        const auto term = [&](double weight, const detail::NeighbourGraph& graph,
                              const std::vector<std::vector<Index>>& of, T& value) {
            if (!(weight > 0)) return;
            const LossGradient<T> l = smoothness(threads, features, graph, of);
            detail::add_weighted<T>(threads, gradient, T(weight), l.gradient);
            value = l.value;
            losses.total += T(weight) * l.value;
        };
        term(smooth_, graphs_.near, near_of_, losses.face_smooth);
        term(mirror_, graphs_.mirror, mirror_of_, losses.face_mirror);
    }

  private:
    double smooth_ = 0, mirror_ = 0; ///< weights
    FaceNeighbours graphs_;
    std::vector<std::vector<Index>> near_of_, mirror_of_; ///< neighbour_of the graphs
};

} // namespace rye
