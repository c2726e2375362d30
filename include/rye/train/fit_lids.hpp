// SPDX-License-Identifier: Apache-2.0
/// rye/train/fit_lids.hpp: fit, at the end of stage 2, of what expressions do to lids that close.
/// These stretch: their Gaussians move apart, and the eyeball shows between them; and some of them
/// pass through the eyeball, where only landmarks at the rims were fitted. Few pictures blink, so
/// that they do not teach it. The networks of the expression are fitted to scales that grow with
/// the distance to the neighbours and to places before the eyeball; elsewhere, and with open lids,
/// to what they gave before. Not in the paper: docs/deviations.md.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <rye/avatar/two_stream.hpp>
#include <rye/nn/adam.hpp>
#include <rye/train/gradient_pieces.hpp>
#include <rye/train/landmark_regression.hpp>
#include <rye/train/lid_points.hpp>

namespace rye {

/// Settings of fit_lids.
struct LidFit {
    int steps = 0;     ///< 0: no fit
    int frames = 512;  ///< most that are drawn once; steps draw from these
    int batch = 8;     ///< frames a step
    Index lids = 128;  ///< most points of the lids a frame and step; of more, evenly spread ones
    Index others = 64; ///< points a frame and step that are to stay as they are
    double rate = 2e-3; ///< first learning rate of the attributes; the last is a twentieth
    double deform_rate = 2e-4; ///< of the displacements
    double most = 6;    ///< largest growth of a scale
    double clear = 0.03; ///< how far lids stay before the eyeball [radii]
    Random random = {};
};

namespace detail {

/// Root mean square differences over the last tenth of the steps.
struct LidErrors {
    double attributes = 0; ///< of steps of log-scale, quaternion and logit opacity
    double place = 0;      ///< of a coordinate [unit]
};

} // namespace detail

/// Result of fit_lids.
struct FittedLids {
    Index points = 0; ///< Gaussians that a blink moves apart
    detail::LidErrors lids;   ///< what is left to these
    detail::LidErrors others; ///< by how much other Gaussians have changed
};

namespace detail {

/// The source of fit_lids' frames.
template <class T>
struct LidFrames {
    const std::vector<VecX<T>>& expressions; ///< of the capture's frames, not empty
    const std::vector<Index>& blinks;        ///< coefficients that close lids
    double whole = 0;                        ///< their largest weight
};

/// Shares of the frames that are mixed ones, and of these that blink.
inline constexpr double mixed_lids = 0.75, blinking_lids = 0.5;

/// Gaussians of a face at rest, with the inputs of its networks by expression.
template <class T>
struct FacePart {
    Columns<T> position, code, feature, influence;

    FacePart of(const std::vector<Index>& which) const {
        return {pick_columns(position, which), pick_columns(code, which),
                pick_columns(feature, which), pick_columns(influence, which)};
    }
};
template <class T, EffectSet E, Backend B>
FacePart<T> whole_face(const B& backend, const FaceStream<T, E>& face, const AvatarConfig& config,
                       const LandmarkRoles& roles) {
    WeightsTrace<T, E> nearest;
    FacePart<T> all;
    all.position = face.position;
    encode_points<EncodingOf<E>>(backend, face.seen(), config.frequencies, all.code);
    tanh_into(backend, face.feature, all.feature);
    all.influence =
        face_weights<T>(backend, {config, face.seen(), face.landmarks}, roles, nearest).exp;
    return all;
}

/// Networks that are fitted.
template <class Network>
struct LidNetworks {
    Network attributes, deform;

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        nested_fields<Network>("attributes", f, p.attributes...);
        nested_fields<Network>("deform", f, p.deform...);
    }
    static auto arrays_of(Network& n) {
        std::vector<std::remove_reference_t<decltype(n.weight.front())>*> all;
        Network::fields([&](const std::string&, auto& a) { all.push_back(&a); }, n);
        return all;
    }
};

/// The sums that the fields are to have in one frame: at the lids first, then at some of the
/// others.
template <class T>
struct LidExample {
    VecX<T> expression;
    std::vector<Index> others; ///< places in LidPoints::others
    Columns<T> steps;          ///< of attributes, 8 x N
    Columns<T> places;         ///< 3 x N
};

/// Fit of a face's lids.
template <class T, EffectSet E, Backend B>
class LidFitter {
    using Network = NetworkOf<T, E>;
    using Networks = LidNetworks<Network>;

  public:
    /// Keeps references to its arguments.
    LidFitter(const B& backend, const TwoStream<T, E>& avatar, const AvatarConfig& config,
              const LandmarkRoles& roles, const LidFrames<T>& frames, const LidFit& fit)
        : backend_(backend),
          fit_(fit),
          frames_(frames),
          gain_(T(config.attribute_scale)),
          reach_(T(config.deform_scale)),
          eyes_(lid_eyeballs(avatar.eyes)),
          all_(whole_face<T>(backend, avatar.face, config, roles)),
          before_{avatar.face.exp_attributes, avatar.face.networks.exp_deform},
          points_(find_points()),
          around_(all_.of(points_.around)),
          lids_(all_.of(points_.lids)),
          others_(all_.of(points_.others)),
          fitted_(before_) {}

    const LidPoints& points() const { return points_; }
    const Networks& fitted() const { return fitted_; }

    template <class Mixed>
    FittedLids run(const Mixed& mixed) {
        std::vector<LidExample<T>> examples(static_cast<std::size_t>(
            std::max(1, std::min(fit_.frames, fit_.steps * fit_.batch))));
        const Random first = fit_.random.fork(0), draws = fit_.random.fork(1);
        backend_.threads.run(static_cast<Index>(examples.size()), [&](Index i) {
            const Random random = first.fork(static_cast<std::uint64_t>(i));
            examples[static_cast<std::size_t>(i)] = example(expression(random, mixed), random);
        });
        Networks sum = zeros_like(fitted_);
        Adam<Networks> adam(fitted_);
        // Displacements have the wider network: half of a frame's points a task.
        const auto frames = static_cast<std::size_t>(fit_.batch);
        GradientPieces<Network, T> of_attributes(sum.attributes, frames, &Networks::arrays_of),
            of_deform(sum.deform, 2 * frames, &Networks::arrays_of);
        std::vector<std::array<LidErrors, 2>> squares(3 * frames);
        std::array<LidErrors, 2> all;
        double seen = 0;
        for (int step = 0; step < fit_.steps; ++step) {
            backend_.threads.run(3 * fit_.batch, [&](Index task) {
                const auto at = static_cast<std::size_t>(task), i = at / 3, part = at % 3;
                const Random random = draws.fork(static_cast<std::uint64_t>(step) *
                                                     static_cast<std::uint64_t>(fit_.batch) +
                                                 static_cast<std::uint64_t>(i));
                const Index which = random.below(0, static_cast<Index>(examples.size()));
                pull(examples[static_cast<std::size_t>(which)], random, part,
                     part == 0 ? of_attributes.cleared(i) : of_deform.cleared(2 * i + part - 1),
                     squares[at]);
            });
            of_attributes.add_up(backend_.threads);
            of_deform.add_up(backend_.threads);
            const double decay = std::pow(0.05, static_cast<double>(step) / fit_.steps);
            adam_step(backend_, fitted_, sum, adam, [&](const std::string& name) {
                return decay * (name.starts_with("deform") ? fit_.deform_rate : fit_.rate);
            });
            if (step < fit_.steps - std::max(1, fit_.steps / 10)) continue;
            for (const std::array<LidErrors, 2>& s : squares)
                for (std::size_t k = 0; k < 2; ++k)
                    all[k].attributes += s[k].attributes, all[k].place += s[k].place / 2;
            seen += fit_.batch;
        }
        const auto root = [&](const LidErrors& e) {
            return LidErrors{std::sqrt(e.attributes / seen), std::sqrt(e.place / seen)};
        };
        return {static_cast<Index>(points_.lids.size()), root(all[0]), root(all[1])};
    }

  private:
    Field<T, typename Network::Activation> attributes_of(const Networks& n) const {
        return {n.attributes, Squash::none, gain_};
    }
    Field<T, typename Network::Activation> deform_of(const Networks& n) const {
        return {n.deform, Squash::tanh, reach_};
    }
    /// Returns where an expression takes points, by the networks as they were.
    template <class Any>
    Columns<T> displaced(const Any& backend, const FacePart<T>& part,
                         const VecX<T>& expression) const {
        Columns<T> to = part.position;
        FieldTrace<T> trace;
        add_field(backend, deform_of(before_), {part.code, part.influence, expression}, to, trace);
        return to;
    }
    /// Returns the steps of attributes, likewise.
    template <class Any>
    Columns<T> steps_before(const Any& backend, const FacePart<T>& part,
                            const VecX<T>& expression) const {
        Columns<T> to = Columns<T>::Zero(8, part.position.cols());
        FieldTrace<T> trace;
        add_field(backend, attributes_of(before_), {part.feature, part.influence, expression}, to,
                  trace);
        return to;
    }
    VecX<T> with_lids_at(VecX<T> expression, double weight) const {
        for (const Index k : frames_.blinks) expression[k] = T(weight);
        return expression;
    }

    LidPoints find_points() const {
        const NeighbourGraph graph = four_nearest_by_grid(backend_, all_.position);
        const VecX<T> open = VecX<T>::Zero(frames_.expressions.front().size());
        const std::vector<double> growth =
            growth_of<T>(displaced(backend_, all_, with_lids_at(open, frames_.whole)),
                         displaced(backend_, all_, open), graph, fit_.most);
        return {influenced(backend_, all_.influence), all_.influence, growth, graph};
    }

    template <class Mixed>
    VecX<T> expression(const Random& random, const Mixed& mixed) const {
        if (random.uniform(1) >= mixed_lids)
            return frames_.expressions[static_cast<std::size_t>(
                random.below(0, static_cast<Index>(frames_.expressions.size())))];
        const VecX<T> drawn = mixed(random.fork(1));
        if (random.uniform(2) >= blinking_lids) return drawn;
        return with_lids_at(drawn, frames_.whole * std::sqrt(random.uniform(3)));
    }

    /// Returns what is wanted in a frame.
    LidExample<T> example(const VecX<T>& expression, const Random& random) const {
        const auto alone = one_thread(backend_);
        const VecX<T> open = with_lids_at(expression, 0);
        const Columns<T> resting = displaced(alone, around_, open);
        Columns<T> closing = displaced(alone, around_, expression);
        move_out_of_eyeballs(eyes_, fit_.clear, resting, closing);
        const std::vector<double> growth = growth_of<T>(closing, resting, points_.near, fit_.most);

        LidExample<T> e{expression, {}, {}, {}};
        const auto rest = static_cast<Index>(points_.others.size());
        constexpr Index kept = 4; // times as many others as a step takes
        for (Index k = 0; k < std::min(kept * fit_.others, rest); ++k)
            e.others.push_back(random.below(4 + static_cast<std::uint64_t>(k), rest));
        const FacePart<T> unmoved = others_.of(e.others);
        const auto count = static_cast<Index>(points_.lids.size());
        e.steps.resize(8, count + unmoved.position.cols());
        e.steps << steps_before(alone, lids_, expression),
            steps_before(alone, unmoved, expression);
        e.places.resize(3, e.steps.cols());
        e.places << closing.leftCols(count), displaced(alone, unmoved, expression);
        const Columns<T> at_rest = steps_before(alone, lids_, open);
        for (Index i = 0; i < count; ++i)
            for (Index k = 0; k < 3; ++k) { // pictures of lids that close have taught some of it
                const T grown = at_rest(k, i) + T(std::log(growth[static_cast<std::size_t>(i)]));
                e.steps(k, i) = std::max(e.steps(k, i), grown);
            }
        return e;
    }

    /// Adds the gradient of one network by some of a frame's points, and sets its mean squared
    /// errors of lids and of others. `piece`: 0 for attributes, 1 or 2 for displacements of half
    /// the points.
    void pull(const LidExample<T>& e, const Random& random, std::size_t piece, Network& gradient,
              std::array<LidErrors, 2>& squares) const {
        const auto count = static_cast<Index>(points_.lids.size());
        std::vector<Index> which = spread(count, fit_.lids, random.uniform(1)), points;
        for (const Index k :
             spread(static_cast<Index>(e.others.size()), fit_.others, random.uniform(2)))
            which.push_back(count + k);
        const auto of_frame = static_cast<double>(which.size());
        if (piece > 0) { // every other one
            std::size_t kept = 0;
            for (std::size_t k = piece - 1; k < which.size(); k += 2) which[kept++] = which[k];
            which.resize(kept);
        }
        Index lids = 0;
        for (const Index i : which) {
            const bool lid = i < count;
            lids += lid ? 1 : 0;
            points.push_back(lid ? points_.lids[static_cast<std::size_t>(i)]
                                 : points_.others[static_cast<std::size_t>(
                                       e.others[static_cast<std::size_t>(i - count)])]);
        }
        const FacePart<T> part = all_.of(points);
        const auto pull_by = [&](const auto& field, const Columns<T>& input, Columns<T> sum,
                                 const Columns<T>& wanted, double LidErrors::*error) {
            const auto alone = one_thread(backend_);
            FieldTrace<T> trace;
            add_field(alone, field, {input, part.influence, e.expression}, sum, trace);
            sum -= pick_columns(wanted, which);
            const auto mean = [](const auto& of) {
                return static_cast<double>(of.squaredNorm()) /
                       std::max(1.0, static_cast<double>(of.size()));
            };
            squares[0].*error = mean(sum.leftCols(lids));
            squares[1].*error = mean(sum.rightCols(sum.cols() - lids));
            const Columns<T> g = T(2.0 / (fit_.batch * of_frame)) * sum;
            field_vjp(alone, field, {part.influence, e.expression, trace}, g, {&gradient});
        };
        if (piece == 0)
            pull_by(attributes_of(fitted_), part.feature,
                    Columns<T>::Zero(8, part.position.cols()), e.steps, &LidErrors::attributes);
        else
            pull_by(deform_of(fitted_), part.code, part.position, e.places, &LidErrors::place);
    }

    const B& backend_;
    const LidFit& fit_;
    const LidFrames<T>& frames_;
    T gain_, reach_; ///< of the fields
    LidEyeballs<T> eyes_;
    FacePart<T> all_;
    Networks before_;
    LidPoints points_;
    FacePart<T> around_, lids_, others_; ///< those of points_
    Networks fitted_;
};

} // namespace detail

/// Fits exp_attributes and exp_deform of the face. `mixed` returns the expression of a mixed frame
/// by a Random. Nothing is done without steps, without blinks, or if a whole blink moves nothing
/// apart. Fitted again, what is fitted changes little.
template <Real T, EffectSet E, Backend B, class Mixed>
    requires (has_effect<E, Expression>)
FittedLids fit_lids(const B& backend, TwoStream<T, E>& avatar, const AvatarConfig& config,
                    const LandmarkRoles& roles,
                    const std::type_identity_t<detail::LidFrames<T>>& frames, const Mixed& mixed,
                    const LidFit& fit) {
    if (fit.steps == 0 || frames.blinks.empty() || !(frames.whole > 0) ||
        avatar.face.position.cols() < 5)
        return {};
    detail::LidFitter<T, E, B> fitter(backend, avatar, config, roles, frames, fit);
    if (fitter.points().lids.empty() || fitter.points().others.empty()) return {};
    const FittedLids result = fitter.run(mixed);
    avatar.face.exp_attributes = fitter.fitted().attributes;
    avatar.face.networks.exp_deform = fitter.fitted().deform;
    return result;
}

} // namespace rye
