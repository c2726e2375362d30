// SPDX-License-Identifier: Apache-2.0
/// rye/rig/nearest_landmark.hpp: squared distance from each point to its nearest landmark, with
/// gradients of both. Differences of coordinates are squared, so a point on its landmark has
/// distance exactly 0. A finite point always has a nearest landmark: squares beyond the range of T
/// become the largest finite number.
#pragma once

#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include <rye/backend/backend.hpp>
#include <rye/core/columns.hpp>
#include <rye/core/error.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

namespace detail {

/// Nearest of the landmarks offered so far; the first one of a tie.
template <class T>
struct NearestSoFar {
    T squared = constant<T>(Limits<double>::infinity); ///< squared distance
    Index which = -1;                                  ///< index, -1 for none

    /// Considers landmark k, given the differences of its coordinates from the point's.
    RYE_HD void offer(const T& a, const T& b, const T& c, Index k) {
        const T d = a * a + b * b + c * c;
        if (d < squared) {
            squared = d;
            which = k;
        }
    }
};

/// Returns the nearest of `count` landmarks, at(k), to a point whose squared distances are all
/// beyond the range of T, by comparing squares in a unit that keeps those of all finite points in
/// range. Returns none if the point is not finite.
template <class T, class At>
NearestSoFar<T> nearest_beyond_range(const Vec3<T>& point, const At& at, Index count) {
    constexpr double unit = sizeof(real_t<T>) == 4 ? 0x1p-66 : 0x1p-514;
    const T u = constant<T>(unit);
    NearestSoFar<T> best;
    for (Index k = 0; k < count; ++k) {
        const Vec3<T> p = at(k);
        best.offer(point[0] * u - p[0] * u, point[1] * u - p[1] * u, point[2] * u - p[2] * u, k);
    }
    if (best.which >= 0) best.squared = T(Limits<real_t<T>>::largest);
    return best;
}

/// Destination of distances and, unless null, of indices, one per point.
template <class T>
struct NearestResult {
    T* squared;
    Index* nearest;
};

/// Finds the nearest landmarks with points in lanes and landmarks broadcast; two vectors of points
/// share each broadcast landmark.
template <class Batch, class T>
void nearest_in_lanes(const ColumnsView<T>& points, const ColumnsView<T>& landmarks, Index begin,
                      Index end, const NearestResult<T>& out) {
    constexpr Index lanes = static_cast<Index>(Batch::size), block = 2 * lanes;
    std::array<T, static_cast<std::size_t>(block)> x{}, y{}, z{};
    for (Index at = begin; at < end; at += block) {
        const Index count = std::min(block, end - at);
        for (Index i = 0; i < count; ++i) {
            const auto k = static_cast<std::size_t>(i);
            x[k] = points(0, at + i), y[k] = points(1, at + i), z[k] = points(2, at + i);
        }
        const Batch x0 = Batch::load_unaligned(x.data());
        const Batch y0 = Batch::load_unaligned(y.data());
        const Batch z0 = Batch::load_unaligned(z.data());
        const Batch x1 = Batch::load_unaligned(x.data() + lanes);
        const Batch y1 = Batch::load_unaligned(y.data() + lanes);
        const Batch z1 = Batch::load_unaligned(z.data() + lanes);
        Batch best0(std::numeric_limits<T>::infinity()), best1 = best0;
        Batch index0(T(-1)), index1 = index0;  // integers below 2^24 are exact in float
        for (Index k = 0; k < landmarks.cols(); ++k) {
            const Batch px(landmarks(0, k)), py(landmarks(1, k)), pz(landmarks(2, k));
            const Batch which(static_cast<T>(k));
            const Batch a0 = x0 - px, b0 = y0 - py, c0 = z0 - pz;
            const Batch a1 = x1 - px, b1 = y1 - py, c1 = z1 - pz;
            const Batch d0 = a0 * a0 + b0 * b0 + c0 * c0, d1 = a1 * a1 + b1 * b1 + c1 * c1;
            const auto closer0 = d0 < best0, closer1 = d1 < best1;
            best0 = select(closer0, d0, best0), best1 = select(closer1, d1, best1);
            index0 = select(closer0, which, index0), index1 = select(closer1, which, index1);
        }
        std::array<T, static_cast<std::size_t>(block)> best, index;
        best0.store_unaligned(best.data()), best1.store_unaligned(best.data() + lanes);
        index0.store_unaligned(index.data()), index1.store_unaligned(index.data() + lanes);
        for (Index i = 0; i < count; ++i) {
            const auto k = static_cast<std::size_t>(i);
            NearestSoFar<T> found{best[k], static_cast<Index>(index[k])};
            if (found.which < 0)
                found = nearest_beyond_range<T>(
                    points.col(at + i), [&](Index l) { return Vec3<T>(landmarks.col(l)); },
                    landmarks.cols());
            out.squared[at + i] = found.squared;
            if (out.nearest) out.nearest[at + i] = found.which;
        }
    }
}

} // namespace detail

/// Returns the nearest of these landmarks, 3 x K, to a point; the lowest index wins a tie. Its
/// index is -1 if K = 0 or the point is not finite.
template <class T>
detail::NearestSoFar<T> nearest_landmark(const Vec3<T>& point, const ColumnsView<T>& landmarks) {
    detail::NearestSoFar<T> best;
    for (Index k = 0; k < landmarks.cols(); ++k)
        best.offer(point[0] - landmarks(0, k), point[1] - landmarks(1, k),
                   point[2] - landmarks(2, k), k);
    if (best.which < 0)
        best = detail::nearest_beyond_range<T>(
            point, [&](Index k) { return Vec3<T>(landmarks.col(k)); }, landmarks.cols());
    return best;
}

/// Returns the 1 x N squared distances of 3 x N points to the nearest of 3 x K landmarks, +inf if K
/// = 0 or the point is not finite. `nearest`, unless null, receives the landmark's index, -1 for
/// none; the lowest index wins a tie. Throws an Error if a landmark is not finite.
template <class T, Backend B>
Columns<T> nearest_squared_distance(const B& backend, const ColumnsView<T>& points,
                                    const ColumnsView<T>& landmarks,
                                    std::vector<Index>* nearest = nullptr) {
    using std::isfinite;
    RYE_ASSERT(points.rows() == 3 && landmarks.rows() == 3, "nearest: not three rows");
    for (Index k = 0; k < landmarks.cols(); ++k)
        require(isfinite(landmarks(0, k)) && isfinite(landmarks(1, k)) && isfinite(landmarks(2, k)),
                "nearest_squared_distance", "landmark ", k, " is not finite");
    const Index n = points.cols();
    Columns<T> squared(1, n);
    if (nearest) nearest->assign(static_cast<std::size_t>(n), -1);
    Index* const indices = nearest ? nearest->data() : nullptr;
    for_chunks(backend.threads, n, 512, [&](Index begin, Index end, Index) {
        if constexpr (LaneBackend<B, T>) {
            using Batch = typename B::template batch<T>;
            detail::nearest_in_lanes<Batch, T>(points, landmarks, begin, end,
                                                {squared.data(), indices});
        } else {
            for (Index i = begin; i < end; ++i) {
                const detail::NearestSoFar<T> best = nearest_landmark<T>(points.col(i), landmarks);
                if (indices) indices[i] = best.which;
                squared(0, i) = best.squared;
            }
        }
    });
    return squared;
}

/// Gradients with respect to the points and the landmarks.
template <class T>
struct NearestGradient {
    Columns<T> points;     ///< 3 x N
    Columns<T> landmarks;  ///< 3 x K
};

namespace detail {

/// Returns the cotangents of the points and the landmarks, with the nearest landmarks held fixed.
template <class T, Backend B>
NearestGradient<T> nearest_squared_distance_vjp(const B& backend, const ColumnsView<T>& points,
                                                const ColumnsView<T>& landmarks,
                                                const std::vector<Index>& nearest,
                                                const ColumnsView<T>& g) {
    RYE_ASSERT(static_cast<Index>(nearest.size()) == points.cols() && g.cols() == points.cols(),
               "nearest: indices or cotangents do not match the points");
    NearestGradient<T> r;
    r.points = Columns<T>::Zero(3, points.cols());
    r.landmarks =
        sum_chunks(backend.threads, points.cols(), 8192,
                   Columns<T>(Columns<T>::Zero(3, landmarks.cols())), [&](Index begin, Index end) {
                       Columns<T> part = Columns<T>::Zero(3, landmarks.cols());
                       for (Index i = begin; i < end; ++i) {
                           const Index k = nearest[static_cast<std::size_t>(i)];
                           if (k < 0) continue;
                           for (int j = 0; j < 3; ++j) {
                               const T d = (points(j, i) - landmarks(j, k)) * (T(2) * g(0, i));
                               r.points(j, i) = d;
                               part(j, k) -= d;
                           }
                       }
                       return part;
                   });
    return r;
}

} // namespace detail

} // namespace rye
