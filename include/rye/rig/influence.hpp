// SPDX-License-Identifier: Apache-2.0
/// rye/rig/influence.hpp: influence weight of a driver on a point: 1 near its landmarks, 0 far from
/// them, linear in between. Lengths in canonical head units (about 1 dm).
/// The published code of Gaussian Head Avatar compares *squared* distances with its thresholds, its
/// paper plain ones; the metric is therefore a policy. Derivatives at both kinks are 0.
/// Source: Xu et al., "Gaussian Head Avatar", 2024; "Roll Your Eyes", eq. 4 and 11.
#pragma once

#include <algorithm>
#include <cmath>
#include <concepts>
#include <limits>
#include <string>

#include <rye/core/columns.hpp>
#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/math/scalar.hpp>
#include <rye/rig/nearest_landmark.hpp>

namespace rye {

/// Thresholds of an influence. rye's metrics are 1 up to `near` and 0 from `far` on; near == far is
/// a step. Requires finite 0 <= near <= far; see checked_ramp.
template <Scalar T>
struct Ramp {
    T near, far;  ///< thresholds, in the unit of the metric
};

namespace detail {

/// Returns a ramp from external input; throws an Error unless 0 <= near <= far and both are finite.
template <Scalar T>
Ramp<T> checked_ramp(const T& near, const T& far) {
    if constexpr (Real<T>)
        require(near >= T(0) && near <= far && far <= std::numeric_limits<T>::max(), "Ramp",
                "near = ", near, ", far = ", far, " violate 0 <= near <= far, both finite");
    return {near, far};
}

} // namespace detail

/// Metric that compares the thresholds with the squared distance.
struct SquaredDistance {
    /// Returns the weight at a squared distance; 0 for NaN.
    template <Scalar T>
    RYE_HD T value(const Ramp<T>& ramp, const T& squared) const {
        const T width = select(ramp.near < ramp.far, T(ramp.far - ramp.near), T(1));
        const T inside = (ramp.far - squared) / width;
        return select((squared <= ramp.near) && (squared < ramp.far), T(1),
                      select(squared < ramp.far, inside, T(0)));
    }
    /// Returns d value / d squared.
    template <Scalar T>
    RYE_HD T slope(const Ramp<T>& ramp, const T& squared) const {
        const auto inside = (squared > ramp.near) && (squared < ramp.far);
        return select(inside, T(T(-1) / select(inside, T(ramp.far - ramp.near), T(1))), T(0));
    }
};

/// Metric that compares the thresholds with the distance. Takes the root only between them, so a
/// point on its landmark has weight 1 and derivative 0.
struct EuclideanDistance {
    template <Scalar T>
    RYE_HD T value(const Ramp<T>& ramp, const T& squared) const {
        using std::sqrt;
        const T near2 = ramp.near * ramp.near, far2 = ramp.far * ramp.far;
        const auto inside = (squared > near2) && (squared < far2);
        const T root = sqrt(select(inside, squared, T(1)));
        const T raw = (ramp.far - root) / select(inside, T(ramp.far - ramp.near), T(1));
        const T bounded = select(raw < T(0), T(0), select(raw > T(1), T(1), raw));
        return select((squared <= near2) && (squared < far2), T(1),
                      select(inside, bounded, T(0)));
    }
    template <Scalar T>
    RYE_HD T slope(const Ramp<T>& ramp, const T& squared) const {
        using std::sqrt;
        const T near2 = ramp.near * ramp.near, far2 = ramp.far * ramp.far;
        const auto inside = (squared > near2) && (squared < far2);
        const T root = sqrt(select(inside, squared, T(1)));
        return select(inside, T(T(-0.5) / (root * select(inside, T(ramp.far - ramp.near), T(1)))),
                      T(0));
    }
};

/// value(ramp, d^2) is a weight in [0, 1], not increasing in d^2, which need not reach 0 at `far`;
/// slope is its derivative. d is the distance to the nearest landmark [canonical units]; the ramp
/// has exp_near and exp_far, or gaze_near and gaze_far, of AvatarConfig as they are. T is float,
/// double or a dual.
template <class M>
concept InfluenceMetric = std::default_initializable<M> &&
                          requires(const M m, const Ramp<float> r, const float x) {
                              { m.value(r, x) } -> std::same_as<float>;
                              { m.slope(r, x) } -> std::same_as<float>;
                          };
static_assert(InfluenceMetric<SquaredDistance> && InfluenceMetric<EuclideanDistance>);

/// Returns the weight at a squared distance.
template <InfluenceMetric M, Scalar T>
RYE_HD T influence(const M& metric, const Ramp<T>& ramp, const T& squared) {
    return metric.value(ramp, squared);
}

namespace detail {

/// Returns the weight's derivative with respect to the squared distance.
template <InfluenceMetric M, Scalar T>
RYE_HD T influence_slope(const M& metric, const Ramp<T>& ramp, const T& squared) {
    return metric.slope(ramp, squared);
}

/// Returns the cotangent of a point, given that of its influence times the slope there, and the
/// vector to the point from its nearest landmark. The landmark's cotangent is the opposite.
template <Scalar T>
RYE_HD Vec3<T> influence_pull(const T& g_squared, const Vec3<T>& from_landmark) {
    const T twice = T(2) * g_squared;
    return Vec3<T>(twice * from_landmark[0], twice * from_landmark[1], twice * from_landmark[2]);
}

} // namespace detail

/// Returns the weights, 1 x N, at squared distances, 1 x N. lambda_pose is 1 minus the weight.
template <InfluenceMetric M, Scalar T>
Columns<T> influence(const M& metric, const Ramp<T>& ramp, const Columns<T>& squared) {
    Columns<T> w(1, squared.cols());
    for (Index i = 0; i < squared.cols(); ++i) w(0, i) = metric.value(ramp, squared(0, i));
    return w;
}

/// Returns the cotangent of the squared distances, 1 x N.
template <InfluenceMetric M, Scalar T>
Columns<T> influence_vjp(const M& metric, const Ramp<T>& ramp, const Columns<T>& squared,
                         const Columns<T>& g) {
    Columns<T> r(1, squared.cols());
    for (Index i = 0; i < squared.cols(); ++i) {
        const T x = squared(0, i);
        r(0, i) = metric.slope(ramp, x) * g(0, i);
    }
    return r;
}

/// Treatment of two overlapping influences of one kind (left and right gaze): unchanged (the paper;
/// the sum may exceed 1), or scaled down to a sum of at most 1.
enum class Overlap { sum, normalized };

namespace detail {

/// Applies the overlap policy to two weights, 1 x N, in place; returns the largest sum before.
template <Real T>
T resolve_overlap(Overlap policy, Columns<T>& left, Columns<T>& right) {
    T greatest = T(0);
    for (Index i = 0; i < left.cols(); ++i) {
        const T sum = left(0, i) + right(0, i);
        greatest = std::max(greatest, sum);
        if (policy == Overlap::normalized && sum > T(1)) {
            left(0, i) /= sum;
            right(0, i) /= sum;
        }
    }
    return greatest;
}

} // namespace detail

} // namespace rye
