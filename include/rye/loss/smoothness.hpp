// SPDX-License-Identifier: Apache-2.0
/// rye/loss/smoothness.hpp: smoothness prior over a fixed neighbour graph: a mean of squared
/// differences, for colours of points that few pixels observe. Observations outweigh it; a point
/// without any takes its neighbours' value. Not in the paper; see docs/deviations.md.
#pragma once

#include <algorithm>
#include <array>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>
#include <rye/core/error.hpp>
#include <rye/core/parallel.hpp>
#include <rye/loss/photometric.hpp>

namespace rye {

namespace detail {

/// Neighbours of each point of a cloud, by index.
using NeighbourGraph = std::vector<std::array<Index, 4>>;

/// Returns the four nearest neighbours of each point (3 x N, N > 4), ties by lower index. Adds
/// `first` to every index. O(N^2): for the thousands of points of an eye.
template <Real T>
NeighbourGraph four_nearest(const Columns<T>& points, Index first = 0) {
    const Index n = points.cols();
    require(n > 4, "four_nearest", "got ", n, " points, expected at least 5");
    NeighbourGraph graph;
    std::vector<std::pair<T, Index>> by_distance;
    for (Index i = 0; i < n; ++i) {
        by_distance.clear();
        for (Index k = 0; k < n; ++k)
            if (k != i) by_distance.emplace_back((points.col(k) - points.col(i)).squaredNorm(), k);
        std::partial_sort(by_distance.begin(), by_distance.begin() + 4, by_distance.end());
        auto& of_i = graph.emplace_back();
        for (std::size_t k = 0; k < 4; ++k) of_i[k] = first + by_distance[k].second;
    }
    return graph;
}

/// Returns a graph of an eyeball's points (eyeball frame: relative to its centre, iris toward +z,
/// 3 x N, N > 4): for each point the three nearest, and the one nearest to its position after a
/// quarter turn about +z; the fourth nearest if that is the point itself or one of the three. An
/// eyeball looks alike all around its axis, so that an unobserved part takes the colour of its
/// ring, not of the shadow at the edge of the observed part.
template <Real T>
NeighbourGraph nearest_and_turned(const Columns<T>& points, Index first = 0) {
    NeighbourGraph graph = four_nearest(points, first);
    for (Index i = 0; i < points.cols(); ++i) {
        const Vec3<T> p = points.col(i), turned(-p.y(), p.x(), p.z());
        Index nearest = 0;
        (points.colwise() - turned).colwise().squaredNorm().minCoeff(&nearest);
        auto& of_i = graph[static_cast<std::size_t>(i)];
        if (nearest != i && std::find(of_i.begin(), of_i.end(), first + nearest) == of_i.end())
            of_i[3] = first + nearest;
    }
    return graph;
}

/// Returns the slope of share d^2.
template <class T>
RYE_HD T square_slope(const T& share, const T& d) {
    return T(2) * share * d;
}

/// Returns, for each point of a graph, the points that have it as a neighbour, ascending.
inline std::vector<std::vector<Index>> neighbour_of(const NeighbourGraph& graph) {
    std::vector<std::vector<Index>> of(graph.size());
    for (std::size_t i = 0; i < graph.size(); ++i)
        for (const Index k : graph[i])
            of[static_cast<std::size_t>(k)].push_back(static_cast<Index>(i));
    return of;
}

} // namespace detail

/// Returns the mean over points and channels of the squared differences to the neighbours, and its
/// gradient. values: C x N, one entry of the graph per column; `of` is neighbour_of(graph). Each
/// point's gradient is summed in a fixed order.
template <class T, Threads P>
LossGradient<T> smoothness(const P& threads, const Columns<T>& values,
                           const detail::NeighbourGraph& graph,
                           const std::vector<std::vector<Index>>& of) {
    require(static_cast<Index>(graph.size()) == values.cols(), "smoothness", "the graph has ",
            graph.size(), " points, the values ", values.cols());
    const T share = T(1) / T(static_cast<real_t<T>>(std::max<Index>(values.size(), 1)));
    LossGradient<T> l;
    const Index channels = values.rows();
    l.gradient.resize(channels, values.cols());
    l.value = sum_chunks(threads, values.cols(), 256, T(0), [&](Index begin, Index end) {
        T sum(0);
        for (Index i = begin; i < end; ++i) {
            const T* const here = values.data() + i * channels;
            T* const g = l.gradient.data() + i * channels;
            std::fill_n(g, channels, T(0));
            const auto& from = of[static_cast<std::size_t>(i)];
            const auto pull = [&](auto first, auto last) {
                for (; first != last; ++first) {
                    const T* const there = values.data() + *first * channels;
                    for (Index c = 0; c < channels; ++c)
                        g[c] -= detail::square_slope(share, T(there[c] - here[c]));
                }
            };
            const auto own = std::lower_bound(from.begin(), from.end(), i);
            pull(from.begin(), own);
            for (const Index k : graph[static_cast<std::size_t>(i)]) {
                const T* const there = values.data() + k * channels;
                T squares(0);
                for (Index c = 0; c < channels; ++c) {
                    const T d = here[c] - there[c];
                    squares += d * d;
                    g[c] += detail::square_slope(share, d);
                }
                sum += share * squares;
            }
            pull(own, from.end());
        }
        return sum;
    });
    return l;
}
/// The same on the calling thread.
template <class T>
LossGradient<T> smoothness(const Columns<T>& values, const detail::NeighbourGraph& graph) {
    return smoothness(Serial{}, values, graph, detail::neighbour_of(graph));
}

} // namespace rye
