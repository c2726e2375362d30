// SPDX-License-Identifier: Apache-2.0
/// rye/train/fit_deformation.hpp: fit of the deformations by expression and gaze to the landmarks
/// of all frames at the end of stage 1. A step is cheap compared with one with pictures, so rare
/// frames (a blink) are fitted as well as common ones. Not in the paper: docs/deviations.md.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include <rye/core/random.hpp>
#include <rye/nn/adam.hpp>
#include <rye/train/gradient_pieces.hpp>
#include <rye/train/landmark_losses.hpp>
#include <rye/train/landmark_regression.hpp>

namespace rye {

/// Settings of the fit of deformations to landmarks.
struct DeformationFit {
    int steps = 0;
    int batch = 4;        ///< frames per step
    double rate = 2e-3;   ///< first learning rate; the last is a twentieth
    Random random = {};   ///< draw of the frames
    /// Share of the frames that are mixed_frame, with the landmarks of a regression; 0 for none.
    double mixed = 0;
    RegressionConfig regression = {};
    /// Weight of a landmark at the lids, relative to the others. Lids are few landmarks that move
    /// far beside some that do not, which networks learn late.
    double lids = 1;
};

namespace detail {

/// Landmarks of one piece of a frame, at most. Each piece packs the networks' weights and has a
/// gradient of its own, which costs as much as about 40 landmarks.
inline constexpr Index deformed_at_once = 192;

/// Distance from a landmark of an eye within which others are at its lids [unit].
inline constexpr double lid_reach = 0.03;

/// Returns the weight of each landmark in the fit, 1 x L: fit.lids at the lids, else 1.
template <class T>
Columns<T> fit_weights(const Columns<T>& neutral, const LandmarkRoles& roles,
                       const DeformationFit& fit) {
    Columns<T> weight = Columns<T>::Ones(1, neutral.cols());
    for (const std::vector<Index>& eye : roles.eye)
        for (Index l = 0; l < neutral.cols(); ++l)
            for (const Index k : eye)
                if ((neutral.col(l) - neutral.col(k)).norm() < T(lid_reach))
                    weight(0, l) = T(fit.lids);
    return weight;
}

/// Returns the places of landmarks [begin, begin + count), as deform_landmarks reads them.
template <class T, EffectSet E>
LandmarkPlaces<T, E> places_from(const LandmarkPlaces<T, E>& all, Index begin, Index count) {
    LandmarkPlaces<T, E> part;
    part.shifted = all.shifted.middleCols(begin, count);
    part.code = all.code.middleCols(begin, count);
    part.ones = all.ones.middleCols(begin, count);
    for_eyes([&]<std::size_t eye>() {
        if constexpr (skin_follows<E, eye>)
            if (const Columns<T>& gaze = of_eye<eye>(all.weights.gaze); gaze.cols() > 0)
                of_eye<eye>(part.weights.gaze) = gaze.middleCols(begin, count);
    });
    return part;
}

/// Returns the arrays of the networks that deform by expression and by gaze.
template <class T, EffectSet E>
std::vector<Columns<T>*> deformation_arrays(FaceNetworks<T, E>& networks) {
    std::vector<Columns<T>*> arrays;
    const auto add = [&](const std::string&, Columns<T>& a) { arrays.push_back(&a); };
    if constexpr (has_effect<E, Expression>) NetworkOf<T, E>::fields(add, networks.exp_deform);
    for_eyes([&]<std::size_t eye>() {
        if constexpr (skin_follows<E, eye>)
            NetworkOf<T, E>::fields(add, of_eye<eye>(networks.gaze_deform));
    });
    return arrays;
}

/// A frame of a step of the fit.
template <class T, EffectSet E>
struct FittedFrame {
    MeshSample<T, E> made;                      ///< if it is mixed
    const MeshSample<T, E>* captured = nullptr; ///< or null
    FrameCode<T, E> code;

    bool mixed() const { return captured == nullptr; }
    const MeshSample<T, E>& shown() const { return mixed() ? made : *captured; }
};

/// Draws of the fit's frames: of the capture's, or mixed ones.
template <class T, EffectSet E>
class FittedFrames {
  public:
    /// Keeps references to its arguments.
    template <Backend B>
    FittedFrames(const B& backend, const Columns<T>& neutral, const LandmarkStage& stage,
                 const std::vector<MeshSample<T, E>>& frames, const DeformationFit& fit)
        : neutral_(neutral),
          config_(stage.config),
          frames_(frames),
          fit_(fit),
          mixes_(fit.random.fork(1)) {
        if (fit.mixed > 0)
            regression_ = landmark_regression<T, E>(backend, {stage.config, neutral, neutral},
                                                    stage.roles, frames, fit.regression);
    }

    /// Sets frame i of a step.
    void draw(int step, Index i, FittedFrame<T, E>& f) const {
        const auto number = static_cast<std::uint64_t>(step * fit_.batch + i);
        if (fit_.mixed > 0 && mixes_.uniform(number) < fit_.mixed) {
            f.made = mixed_frame(frames_, regression_, neutral_, mixes_.fork(number));
            f.captured = nullptr;
        } else {
            f.captured = &frames_[static_cast<std::size_t>(
                fit_.random.below(number, static_cast<Index>(frames_.size())))];
        }
        f.code = frame_code(config_, OpticalDrivers<T, E>(f.shown().drivers));
    }
    /// Returns true if the error of a step is one of those that the fit reports.
    bool reported(int step) const {
        return step >= fit_.steps - static_cast<int>(frames_.size());
    }

  private:
    const Columns<T>& neutral_;
    const AvatarConfig& config_;
    const std::vector<MeshSample<T, E>>& frames_;
    const DeformationFit& fit_;
    Random mixes_;
    LandmarkRegression regression_;
};

/// Returns the share of the first learning rate that a step has.
inline double fit_rate_share(const DeformationFit& fit, int step) {
    return std::pow(0.05, static_cast<double>(step) / fit.steps);
}

/// A piece of such a frame.
template <class T, EffectSet E>
struct FittedPiece {
    DeformedLandmarks<T, E> landmarks;
    T squares = T(0); ///< its share of the frame's mean square error of a coordinate
};

} // namespace detail

/// Fits the deformations. `frames` need drivers and landmarks only. Pieces of the frames of a step
/// run in parallel, each on one thread, and are added in order. Returns the root mean square error
/// of a landmark's coordinate in the last steps (as many as there are frames), canonical units,
/// without mixed frames.
template <Real T, EffectSet E, Backend B>
double fit_deformation(const B& backend, GuidanceMesh<T, E>& mesh, const LandmarkStage& stage,
                       const std::vector<MeshSample<T, E>>& frames, const DeformationFit& fit) {
    using Networks = FaceNetworks<T, E>;
    const auto alone = one_thread(backend);
    const Columns<T>& neutral = mesh.landmarks;
    GeometryTrace<T> geometry;
    detail::LandmarkPlaces<T, E> all; // lattice and landmarks are fixed, so these are too
    place_landmarks(backend, mesh, stage, geometry, all);
    const detail::FittedFrames<T, E> drawn(backend, neutral, stage, frames, fit);
    const Columns<T> weight = detail::fit_weights(neutral, stage.roles, fit);
    Networks& networks = mesh.networks;
    Adam<Networks> adam(networks);
    Networks grad = zeros_like(networks);

    const Index count = neutral.cols();
    const Index each = detail::chunk_count(
        count, std::max<Index>(1, detail::chunk_count(count, detail::deformed_at_once)));
    std::vector<detail::LandmarkPlaces<T, E>> places;
    for (Index begin = 0; begin < count; begin += each)
        places.push_back(detail::places_from(all, begin, std::min(each, count - begin)));
    const auto parts = static_cast<Index>(places.size());
    std::vector<detail::FittedFrame<T, E>> shown(static_cast<std::size_t>(fit.batch));
    std::vector<detail::FittedPiece<T, E>> pieces(shown.size() * places.size());
    detail::GradientPieces<Networks, T> gradients(
        grad, pieces.size(), [](Networks& n) { return detail::deformation_arrays(n); });
    const auto run = [&](Index i) {
        const detail::FittedFrame<T, E>& f = shown[static_cast<std::size_t>(i / parts)];
        const detail::LandmarkPlaces<T, E>& own = places[static_cast<std::size_t>(i % parts)];
        detail::FittedPiece<T, E>& p = pieces[static_cast<std::size_t>(i)];
        const detail::LandmarkDeformation<T, E> at{networks, stage, own, f.code};
        deform_landmarks(alone, at, p.landmarks);
        const Index first = i % parts * each, size = own.shifted.cols();
        const LossTerm<T> off = detail::deformation_term<T>(
            p.landmarks.deformed, f.shown().landmarks.middleCols(first, size));
        const T share = T(static_cast<double>(size) / static_cast<double>(count));
        p.squares = share * off.value;
        Columns<T> g = T(1.0 / fit.batch) * share * off.gradient;
        for (Index l = 0; l < size; ++l) g.col(l) *= weight(0, first + l);
        deform_landmarks_vjp<T, E>(alone, at, p.landmarks, g,
                                   {gradients.cleared(static_cast<std::size_t>(i))});
    };
    double squares = 0, seen = 0;
    for (int step = 0; step < fit.steps; ++step) {
        backend.threads.run(fit.batch, [&](Index i) {
            drawn.draw(step, i, shown[static_cast<std::size_t>(i)]);
        });
        backend.threads.run(static_cast<Index>(pieces.size()), run);
        gradients.add_up(backend.threads);
        for (std::size_t i = 0; i < shown.size(); ++i) {
            if (shown[i].mixed() || !drawn.reported(step)) continue;
            for (std::size_t k = 0; k < places.size(); ++k)
                squares += static_cast<double>(pieces[i * places.size() + k].squares);
            ++seen;
        }
        const double rate = fit.rate * detail::fit_rate_share(fit, step);
        adam_step(backend, networks, grad, adam, [&](const std::string& name) {
            return name.starts_with("exp_deform") || name.find("gaze_deform") != std::string::npos
                       ? rate : 0.0;
        });
    }
    return seen > 0 ? std::sqrt(squares / seen) : 0.0;
}

} // namespace rye
