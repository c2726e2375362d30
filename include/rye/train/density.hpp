// SPDX-License-Identifier: Apache-2.0
/// rye/train/density.hpp: density control of the face: more Gaussians where the pictures have
/// detail that it does not show, fewer where they show nothing. Between two steps some split, some
/// are removed. Head frame, canonical units.
/// The criterion is the root mean square of the gradient of the neutral position, times a factor
/// near eyes and lips. Adam keeps that mean as its second moment, over about 1 / (1 - beta2) steps,
/// so that a step computes and stores nothing for it; the correction of its bias is one factor for
/// all Gaussians, which does not change their order. 3DGS compares the mean of the gradient's norm
/// on the screen, over the views that show a Gaussian, with a threshold. Here
///   - lengths are measured on the head, not pixels: a near camera does not count more;
///   - steps that do not show a Gaussian count as 0: parts that few cameras see are refined later;
///   - squares make a few views with a large gradient count more than many with a small one;
///   - the gradient includes the part through the position's code, which drives the face;
///   - the order decides, not a threshold: the share that splits is a setting.
/// Nothing is random, Gaussians keep their order, and bits do not depend on the number of threads.
/// Source: Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering", 2023,
/// section 5; opacities of halves as in Rota Bulo et al., "Revising Densification in Gaussian
/// Splatting", 2024, section 3.3, for halves that are smaller than the whole.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include <rye/avatar/two_stream.hpp>
#include <rye/core/format.hpp>
#include <rye/math/rotation.hpp>
#include <rye/nn/adam.hpp>
#include <rye/rig/influence.hpp>
#include <rye/train/lid_line.hpp>
#include <rye/train/settings.hpp>

namespace rye {

/// Returns the first step after `step` that a change follows; the greatest Index if there is none.
inline Index next_density_step(const DensityConfig& c, Index step) {
    constexpr Index none = std::numeric_limits<Index>::max();
    if (c.every <= 0) return none;
    const Index from = std::max<Index>({step + 1, c.first, 1});
    const Index next = (from + c.every - 1) / c.every * c.every;
    return next <= c.last ? next : none;
}
/// Returns true if a change follows step number `step` of `total`; false for the last step.
inline bool density_due(const DensityConfig& c, Index step, Index total) {
    return step < total && step == next_density_step(c, step - 1);
}
/// Returns an upper bound on the final number of Gaussians of a face that has n after `step` of
/// `total` steps.
inline double most_of_face(const DensityConfig& c, double n, Index step, Index total) {
    const Index next = next_density_step(c, step);
    const Index last = std::min<Index>(c.last, total - 1);
    if (next > last) return n;
    const double changes = static_cast<double>((last - next) / c.every + 1);
    return std::max(n, std::min(static_cast<double>(c.most), n * std::pow(1 + c.grow, changes)));
}

namespace detail {

/// Halves of a Gaussian that splits along one of its axes, in multiples of its standard deviation s
/// there: each has deviation s / shrink, lies at +-distance s, and has kappa times its optical
/// depth -log(1 - opacity). With kappa = shrink / 2 both absorb as much as the whole if the axis
/// lies across the view, as do those that split_axis finds: moving a Gaussian along a view changes
/// no picture. (For shrink 1, two copies in one place, this is the opacity 1 - sqrt(1 - a) of the
/// source.) Pictures of the two differ from the whole's by 11 % (rms) for small a, by 17 % at 0.9;
/// with the opacity of copies it would be 34 % and 15 %. 3DGS has this shrink for all three axes.
struct SplitGaussian {
    static constexpr double shrink = 1.6, distance = 0.6, kappa = shrink / 2;

    /// Returns the logit of a half's opacity, given the logit of the whole's.
    template <Real T>
    static T logit_opacity(const T& whole) {
        const T depth = T(kappa) * softplus(whole);
        return T(std::log(-std::expm1(-depth)) + depth);
    }
    /// Factors of the mean of gradients and of their mean squares. Moving both halves moves the
    /// whole, so their gradients add up to its gradient, and each is assumed to have half of it.
    /// The optimiser's next step is then as long as the whole's would have been; without means it
    /// would be three times the learning rate, since all Gaussians share a count of steps.
    static constexpr double mean = 0.5, square = 0.25;
};

} // namespace detail

/// Counts of a change.
struct DensityChange {
    Index grown = 0;  ///< Gaussians split, each into two
    Index pruned = 0; ///< Gaussians removed
    Index face = 0;   ///< Gaussians of the face after the change
};

namespace detail {

/// Calls f(name, array...) for all arrays that have a column for each Gaussian of a face, of
/// avatars of one kind (parameters, moments). Those of shading and of colours by the
/// view are empty where they are off.
template <EffectSet E, class F, class... A>
void for_face_columns(F&& f, A&&... avatar) {
    f("face.xyz", avatar.face.position...);
    f("face.feature", avatar.face.feature...);
    f("face.scales", avatar.face.log_scale...);
    f("face.rotation", avatar.face.rotation...);
    f("face.opacity", avatar.face.opacity_logit...);
    if constexpr (has_effect<E, HeadShading>) f("shading.normal", avatar.shading.normal...);
    if constexpr (has_effect<E, ViewColor>) f("view_color.face", avatar.view_color.face...);
}

/// Throws an Error for a number that is not finite, or a mean square below 0.
template <EffectSet E, class Avatar>
void require_splittable(const Avatar& avatar, const Adam<Avatar>& adam) {
    for_face_columns<E>(
        [&](const char* name, const auto& p, const auto& m, const auto& v) {
            RYE_ASSERT(p.size() == m.size() && p.size() == v.size(),
                       "change_density: parameter and moments differ in shape");
            const auto check = [&](const std::string& of, const auto& a, bool square) {
                Index i = 0;
                while (i < a.size() && std::isfinite(a(i)) && !(square && a(i) < 0)) ++i;
                if (i == a.size()) return; // building the message costs more than the check
                throw Error("change_density: " + of + "'" + name + "' of Gaussian " +
                            std::to_string(i / a.rows()) + " is " + number_text(a(i)) +
                            ", expected a finite number" + (square ? ", 0 or more" : ""));
            };
            check("", p, false);
            check("the mean gradient of ", m, false);
            check("the mean square gradient of ", v, true);
        },
        avatar, adam.m, adam.v);
}

} // namespace detail

/// Returns the square of the criterion for each of N Gaussians, from the mean squares of their
/// positions' gradients, 3 x N. landmarks: those that the settings prefer, 3 x K, K > 0.
template <Real T, Backend B>
std::vector<double> density_criterion(const B& backend, const Columns<T>& position,
                                      const Columns<T>& square, const Columns<T>& landmarks,
                                      const DensityConfig& config) {
    const Columns<T> distance = nearest_squared_distance<T>(backend, position, landmarks, nullptr);
    const Ramp<double> ramp = detail::checked_ramp<double>(0, config.reach);
    std::vector<double> criterion;
    for (Index i = 0; i < position.cols(); ++i) {
        const double near = influence(EuclideanDistance{}, ramp, double(distance(0, i)));
        const double factor = 1 + (config.prefer - 1) * near;
        criterion.push_back(factor * factor *
                            (double(square(0, i)) + double(square(1, i)) + double(square(2, i))));
    }
    return criterion;
}

namespace detail {

/// Returns the axis of a Gaussian along which a move by its own standard deviation has the largest
/// mean square change of the loss; the first of equals. rotation: from its axes to the head's.
template <Real T>
int split_axis(const Mat3<T>& rotation, const Vec3<T>& log_scale, const Vec3<T>& square) {
    int axis = 0;
    T most = T(-1);
    for (int k = 0; k < 3; ++k) {
        const Vec3<T> along = rotation.col(k);
        const T pull =
            std::exp(T(2) * log_scale[k]) * dot(along.cwiseProduct(along).eval(), square);
        if (pull > most) {
            most = pull;
            axis = k;
        }
    }
    return axis;
}

/// Fate of each Gaussian of a face.
struct DensityPlan {
    std::vector<bool> goes, splits;
    DensityChange change;
};

/// Returns the plan: Gaussians whose opacity is below the bound are removed; of the others, those
/// with the largest criterion split.
template <Real T>
DensityPlan density_plan(const Columns<T>& opacity_logit, const std::vector<double>& criterion,
                         const DensityConfig& config) {
    const Index n = opacity_logit.cols();
    const auto size = static_cast<std::size_t>(n);
    DensityPlan plan{std::vector<bool>(size), std::vector<bool>(size), {}};
    std::vector<std::size_t> candidates;
    for (std::size_t i = 0; i < size; ++i) {
        const double logit = double(opacity_logit(0, static_cast<Index>(i)));
        plan.goes[i] = sigmoid(logit) < config.prune;
        if (plan.goes[i])
            ++plan.change.pruned;
        else if (criterion[i] > 0 && sigmoid(SplitGaussian::logit_opacity(logit)) >= config.prune)
            candidates.push_back(i);
    }
    const Index left = n - plan.change.pruned;
    require(left > 0, "change_density", "all ", n, " Gaussians of the face have an opacity below ",
            config.prune, " (gaussians.density.prune), expected a face");
    const Index wanted =
        std::min(static_cast<Index>(config.grow * static_cast<double>(n)), config.most - left);
    const Index grown = std::clamp<Index>(wanted, 0, static_cast<Index>(candidates.size()));
    std::partial_sort(candidates.begin(), candidates.begin() + grown, candidates.end(),
                      [&](std::size_t a, std::size_t b) {
                          return criterion[a] != criterion[b] ? criterion[a] > criterion[b] : a < b;
                      });
    for (Index k = 0; k < grown; ++k) plan.splits[candidates[static_cast<std::size_t>(k)]] = true;
    plan.change.grown = grown;
    plan.change.face = left + grown;
    return plan;
}

} // namespace detail

/// Splits and prunes Gaussians of the face, with their moments. Those of opacity below config.prune
/// are removed. Of the others, those with the largest criterion split, the first ones of equals: at
/// most the share config.grow of all before, and as many as config.most permits, but none that no
/// step has moved or whose halves would be removed. Halves take the place of the whole, one after
/// the other. Eyes, networks and counts of steps are unchanged; trainers that hold memory for the
/// avatar must be made again. The face has 66 landmarks or more, in the order of the capture.
/// Throws an Error, with nothing changed, for a number that is not finite, and if all would be
/// removed.
template <Real T, EffectSet E, Backend B>
    requires(!face_rests<E> && !has_own_effects<E>)
DensityChange change_density(const B& backend, TwoStream<T, E>& avatar, Adam<TwoStream<T, E>>& adam,
                             const DensityConfig& config) {
    detail::require_splittable<E>(avatar, adam);
    FaceStream<T, E>& face = avatar.face;
    RYE_ASSERT(face.landmarks.cols() >= 66, "change_density: fewer than 66 landmarks");
    const Columns<T> eyes_and_lips = face.landmarks.middleCols(36, 30); // in GHA's numbering
    const detail::DensityPlan plan = detail::density_plan(
        face.opacity_logit,
        density_criterion<T>(backend, face.position, adam.v.face.position, eyes_and_lips, config),
        config);
    if (plan.change.grown + plan.change.pruned == 0) return plan.change;

    std::vector<Index> whole;  // source of each new column
    std::vector<Index> halves; // first columns of pairs
    for (Index i = 0; i < face.position.cols(); ++i) {
        if (plan.goes[static_cast<std::size_t>(i)]) continue;
        whole.push_back(i);
        if (!plan.splits[static_cast<std::size_t>(i)]) continue;
        halves.push_back(static_cast<Index>(whole.size()) - 1);
        whole.push_back(i);
    }
    if constexpr (has_effect<E, LidShadow>)
        detail::follow_lid_line(face.position, whole, avatar.eyes.lid_line);
    const Columns<T> square = adam.v.face.position;
    detail::for_face_columns<E>(
        [&](const char*, auto& p, auto& m, auto& v) {
            if (p.size() == 0) return;
            for (auto* a : {&p, &m, &v}) {
                Columns<T> moved(a->rows(), plan.change.face);
                for (Index k = 0; k < moved.cols(); ++k)
                    moved.col(k) = a->col(whole[static_cast<std::size_t>(k)]);
                *a = std::move(moved);
            }
            for (const Index k : halves) {
                m.middleCols(k, 2) *= T(detail::SplitGaussian::mean);
                v.middleCols(k, 2) *= T(detail::SplitGaussian::square);
            }
        },
        avatar, adam.m, adam.v);
    for (const Index k : halves) {
        const Mat3<T> rotation = quat_matrix(quat_normalized(Quat<T>(face.rotation.col(k))));
        const Vec3<T> log_scale = face.log_scale.col(k);
        const int axis = detail::split_axis<T>(rotation, log_scale,
                                               square.col(whole[static_cast<std::size_t>(k)]));
        const Vec3<T> step =
            T(detail::SplitGaussian::distance) * drawn_scale(log_scale[axis]) * rotation.col(axis);
        face.position.col(k) -= step;
        face.position.col(k + 1) += step;
        for (const Index half : {k, k + 1}) {
            face.log_scale(axis, half) -= T(std::log(detail::SplitGaussian::shrink));
            face.opacity_logit(0, half) =
                detail::SplitGaussian::logit_opacity(T(face.opacity_logit(0, half)));
        }
    }
    return plan.change;
}

} // namespace rye
