// SPDX-License-Identifier: Apache-2.0
/// rye/rig/cuda/influence.hpp: the influence of a driver on points in device memory, by the
/// distance to the nearest of its landmarks (rig/influence.hpp), and its vjp to the points.
/// Canonical head units. The landmarks are fixed: they have no gradient here.
#pragma once

#include <rye/backend/cuda/each.hpp>
#include <rye/rig/influence.hpp>

namespace rye {

/// Points and the landmarks of a driver, in device memory.
struct DeviceLandmarks {
    const float* points;    ///< 3 x N
    const float* landmarks; ///< 3 x count
    int count;
    Ramp<float> ramp;

    RYE_HD Vec3<float> between(Index i, int k) const {
        return Vec3<float>(points[3 * i] - landmarks[3 * k],
                           points[3 * i + 1] - landmarks[3 * k + 1],
                           points[3 * i + 2] - landmarks[3 * k + 2]);
    }
};

namespace detail {

/// Computes the influence of point i by the metric M, and 1 minus its influence by the metric Rest.
template <class M, class Rest = M>
struct InfluenceOfPoint {
    static constexpr const char* name = "influence";
    DeviceLandmarks of;
    M metric;
    Rest rest_metric;
    float* lambda; ///< 1 x N; may be null
    float* rest;   ///< 1 x N; may be null
    int* nearest;  ///< index of the nearest landmark, -1 for none

    RYE_DEVICE void operator()(Index i) const {
        NearestSoFar<float> best;
        for (int k = 0; k < of.count; ++k) {
            const Vec3<float> d = of.between(i, k);
            best.offer(d[0], d[1], d[2], k);
        }
        if (lambda != nullptr) lambda[i] = metric.value(of.ramp, best.squared);
        if (rest != nullptr) rest[i] = 1.0F - rest_metric.value(of.ramp, best.squared);
        nearest[i] = static_cast<int>(best.which);
    }
};

template <class M, class Rest>
InfluenceOfPoint(DeviceLandmarks, M, Rest, float*, float*, int*) -> InfluenceOfPoint<M, Rest>;

/// Adds the cotangent of point i.
template <class M>
struct InfluencePull {
    static constexpr const char* name = "influence, reverse";
    DeviceLandmarks of;
    M metric;
    const int* nearest;
    const float* g;      ///< cotangent of the influence; may be null
    const float* g_rest; ///< cotangent of 1 minus the influence; may be null
    float* g_points;     ///< 3 x N; accumulated

    RYE_DEVICE void operator()(Index i) const {
        const int k = nearest[i];
        if (k < 0) return;
        const Vec3<float> d = of.between(i, k);
        NearestSoFar<float> own;
        own.offer(d[0], d[1], d[2], k);
        const float slope = metric.slope(of.ramp, own.squared);
        if (slope == 0.0F) return;
        const float cotangent =
            (g != nullptr ? g[i] : 0.0F) - (g_rest != nullptr ? g_rest[i] : 0.0F);
        const Vec3<float> pull = influence_pull<float>(cotangent * slope, d);
        for (int c = 0; c < 3; ++c) g_points[3 * i + c] += pull[c];
    }
};
template <class M>
InfluencePull(DeviceLandmarks, M, const int*, const float*, const float*, float*)
    -> InfluencePull<M>;

} // namespace detail

} // namespace rye
