// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/weights.hpp: the influence of each driver on each point of the face, with vjp.
/// lambda_exp falls off with the distance to the nearest landmark, lambda_pose = 1 - lambda_exp,
/// lambda_gaze falls off with the distance to the nearest landmark of each eye.
/// Source: paper eq. (4) and (11).
#pragma once

#include <array>
#include <vector>

#include <rye/avatar/config.hpp>
#include <rye/rig/influence.hpp>
#include <rye/rig/nearest.hpp>

namespace rye {

/// Which landmarks drive what; indices into the columns of the landmark array.
struct LandmarkRoles {
    std::vector<Index> expression;          ///< P_0: all but the eyes'
    std::array<std::vector<Index>, 2> eye;  ///< P_eye, left and right
};

template <class T>
struct Weights {
    Columns<T> exp, pose;             ///< 1 x N each, exp + pose = 1
    std::array<Columns<T>, 2> gaze;   ///< 1 x N, left and right

    Weights() = default;
    explicit Weights(Index n)
        : exp(Columns<T>::Zero(1, n)), pose(exp), gaze{exp, exp} {}
};

/// The nearest landmark of each point, for the three landmark sets.
template <class T>
struct WeightsTrace {
    std::array<Columns<T>, 3> squared;              ///< 1 x N squared distances
    std::array<std::vector<Index>, 3> nearest;      ///< columns of the landmark array
};

namespace detail {

/// Thresholds of landmark set s: expression, left eye, right eye.
template <class T>
Ramp<T> face_ramp(const AvatarConfig& c, std::size_t s) {
    return s == 0 ? Ramp<T>{T(c.exp_near), T(c.exp_far)} : Ramp<T>{T(c.gaze_near), T(c.gaze_far)};
}

} // namespace detail

template <Backend B, class T>
Weights<T> face_weights(const AvatarConfig& config, const Columns<T>& points,
                        const Columns<T>& landmarks, const LandmarkRoles& roles,
                        WeightsTrace<T>& trace) {
    const std::array<const std::vector<Index>*, 3> sets{&roles.expression, &roles.eye[0],
                                                        &roles.eye[1]};
    Weights<T> w(points.cols());
    for (std::size_t s = 0; s < 3; ++s) {
        trace.squared[s] = nearest_squared_distance<B, T>(points, pick_columns(landmarks, *sets[s]),
                                                          &trace.nearest[s]);
        for (Index& k : trace.nearest[s])
            if (k >= 0) k = (*sets[s])[static_cast<std::size_t>(k)];
        Columns<T>& lambda = s == 0 ? w.exp : w.gaze[s - 1];
        std::visit([&](const auto& metric) {
            lambda = influence(metric, detail::face_ramp<T>(config, s), trace.squared[s]);
        }, config.metric);
    }
    w.pose = Columns<T>::Ones(1, points.cols()) - w.exp;
    return w;
}

/// Accumulates the gradients to points and landmarks of a cotangent of the weights (pose included).
template <class T>
void face_weights_vjp(const AvatarConfig& config, const Columns<T>& points,
                      const Columns<T>& landmarks, const WeightsTrace<T>& trace,
                      const Weights<T>& g, Columns<T>& g_points, Columns<T>* g_landmarks) {
    for (std::size_t s = 0; s < 3; ++s) {
        const Ramp<T> ramp = detail::face_ramp<T>(config, s);
        std::visit([&](const auto& metric) {
            for (Index i = 0; i < points.cols(); ++i) {
                const T g_lambda = s == 0 ? T(g.exp(0, i) - g.pose(0, i)) : g.gaze[s - 1](0, i);
                const T slope = metric.slope(ramp, trace.squared[s](0, i));
                if (slope == T(0)) continue;
                const Index k = trace.nearest[s][static_cast<std::size_t>(i)];
                const Vec3<T> d = (T(2) * g_lambda * slope) * (points.col(i) - landmarks.col(k));
                g_points.col(i) += d;
                if (g_landmarks != nullptr) g_landmarks->col(k) -= d;
            }
        }, config.metric);
    }
}

} // namespace rye
