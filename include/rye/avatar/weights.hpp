// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/weights.hpp: the influence of each driver on each point of the face, with vjp.
/// lambda_exp falls off with the distance to the nearest landmark, lambda_pose = 1 - lambda_exp
/// (unless it has a metric of its own, rig/parts.hpp),
/// lambda_gaze falls off with the distance to the nearest landmark of each eye.
/// Source: paper eq. (4) and (11).
#pragma once

#include <array>
#include <vector>

#include <rye/avatar/drivers.hpp>
#include <rye/avatar/face_fields.hpp>
#include <rye/avatar/head_pose.hpp>
#include <rye/rig/influence.hpp>
#include <rye/rig/nearest_landmark.hpp>

namespace rye {

/// Landmarks by what they drive, as columns of the landmark array.
struct LandmarkRoles {
    std::vector<Index> expression;          ///< P_0: all but the eyes'
    std::array<std::vector<Index>, 2> eye;  ///< P_eye, left and right
};

/// A frame, and what is the same in every one.
template <class T, EffectSet E = PaperEffects>
struct AvatarFrame {
    const AvatarConfig& config;
    const LandmarkRoles& roles;
    const Drivers<T, E>& drivers;
    SeenBy<T> view = {}; ///< of a picture of a training
};

/// Influences of the drivers on N points of the face, in 0..1.
template <class T, EffectSet E = PaperEffects>
struct Weights {
    [[no_unique_address]] detail::Slot<E, ReadsFaceRamp, Columns<T>> exp; ///< 1 x N
    [[no_unique_address]] detail::Slot<E, ReadsFaceRamp, Columns<T>, 1>
        pose;                                                      ///< 1 x N, exp + pose = 1
    [[no_unique_address]] detail::SkinSlot<E, Columns<T>, 2> gaze; ///< 1 x N, left and right

    Weights() = default;
    explicit Weights(Index n) {
        const Columns<T> zero = Columns<T>::Zero(1, n);
        if constexpr (has_effect<E, ReadsFaceRamp>) exp = pose = zero;
        for_eyes([&]<std::size_t eye>() {
            if constexpr (detail::skin_follows<E, eye>) of_eye<eye>(gaze) = zero;
        });
    }
};

/// The nearest landmark of each point.
template <class T>
struct NearestTrace {
    Columns<T> squared;          ///< 1 x N squared distances
    std::vector<Index> nearest;  ///< columns of the landmark array
};

/// ... for each of the landmark sets that are needed.
template <class T, EffectSet E = PaperEffects>
struct WeightsTrace {
    [[no_unique_address]] detail::Slot<E, ReadsFaceRamp, NearestTrace<T>, 2> exp;
    [[no_unique_address]] detail::SkinSlot<E, NearestTrace<T>, 3> gaze; ///< left, right
};

/// Points whose influences are computed.
template <class T>
struct InfluenceInput {
    const AvatarConfig& config;
    const Columns<T>& points;    ///< 3 x N
    const Columns<T>& landmarks; ///< 3 x L
};

namespace detail {

/// Their gradients, accumulated; the landmarks' may be null.
template <class T>
struct InfluenceGradients {
    Columns<T>& points;
    Columns<T>* landmarks;
};

/// Points, and the distances to landmarks between which influence falls off.
template <class T>
struct LandmarkRamp {
    const InfluenceInput<T>& in;
    double near, far;
};

/// f with the metric M, or with the one that the configuration names.
template <class M, class F>
decltype(auto) with_metric(const AvatarConfig& config, F&& f) {
    if constexpr (std::same_as<M, ConfiguredMetric>)
        return std::visit(f, config.metric);
    else
        return f(M{});
}

/// The influence of one set of landmarks.
template <class M = ConfiguredMetric, class T, Backend B>
Columns<T> set_weights(const B& backend, const std::type_identity_t<LandmarkRamp<T>>& of,
                       const std::vector<Index>& set, NearestTrace<T>& trace) {
    trace.squared = nearest_squared_distance<T>(backend, of.in.points,
                                                pick_columns(of.in.landmarks, set), &trace.nearest);
    Columns<T> lambda(1, trace.squared.cols());
    with_metric<M>(of.in.config, [&](const auto& metric) {
        const Ramp<T> ramp = checked_ramp(T(of.near), T(of.far));
        for_chunks(backend.threads, lambda.cols(), 512, [&](Index b, Index e, Index) {
            for (Index i = b; i < e; ++i) {
                Index& k = trace.nearest[static_cast<std::size_t>(i)];
                if (k >= 0) k = set[static_cast<std::size_t>(k)];
                lambda(0, i) = influence(metric, ramp, trace.squared(0, i));
            }
        });
    });
    return lambda;
}

/// `g` is the cotangent of one set's influence at a point.
template <class M = ConfiguredMetric, class T, class G, Backend B>
void set_weights_vjp(const B& backend, const std::type_identity_t<LandmarkRamp<T>>& of,
                     const NearestTrace<T>& trace, const G& g,
                     const InfluenceGradients<T>& gradients) {
    const Columns<T>&points = of.in.points, &landmarks = of.in.landmarks;
    Columns<T>& g_points = gradients.points;
    Columns<T>* const g_landmarks = gradients.landmarks;
    const Ramp<T> ramp = checked_ramp(T(of.near), T(of.far));
    with_metric<M>(of.in.config, [&](const auto& metric) {
        const auto range = [&](Index begin, Index end, Index) {
            for (Index i = begin; i < end; ++i) {
                const T g_lambda = g(i);
                const T slope = metric.slope(ramp, trace.squared(0, i));
                if (slope == T(0)) continue;
                const Index k = trace.nearest[static_cast<std::size_t>(i)];
                const Vec3<T> d =
                    influence_pull<T>(g_lambda * slope, points.col(i) - landmarks.col(k));
                g_points.col(i) += d;
                if (g_landmarks != nullptr) g_landmarks->col(k) -= d;
            }
        };
        if (g_landmarks != nullptr) // many points share one
            range(0, points.cols(), 0);
        else
            for_chunks(backend.threads, points.cols(), 512, range);
    });
}

/// True if lambda_pose is 1 - lambda_exp.
template <EffectSet E>
inline constexpr bool one_face_metric =
    std::same_as<PoseInfluenceOf<E>, ExpressionInfluenceOf<E>>;

} // namespace detail

/// Influences by distance to the landmarks of each role; the trace is for the vjp.
template <class T, EffectSet E, Backend B>
Weights<T, E> face_weights(const B& backend, const std::type_identity_t<InfluenceInput<T>>& in,
                           const LandmarkRoles& roles, WeightsTrace<T, E>& trace) {
    [[maybe_unused]] const AvatarConfig& config = in.config;
    Weights<T, E> w;
    if constexpr (has_effect<E, ReadsFaceRamp>) {
        w.exp = detail::set_weights<detail::ExpressionInfluenceOf<E>>(
            backend, {in, config.exp_near, config.exp_far}, roles.expression, trace.exp);
        if constexpr (detail::one_face_metric<E>)
            w.pose = Columns<T>::Ones(1, in.points.cols()) - w.exp;
        else
            w.pose =
                Columns<T>::Ones(1, in.points.cols()) -
                detail::with_metric<detail::PoseInfluenceOf<E>>(config, [&](const auto& metric) {
                    return influence(metric,
                                     detail::checked_ramp(T(config.exp_near), T(config.exp_far)),
                                     trace.exp.squared);
                });
    }
    for_eyes([&]<std::size_t eye>() {
        if constexpr (detail::skin_follows<E, eye>)
            of_eye<eye>(w.gaze) = detail::set_weights<detail::GazeInfluenceOf<E>>(
                backend, {in, config.gaze_near, config.gaze_far}, roles.eye[eye],
                of_eye<eye>(trace.gaze));
    });
    return w;
}

/// Accumulates the gradients to points and landmarks of a cotangent of the weights (pose included).
template <class T, EffectSet E, Backend B>
void face_weights_vjp(const B& backend, const std::type_identity_t<InfluenceInput<T>>& in,
                      const WeightsTrace<T, E>& trace, const Weights<T, E>& g,
                      const std::type_identity_t<detail::InfluenceGradients<T>>& gradients) {
    [[maybe_unused]] const AvatarConfig& config = in.config;
    if constexpr (has_effect<E, ReadsFaceRamp> && detail::one_face_metric<E>)
        detail::set_weights_vjp<detail::ExpressionInfluenceOf<E>>(
            backend, {in, config.exp_near, config.exp_far}, trace.exp,
            [&](Index i) { return T(g.exp(0, i) - g.pose(0, i)); }, gradients);
    if constexpr (has_effect<E, ReadsFaceRamp> && !detail::one_face_metric<E>) {
        detail::set_weights_vjp<detail::ExpressionInfluenceOf<E>>(
            backend, {in, config.exp_near, config.exp_far}, trace.exp,
            [&](Index i) { return T(g.exp(0, i)); }, gradients);
        detail::set_weights_vjp<detail::PoseInfluenceOf<E>>(
            backend, {in, config.exp_near, config.exp_far}, trace.exp,
            [&](Index i) { return T(-g.pose(0, i)); }, gradients);
    }
    for_eyes([&]<std::size_t eye>() {
        if constexpr (detail::skin_follows<E, eye>)
            detail::set_weights_vjp<detail::GazeInfluenceOf<E>>(
                backend, {in, config.gaze_near, config.gaze_far}, of_eye<eye>(trace.gaze),
                [&](Index i) { return T(of_eye<eye>(g.gaze)(0, i)); }, gradients);
    });
}

} // namespace rye
