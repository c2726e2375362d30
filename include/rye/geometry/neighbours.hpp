// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/neighbours.hpp: distances to the nearest neighbours within a point cloud, by a
/// uniform grid. Used for the initial scales of Gaussians. Source: 3DGS,
/// initialisation.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include <rye/backend/backend.hpp>
#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>

namespace rye {

/// Returns the mean squared distance of each point (3 x N) to its `k` nearest others, 1 x N; with
/// fewer than k others, to all of them; 0 for a single point; the largest number if it is beyond
/// the range.
template <Real T, Backend B>
Columns<T> mean_squared_neighbour_distance(const B& backend, const Columns<T>& points, int k = 3) {
    const Index n = points.cols();
    Columns<T> result = Columns<T>::Zero(1, n);
    if (n < 2) return result;
    const Vec3<T> lo = points.rowwise().minCoeff(), hi = points.rowwise().maxCoeff();
    // About two points per cell for points on a surface: cells along a side ~ sqrt(n / 2).
    const T extent = std::max((hi - lo).maxCoeff(), std::numeric_limits<T>::min());
    const Index cells = std::clamp<Index>(static_cast<Index>(std::sqrt(double(n) / 2.0)), 1, 128);
    const T edge = extent / static_cast<T>(cells) * T(1.0001);
    const auto cell_of = [&](Index i) {
        std::array<Index, 3> c{};
        for (int a = 0; a < 3; ++a)
            c[static_cast<std::size_t>(a)] = std::clamp<Index>(
                static_cast<Index>((points(a, i) - lo(a)) / edge), 0, cells - 1);
        return c;
    };
    const auto flat = [&](const std::array<Index, 3>& c) {
        return static_cast<std::size_t>((c[2] * cells + c[1]) * cells + c[0]);
    };
    std::vector<Index> begin(static_cast<std::size_t>(cells * cells * cells) + 1, 0);
    for (Index i = 0; i < n; ++i) ++begin[flat(cell_of(i)) + 1];
    for (std::size_t c = 1; c < begin.size(); ++c) begin[c] += begin[c - 1];
    std::vector<Index> order(static_cast<std::size_t>(n)), next(begin.begin(), begin.end() - 1);
    for (Index i = 0; i < n; ++i)
        order[static_cast<std::size_t>(next[flat(cell_of(i))]++)] = i;

    const std::size_t wanted = static_cast<std::size_t>(std::min<Index>(k, n - 1));
    for_chunks(backend.threads, n, 1024, [&](Index b, Index e, Index) {
        std::vector<T> best;
        for (Index i = b; i < e; ++i) {
            const std::array<Index, 3> home = cell_of(i);
            best.assign(wanted, std::numeric_limits<T>::max());
            // Rings of cells outwards until the next ring cannot hold a nearer point.
            for (Index ring = 0; ring < cells; ++ring) {
                std::array<Index, 3> c{};
                for (c[2] = std::max<Index>(0, home[2] - ring);
                     c[2] <= std::min(cells - 1, home[2] + ring); ++c[2])
                    for (c[1] = std::max<Index>(0, home[1] - ring);
                         c[1] <= std::min(cells - 1, home[1] + ring); ++c[1]) {
                        const bool side = std::abs(c[2] - home[2]) == ring ||
                                          std::abs(c[1] - home[1]) == ring;
                        const Index step = side || ring == 0 ? 1 : 2 * ring;
                        for (c[0] = home[0] - ring; c[0] <= home[0] + ring; c[0] += step) {
                            if (c[0] < 0 || c[0] >= cells) continue;
                            for (Index j = begin[flat(c)]; j < begin[flat(c) + 1]; ++j) {
                                const Index other = order[static_cast<std::size_t>(j)];
                                if (other == i) continue;
                                const Vec3<T> d = points.col(other) - points.col(i);
                                const T d2 = d.squaredNorm();
                                if (d2 >= best.back()) continue;
                                best.back() = d2;
                                for (std::size_t s = best.size() - 1;
                                     s > 0 && best[s] < best[s - 1]; --s)
                                    std::swap(best[s], best[s - 1]);
                            }
                        }
                    }
                const T reached = static_cast<T>(ring) * edge;  // all nearer points are visited
                if (best.back() <= reached * reached) break;
            }
            T sum = T(0);
            for (const T d2 : best) sum += d2;
            result(0, i) = std::min(sum / static_cast<T>(wanted), std::numeric_limits<T>::max());
        }
    });
    return result;
}

} // namespace rye
