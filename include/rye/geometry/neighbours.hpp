// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/neighbours.hpp: nearest neighbours within a point cloud, by a uniform grid. Used
/// for the initial scales of Gaussians and for the smoothness of the face. Source: 3DGS,
/// initialisation.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include <rye/backend/backend.hpp>
#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>
#include <rye/core/error.hpp>

namespace rye {

namespace detail {

/// Points of a cloud by cells of a uniform grid. Keeps a reference to the points, 3 x N, N > 0.
template <Real T>
class PointGrid {
  public:
    explicit PointGrid(const Columns<T>& points) : points_(points) {
        const Index n = points.cols();
        RYE_ASSERT(n > 0, "PointGrid: no points");
        lo_ = points.rowwise().minCoeff();
        const Vec3<T> hi = points.rowwise().maxCoeff();
        // About two points per cell for points on a surface: cells along a side ~ sqrt(n / 2).
        const T extent = std::max((hi - lo_).maxCoeff(), std::numeric_limits<T>::min());
        cells_ = std::clamp<Index>(static_cast<Index>(std::sqrt(double(n) / 2.0)), 1, 128);
        edge_ = extent / static_cast<T>(cells_) * T(1.0001);
        begin_.assign(static_cast<std::size_t>(cells_ * cells_ * cells_) + 1, 0);
        for (Index i = 0; i < n; ++i) ++begin_[flat(cell_of(points.col(i))) + 1];
        for (std::size_t c = 1; c < begin_.size(); ++c) begin_[c] += begin_[c - 1];
        std::vector<Index> next(begin_.begin(), begin_.end() - 1);
        order_.resize(static_cast<std::size_t>(n));
        for (Index i = 0; i < n; ++i)
            order_[static_cast<std::size_t>(next[flat(cell_of(points.col(i)))]++)] = i;
    }

    /// Calls found(point, squared distance from x) for points around x, until every one whose
    /// squared distance is at most bound() has been found.
    template <class Found, class Bound>
    void around(const Vec3<T>& x, Found&& found, Bound&& bound) const {
        const Cell home = cell_of(x);
        // Rings of cells outwards until the next ring cannot hold such a point.
        for (Index ring = 0; ring < cells_; ++ring) {
            Cell c{};
            for (c[2] = std::max<Index>(0, home[2] - ring);
                 c[2] <= std::min(cells_ - 1, home[2] + ring); ++c[2])
                for (c[1] = std::max<Index>(0, home[1] - ring);
                     c[1] <= std::min(cells_ - 1, home[1] + ring); ++c[1]) {
                    const bool side =
                        std::abs(c[2] - home[2]) == ring || std::abs(c[1] - home[1]) == ring;
                    const Index step = side || ring == 0 ? 1 : 2 * ring;
                    for (c[0] = home[0] - ring; c[0] <= home[0] + ring; c[0] += step) {
                        if (c[0] < 0 || c[0] >= cells_) continue;
                        for (Index k = begin_[flat(c)]; k < begin_[flat(c) + 1]; ++k) {
                            const Index i = order_[static_cast<std::size_t>(k)];
                            const Vec3<T> d = points_.col(i) - x;
                            found(i, T(d.squaredNorm()));
                        }
                    }
                }
            const T reached = static_cast<T>(ring) * edge_; // all nearer points are found
            if (bound() < reached * reached) break;
        }
    }

    /// Returns the K nearest points to x, ties by lower index, without the point `except`. There
    /// are at least K such points.
    template <std::size_t K>
    std::array<Index, K> nearest(const Vec3<T>& x, Index except = -1) const {
        std::array<std::pair<T, Index>, K> best;
        best.fill({std::numeric_limits<T>::infinity(), points_.cols()});
        around(
            x,
            [&](Index i, const T& d2) {
                const std::pair<T, Index> found{d2, i};
                if (i == except || !(found < best.back())) return;
                best.back() = found;
                for (std::size_t s = K - 1; s > 0 && best[s] < best[s - 1]; --s)
                    std::swap(best[s], best[s - 1]);
            },
            [&] { return best.back().first; });
        std::array<Index, K> of{};
        for (std::size_t k = 0; k < K; ++k) of[k] = best[k].second;
        return of;
    }

  private:
    using Cell = std::array<Index, 3>;

    Cell cell_of(const Vec3<T>& x) const {
        Cell c{};
        for (int a = 0; a < 3; ++a)
            c[static_cast<std::size_t>(a)] =
                std::clamp<Index>(static_cast<Index>((x(a) - lo_(a)) / edge_), 0, cells_ - 1);
        return c;
    }
    std::size_t flat(const Cell& c) const {
        return static_cast<std::size_t>((c[2] * cells_ + c[1]) * cells_ + c[0]);
    }

    const Columns<T>& points_;
    Vec3<T> lo_;         ///< least coordinates
    T edge_;             ///< of a cell
    Index cells_;        ///< along each side
    std::vector<Index> begin_, order_; ///< start of each cell's points in `order`, cells^3 + 1
};

} // namespace detail

/// Returns the mean squared distance of each point (3 x N) to its `k` nearest others, 1 x N; with
/// fewer than k others, to all of them; 0 for a single point; the largest number if it is beyond
/// the range.
template <Real T, Backend B>
Columns<T> mean_squared_neighbour_distance(const B& backend, const Columns<T>& points, int k = 3) {
    const Index n = points.cols();
    Columns<T> result = Columns<T>::Zero(1, n);
    if (n < 2) return result;
    const detail::PointGrid<T> grid(points);
    const std::size_t wanted = static_cast<std::size_t>(std::min<Index>(k, n - 1));
    for_chunks(backend.threads, n, 1024, [&](Index b, Index e, Index) {
        std::vector<T> best;
        for (Index i = b; i < e; ++i) {
            best.assign(wanted, std::numeric_limits<T>::max());
            grid.around(
                points.col(i),
                [&](Index other, const T& d2) {
                    if (other == i || d2 >= best.back()) return;
                    best.back() = d2;
                    for (std::size_t s = best.size() - 1; s > 0 && best[s] < best[s - 1]; --s)
                        std::swap(best[s], best[s - 1]);
                },
                [&] { return best.back(); });
            T sum = T(0);
            for (const T d2 : best) sum += d2;
            result(0, i) = std::min(sum / static_cast<T>(wanted), std::numeric_limits<T>::max());
        }
    });
    return result;
}

} // namespace rye
