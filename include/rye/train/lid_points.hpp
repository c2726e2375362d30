// SPDX-License-Identifier: Apache-2.0
/// rye/train/lid_points.hpp: Gaussians of a face that a blink moves apart, and where they are to be
/// (fit_lids.hpp): how far from their neighbours, and before the eyeballs.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

#include <rye/avatar/two_stream.hpp>
#include <rye/train/face_smoothness.hpp>

namespace rye::detail {

/// Eyeballs at rest, head frame, canonical units.
template <class T>
struct LidEyeballs {
    Columns<T> centre; ///< 3 x 2
    std::array<T, 2> radius;
};
/// Returns the eyeballs of a stream; their radius is the mean of their Gaussians' distances.
template <class T, EffectSet E>
LidEyeballs<T> lid_eyeballs(const EyeStream<T, E>& eyes) {
    LidEyeballs<T> balls{eyes.centre, {}};
    for (Index e = 0; e < 2; ++e) {
        const Columns<T> points =
            eyes.position.middleCols(eyes.first_point(e), eyes.points_of(e));
        balls.radius[static_cast<std::size_t>(e)] = points.colwise().norm().mean();
    }
    return balls;
}
/// Moves points that are inside an eyeball, and were before it with open lids, out to `clear` radii
/// before it. Columns of `open` are the same points.
template <class T>
void move_out_of_eyeballs(const LidEyeballs<T>& eyes, double clear, const Columns<T>& open,
                          Columns<T>& points) {
    for (Index i = 0; i < points.cols(); ++i)
        for (Index e = 0; e < 2; ++e) {
            const Vec3<T> centre = eyes.centre.col(e), out = points.col(i) - centre;
            const T radius = eyes.radius[static_cast<std::size_t>(e)],
                    least = T(1 + clear) * radius, far = out.norm();
            // Beyond the middle a point is no lid's.
            if (far < least && far > T(0.5) * radius && (open.col(i) - centre).norm() >= radius)
                points.col(i) = centre + least / far * out;
        }
}

/// Least growth by a whole blink, and least influence, of a point that is fitted.
inline constexpr double least_growth = 1.1, least_influence = 0.5;

/// Returns how far apart points are in one frame relative to another: for each point the mean of
/// the squared distances to its neighbours, at least 1 and at most `most`. near: columns of the
/// four neighbours of the first points.
template <class T>
std::vector<double> growth_of(const Columns<T>& apart, const Columns<T>& before,
                              const NeighbourGraph& near, double most) {
    std::vector<double> growth(near.size());
    for (std::size_t k = 0; k < near.size(); ++k) {
        double now = 0, then = 0;
        for (const Index j : near[k]) {
            const auto i = static_cast<Index>(k);
            now += static_cast<double>((apart.col(j) - apart.col(i)).squaredNorm());
            then += static_cast<double>((before.col(j) - before.col(i)).squaredNorm());
        }
        growth[k] = then > 0 ? std::clamp(now / then, 1.0, most) : 1.0;
    }
    return growth;
}

/// Gaussians that a whole blink moves apart, and others that the expression moves.
struct LidPoints {
    std::vector<Index> lids, others;
    std::vector<Index> around; ///< the lids, then their neighbours that are not among them
    NeighbourGraph near;       ///< places in `around` of the neighbours of each lid

    template <class T>
    LidPoints(const std::vector<Index>& moved, const Columns<T>& influence,
              const std::vector<double>& growth, const NeighbourGraph& graph) {
        for (const Index i : moved) {
            const bool lid = growth[static_cast<std::size_t>(i)] > least_growth &&
                             influence(0, i) >= T(least_influence);
            (lid ? lids : others).push_back(i);
        }
        around = lids;
        std::vector<Index> place(graph.size(), -1);
        for (std::size_t k = 0; k < lids.size(); ++k)
            place[static_cast<std::size_t>(lids[k])] = static_cast<Index>(k);
        for (const Index i : lids) {
            std::array<Index, 4> neighbours = graph[static_cast<std::size_t>(i)];
            for (Index& j : neighbours) {
                Index& at = place[static_cast<std::size_t>(j)];
                if (at < 0) {
                    at = static_cast<Index>(around.size());
                    around.push_back(j);
                }
                j = at;
            }
            near.push_back(neighbours);
        }
    }
};

/// Returns `count` of `all` places, evenly spread from a start within [0, 1); all if there are
/// fewer.
inline std::vector<Index> spread(Index all, Index count, double start) {
    std::vector<Index> chosen;
    for (Index k = 0; k < std::min(all, count); ++k)
        chosen.push_back(all <= count ? k
                                      : std::min(all - 1, static_cast<Index>(
                                                              (static_cast<double>(k) + start) *
                                                              static_cast<double>(all) /
                                                              static_cast<double>(count))));
    return chosen;
}

} // namespace rye::detail
