// SPDX-License-Identifier: Apache-2.0
/// rye/train/avatar_trainer.hpp: stage 2 as an object that drives, renders, compares,
/// differentiates and takes a step of Adam.
///     AvatarTrainer trainer{backend, avatar, adam, {.config = config, .roles = roles}};
///     for (const auto& sample : samples) trainer.step(sample);
/// or, with several pictures a step, by one rank or by several (train/group.hpp):
///     for (const auto& sample : own) trainer.add(sample.drivers, sample, all);
///     trainer.take(group);
/// Source: paper section 4.2.
#pragma once

#include <limits>
#include <string>
#include <utility>
#include <vector>

#include <rye/avatar/two_stream.hpp>
#include <rye/loss/smoothness.hpp>
#include <rye/nn/adam.hpp>
#include <rye/train/avatar_objective.hpp>
#include <rye/train/centring.hpp>
#include <rye/train/face_smoothness.hpp>
#include <rye/train/group.hpp>
#include <rye/train/view_gauge.hpp>

namespace rye {

/// Bounds of the eyeballs' Gaussians after each step (see bound_scales); 0 for none.
struct EyeballBounds {
    double growth = 0;     ///< largest scale, times the template's spacing
    double thickness = 1;  ///< scale along the normal, times the template's spacing
};

namespace detail {

/// Returns four neighbours of each point of the eyeballs, on its own eyeball: nearest_and_turned.
template <Real T, EffectSet E>
NeighbourGraph eye_neighbours(const EyeStream<T, E>& eyes) {
    NeighbourGraph all;
    for (Index e = 0; e < 2; ++e) {
        const Index first = eyes.first_point(e);
        const Columns<T> points = eyes.position.middleCols(first, eyes.points_of(e));
        const NeighbourGraph of_eye = nearest_and_turned(points, first);
        all.insert(all.end(), of_eye.begin(), of_eye.end());
    }
    return all;
}

} // namespace detail

/// Settings of a run of stage 2. Rates(name) returns the learning rate of a field.
template <AccuracyPolicy A = Balanced, class Perceptual = PyramidGradientLoss,
          class Rates = AvatarRates>
struct AvatarTraining {
    AvatarConfig config = {};
    LandmarkRoles roles = {};
    AvatarObjective<A, Perceptual> objective = {};
    Rates rates = {};
    EyeballBounds bounds = {};
    /// True if the mean over frames is subtracted from the corrections of head poses after each
    /// step: what all frames share belongs to the avatar. It is always subtracted from those of
    /// gazes.
    bool centred_corrections = false;
    /// Unit vectors from the head to each camera, 3 x cameras, of an avatar with delta_view: after
    /// each step what all cameras show alike is subtracted (view_gauge).
    Columns<double> view_directions = {};
    /// face_neighbours() of the positions at which the face began, the same for a resumed training.
    FaceNeighbours face_neighbours = {};
};

/// Result of a training step.
template <class T>
struct AvatarStepReport {
    AvatarLosses<T> losses;
    AdamReport adam;  ///< not applied, and nothing changed, if a gradient was not finite
};

/// Training of an avatar, step by step, on the caller's parameters and moments.
template <Backend B, class T, EffectSet E, AccuracyPolicy A, class Perceptual, class Rates>
class AvatarTrainer {
  public:
    using Avatar = TwoStream<T, E>;
    B backend;

    /// Keeps references: the avatar and its optimiser must outlive the trainer.
    AvatarTrainer(const B& on, Avatar& avatar, Adam<Avatar>& adam,
                  AvatarTraining<A, Perceptual, Rates> training)
        : backend(on), avatar_(avatar), adam_(adam), training_(std::move(training)),
          gradient_(zeros_like(avatar)) {
        detail::check_corrections(avatar, "AvatarTrainer");
        if constexpr (has_effect<E, HeadPose>)
            if (avatar.delta_view.size() > 0) {
                detail::check_directions(training_.view_directions, avatar.delta_view.cols(),
                                         "AvatarTrainer");
                gauge_ = detail::view_gauge(training_.view_directions).template cast<T>();
            }
        if constexpr (Real<T>)
            if (training_.objective.weights.eye_smooth > 0) {
                neighbours_ = detail::eye_neighbours(avatar.eyes);
                neighbour_of_ = detail::neighbour_of(neighbours_);
            }
        face_smoothness_ =
            FaceSmoothness(training_.objective.weights, std::move(training_.face_neighbours),
                           avatar.face.position.cols());
    }

    /// Takes a step with the learning rates multiplied by `rate`.
    template <class Probe = NoProbe>
    AvatarStepReport<T> step(const Drivers<T, E>& drivers, const AvatarImages<T>& images,
                             double rate = 1, Probe&& probe = {}) {
        const AvatarLosses<T> l = losses_and_gradient(drivers, images, probe);
        return follow(gradient_, l, rate, probe);
    }
    template <class Probe = NoProbe>
    AvatarStepReport<T> step(const AvatarSample<T, E>& sample, double rate = 1,
                             Probe&& probe = {}) {
        return step(sample.drivers, sample, rate, probe);
    }

    /// Adds a picture to the step under way, which take() takes: losses and gradient are means over
    /// `all` pictures, of all ranks, each of which adds its step_share() in order.
    template <class Probe = NoProbe>
    void add(const Drivers<T, E>& drivers, const AvatarImages<T>& images, Index all,
             Probe&& probe = {}) {
        const AvatarLosses<T> l = losses_and_gradient(drivers, images, probe);
        sums_.add(gradient_, l, T(1) / T(all));
        probe("sum of pictures");
    }
    /// Takes the step of the pictures that were added; every rank of the group calls it, and has
    /// the same avatar afterwards.
    template <class G = Alone, class Probe = NoProbe>
        requires Group<std::remove_cvref_t<G>>
    AvatarStepReport<T> take(G&& group = {}, double rate = 1, Probe&& probe = {}) {
        require(sums_.count() > 0, "AvatarTrainer", "a step without a picture");
        const auto [gradient, l] = sums_.template close<T>(group);
        probe("sum of ranks");
        return follow(gradient, l, rate, probe);
    }

    /// Returns the losses of the avatar at its current parameters, without smoothness of eyes and
    /// face.
    template <class Probe = NoProbe>
    AvatarLosses<T> losses(const Drivers<T, E>& drivers, const AvatarImages<T>& images,
                           Probe&& probe = {}) {
        drive(backend, avatar_,
              {training_.config, training_.roles, corrected(drivers, images), seen(images)},
              trace_);
        probe("networks");
        return training_.objective.value(backend, avatar_.upsampler, images, trace_, pictures_,
                                         probe);
    }
    /// Adds the gradient of losses(), which must have been called last, with the same arguments.
    template <class Probe = NoProbe>
    void add_gradient(const Drivers<T, E>& drivers, const AvatarImages<T>& images, Avatar& gradient,
                      Probe&& probe = {}) {
        training_.objective.vjp(backend, avatar_.upsampler, images, trace_, pictures_,
                                gradient.upsampler, probe);
        if constexpr (smooths_driven)
            if (driven_smoothness_.size() > 0) {
                detail::add_weighted<T>(
                    backend.threads,
                    pictures_.g_gaussians.feature.rightCols(driven_smoothness_.cols()), T(1),
                    driven_smoothness_);
                driven_smoothness_.resize(0, 0);
            }
        [[maybe_unused]] Columns<T> g_kappa;
        if constexpr (has_effect<E, Kappa>) g_kappa = gradient.eyes.kappa;
        const Vec<T, 6> g_pose = drive_vjp(
            backend, avatar_,
            {training_.config, training_.roles, corrected(drivers, images), seen(images)},
            trace_, {pictures_.g_gaussians, gradient});
        if constexpr (has_effect<E, ReadsHeadPose>)
            if (images.frame >= 0) gradient.delta_pose.col(images.frame) += g_pose;
        if constexpr (has_effect<E, Kappa>)
            if (images.frame >= 0 && avatar_.delta_gaze.size() > 0) // kappa's: angles add
                gradient.delta_gaze.col(images.frame) +=
                    Columns<T>(gradient.eyes.kappa - g_kappa).reshaped();
        probe("networks vjp");
    }

    const TwoStreamTrace<T, E>& trace() const { return trace_; }
    const AvatarPictures<T, detail::UpsamplerOf<T, E>>& pictures() const { return pictures_; }

  private:
    /// Returns the losses of a picture, and their gradient in gradient_.
    template <class Probe>
    AvatarLosses<T> losses_and_gradient(const Drivers<T, E>& drivers,
                                        const AvatarImages<T>& images, Probe&& probe) {
        AvatarLosses<T> l = losses(drivers, images, probe);
        detail::set_zero(backend.threads, gradient_);
        const AvatarLossConfig& weights = training_.objective.weights;
        if constexpr (smooths_driven)
            if (weights.eye_smooth > 0) {
                const Index all = avatar_.eyes.position.cols();
                LossGradient<T> term = smoothness<T>(
                    backend.threads, Columns<T>(trace_.gaussians.feature.rightCols(all)),
                    neighbours_, neighbour_of_);
                driven_smoothness_ = T(weights.eye_smooth) * term.gradient;
                l.eye_smooth = term.value;
                l.total += T(weights.eye_smooth) * term.value;
            }
        add_gradient(drivers, images, gradient_, probe);
        if constexpr (smooths)
            if (weights.eye_smooth > 0) {
                const LossGradient<T> term =
                    smoothness(backend.threads, avatar_.eyes.feature, neighbours_, neighbour_of_);
                detail::add_weighted<T>(backend.threads, gradient_.eyes.feature,
                                        T(weights.eye_smooth), term.gradient);
                l.eye_smooth = term.value;
                l.total += T(weights.eye_smooth) * term.value;
            }
        if constexpr (Real<T>)
            face_smoothness_.add(backend.threads, face_features(avatar_.face), l,
                                 face_features(gradient_.face));
        return l;
    }

    /// Takes a step of the optimiser by a gradient.
    template <class Probe>
    AvatarStepReport<T> follow(const Avatar& gradient, const AvatarLosses<T>& l, double rate,
                               Probe&& probe) {
        AvatarStepReport<T> r{l, {}};
        r.adam = adam_step(backend, avatar_, gradient, adam_, [&](const std::string& name) {
            if constexpr (requires { training_.rates.first_step(name); })
                if (adam_.step < training_.rates.first_step(name)) return 0.0;
            return rate * training_.rates(name);
        });
        if (r.adam.applied) centre();
        if (training_.bounds.growth > 0)
            detail::bound_scales(avatar_.eyes, T(training_.bounds.growth),
                                 T(training_.bounds.thickness));
        probe("optimiser");
        return r;
    }

    /// True if the smoothness is that of parameters, since features are constants; if false it is
    /// that of the frame's generated features.
    static constexpr bool smooths = requires(const Avatar& a) { a.eyes.feature; } && Real<T>;
    static constexpr bool smooths_driven = !smooths && Real<T>;

    /// Returns the drivers with the frame's corrections and the camera.
    Drivers<T, E> corrected(const Drivers<T, E>& tracked, const AvatarImages<T>& images) const {
        Drivers<T, E> drivers = tracked;
        if constexpr (has_effect<E, ReadsHeadPose>)
            if (images.frame >= 0) drivers.pose += avatar_.delta_pose.col(images.frame);
        if constexpr (has_effect<E, Kappa>)
            if (images.frame >= 0 && avatar_.delta_gaze.size() > 0)
                for_eyes([&]<std::size_t eye>() {
                    if constexpr (eye_turns<E, eye>)
                        of_eye<eye>(drivers.gaze) = detail::corrected_gaze<T>(
                            of_eye<eye>(tracked.gaze), avatar_.delta_gaze.col(images.frame).data(),
                            eye);
                });
        return seen_from(std::move(drivers), images.camera);
    }

    /// Returns the picture's view, if cameras are corrected.
    SeenBy<T> seen([[maybe_unused]] const AvatarImages<T>& images) const {
        if constexpr (has_effect<E, HeadPose>)
            if (avatar_.delta_view.size() > 0) return images.view;
        return {};
    }

    /// Subtracts what frames, or cameras, share from the corrections.
    void centre() {
        if constexpr (has_effect<E, HeadPose>)
            if (avatar_.delta_view.size() > 0) detail::centre_views(gauge_, avatar_.delta_view);
        if constexpr (has_effect<E, Kappa>) detail::centre_rows(avatar_.delta_gaze);
        if constexpr (has_effect<E, ReadsHeadPose>)
            if (training_.centred_corrections) detail::centre_rows(avatar_.delta_pose);
    }

    Avatar& avatar_;
    Adam<Avatar>& adam_;
    AvatarTraining<A, Perceptual, Rates> training_;
    Avatar gradient_;
    detail::StepSums<Avatar, AvatarLosses<T>> sums_; ///< of a step of several pictures
    TwoStreamTrace<T, E> trace_;
    AvatarPictures<T, detail::UpsamplerOf<T, E>> pictures_;
    detail::NeighbourGraph
        neighbours_; ///< for both eyeballs' points, if their colours are smoothed
    std::vector<std::vector<Index>> neighbour_of_; ///< neighbour_of(neighbours_)
    FaceSmoothness face_smoothness_;
    Columns<T> gauge_ = {}; ///< view_gauge(), if cameras are corrected
    Columns<T> driven_smoothness_ = {}; ///< cotangent of features for add_gradient, C x P
};

template <Backend B, class T, EffectSet E, AccuracyPolicy A = Balanced,
          class Perceptual = PyramidGradientLoss, class Rates = AvatarRates>
AvatarTrainer(const B&, TwoStream<T, E>&, Adam<TwoStream<T, E>>&,
              AvatarTraining<A, Perceptual, Rates>)
    -> AvatarTrainer<B, T, E, A, Perceptual, Rates>;

} // namespace rye
