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
#include <rye/train/face_smoothness.hpp>
#include <rye/train/landmark_regression.hpp>

namespace rye {

/// Settings of fit_lids.
struct LidFit {
    int steps = 0;      ///< 0: no fit
    int batch = 4;      ///< frames a step
    Index lids = 768;   ///< most points of the lids a frame; of more, evenly spread ones
    Index others = 256; ///< points a frame that are to stay as they are
    double rate = 2e-3; ///< first learning rate of the attributes; the last is a twentieth
    double deform_rate = 2e-4; ///< of the displacements
    double most = 6;    ///< largest growth of a scale
    double clear = 0.03; ///< how far lids stay before the eyeball [radii]
    Random random = {};
};

/// Root mean square differences over the last tenth of the steps.
struct LidErrors {
    double attributes = 0; ///< of steps of log-scale, quaternion and logit opacity
    double place = 0;      ///< of a coordinate [unit]
};
/// Result of fit_lids.
struct FittedLids {
    Index points = 0; ///< Gaussians that a blink moves apart
    LidErrors lids;   ///< what is left to these
    LidErrors others; ///< by how much other Gaussians have changed
};

/// Eyeballs at rest, head frame, canonical units.
template <class T>
struct LidEyeballs {
    Columns<T> centre; ///< 3 x 2
    std::array<T, 2> radius;
};
/// Returns the eyeballs of a stream; their radius is the mean of their Gaussians' distances.
template <class T, EffectSet E>
LidEyeballs<T> lid_eyeballs(const EyeStream<T, E>& eyes) {
    LidEyeballs<T> balls{eyes.centre, {}};
    for (Index e = 0; e < 2; ++e) {
        const Columns<T> points =
            eyes.position.middleCols(eyes.first_point(e), eyes.points_of(e));
        balls.radius[static_cast<std::size_t>(e)] = points.colwise().norm().mean();
    }
    return balls;
}
/// Moves points that are inside an eyeball, and were before it with open lids, out to `clear` radii
/// before it. Columns of `open` are the same points.
template <class T>
void move_out_of_eyeballs(const LidEyeballs<T>& eyes, double clear, const Columns<T>& open,
                          Columns<T>& points) {
    for (Index i = 0; i < points.cols(); ++i)
        for (Index e = 0; e < 2; ++e) {
            const Vec3<T> centre = eyes.centre.col(e), out = points.col(i) - centre;
            const T radius = eyes.radius[static_cast<std::size_t>(e)],
                    least = T(1 + clear) * radius, far = out.norm();
            // Beyond the middle a point is no lid's.
            if (far < least && far > T(0.5) * radius && (open.col(i) - centre).norm() >= radius)
                points.col(i) = centre + least / far * out;
        }
}

/// What fit_lids draws its frames from.
template <class T>
struct LidFrames {
    const std::vector<VecX<T>>& expressions; ///< of the capture's frames, not empty
    const std::vector<Index>& blinks;        ///< coefficients that close lids
    double whole = 0;                        ///< their largest weight
};

namespace detail {

/// Least growth by a whole blink, and least influence, of a point that is fitted.
inline constexpr double least_growth = 1.1, least_influence = 0.5;
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

/// Returns how far apart points are in one frame relative to another: for each point the mean of
/// the squared distances to its neighbours, at least 1 and at most `most`. near: columns of the
/// four neighbours of the first points.
template <class T>
std::vector<double> growth_of(const Columns<T>& apart, const Columns<T>& before,
                              const NeighbourGraph& near, double most) {
    std::vector<double> growth(near.size());
    for (std::size_t k = 0; k < near.size(); ++k) {
        double now = 0, then = 0;
        for (const Index j : near[k]) {
            const auto i = static_cast<Index>(k);
            now += static_cast<double>((apart.col(j) - apart.col(i)).squaredNorm());
            then += static_cast<double>((before.col(j) - before.col(i)).squaredNorm());
        }
        growth[k] = then > 0 ? std::clamp(now / then, 1.0, most) : 1.0;
    }
    return growth;
}

/// Gaussians that a whole blink moves apart, and others that the expression moves.
struct LidPoints {
    std::vector<Index> lids, others;
    std::vector<Index> around; ///< the lids, then their neighbours that are not among them
    NeighbourGraph near;       ///< places in `around` of the neighbours of each lid

    template <class T>
    LidPoints(const std::vector<Index>& moved, const Columns<T>& influence,
              const std::vector<double>& growth, const NeighbourGraph& graph) {
        for (const Index i : moved) {
            const bool lid = growth[static_cast<std::size_t>(i)] > least_growth &&
                             influence(0, i) >= T(least_influence);
            (lid ? lids : others).push_back(i);
        }
        around = lids;
        std::vector<Index> place(graph.size(), -1);
        for (std::size_t k = 0; k < lids.size(); ++k)
            place[static_cast<std::size_t>(lids[k])] = static_cast<Index>(k);
        for (const Index i : lids)
            add_neighbours(graph[static_cast<std::size_t>(i)], place, [](Index j) { return j; });
    }
    /// Of `count` lids, evenly spread from a start within [0, 1); without the others.
    LidPoints(const LidPoints& all, Index count, double start) {
        const auto many = static_cast<double>(all.lids.size());
        std::vector<Index> chosen, place(all.around.size(), -1);
        for (Index k = 0; k < count; ++k) {
            const auto i = static_cast<std::size_t>(
                std::min((static_cast<double>(k) + start) * many / static_cast<double>(count),
                         many - 1));
            place[i] = k;
            chosen.push_back(static_cast<Index>(i));
            lids.push_back(all.lids[i]);
        }
        around = lids;
        for (const Index i : chosen)
            add_neighbours(all.near[static_cast<std::size_t>(i)], place,
                           [&](Index j) { return all.around[static_cast<std::size_t>(j)]; });
    }

  private:
    /// Adds a lid's neighbours to `near`, and to `around` those that `place` does not know yet.
    template <class Point>
    void add_neighbours(std::array<Index, 4> neighbours, std::vector<Index>& place,
                        const Point& point) {
        for (Index& j : neighbours) {
            Index& at = place[static_cast<std::size_t>(j)];
            if (at < 0) {
                at = static_cast<Index>(around.size());
                around.push_back(point(j));
            }
            j = at;
        }
        near.push_back(neighbours);
    }
};

/// Fit of a face's lids.
template <class T, EffectSet E, Backend B>
class LidFitter {
    using Network = NetworkOf<T, E>;

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
          attributes_before_(avatar.face.exp_attributes),
          deform_before_(avatar.face.networks.exp_deform),
          points_(find_points()),
          attributes_(attributes_before_),
          deform_(deform_before_),
          g_attributes_(zeros_like(attributes_)),
          g_deform_(zeros_like(deform_)),
          adam_attributes_(attributes_),
          adam_deform_(deform_) {}

    const LidPoints& points() const { return points_; }
    const Network& attributes() const { return attributes_; }
    const Network& deform() const { return deform_; }

    template <class Mixed>
    void step(int number, const Mixed& mixed) {
        set_zero(backend_.threads, g_attributes_);
        set_zero(backend_.threads, g_deform_);
        reported_ = number >= fit_.steps - std::max(1, fit_.steps / 10);
        for (int b = 0; b < fit_.batch; ++b) {
            const auto key = static_cast<std::uint64_t>(number) *
                                 static_cast<std::uint64_t>(fit_.batch) +
                             static_cast<std::uint64_t>(b);
            const Random random = fit_.random.fork(key);
            add_frame(expression(random, mixed), random);
        }
        const double decay = std::pow(0.05, static_cast<double>(number) / fit_.steps);
        const auto by = [&](double rate) {
            return [rate](const std::string&) { return rate; };
        };
        adam_step(backend_, attributes_, g_attributes_, adam_attributes_, by(fit_.rate * decay));
        adam_step(backend_, deform_, g_deform_, adam_deform_, by(fit_.deform_rate * decay));
    }

    FittedLids result() const {
        const auto root = [&](const LidErrors& squares) {
            return LidErrors{std::sqrt(squares.attributes / seen_),
                             std::sqrt(squares.place / seen_)};
        };
        return {static_cast<Index>(points_.lids.size()), root(lids_), root(others_)};
    }

  private:
    /// Returns where an expression takes points, by the networks as they were.
    Columns<T> displaced(const FacePart<T>& part, const VecX<T>& expression) const {
        Columns<T> to = part.position;
        FieldTrace<T> trace;
        add_field(backend_, Field{deform_before_, Squash::tanh, reach_},
                  {part.code, part.influence, expression}, to, trace);
        return to;
    }
    /// Returns the steps of attributes, likewise.
    Columns<T> steps_before(const FacePart<T>& part, const VecX<T>& expression) const {
        Columns<T> to = Columns<T>::Zero(8, part.position.cols());
        FieldTrace<T> trace;
        add_field(backend_, Field{attributes_before_, Squash::none, gain_},
                  {part.feature, part.influence, expression}, to, trace);
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
            growth_of<T>(displaced(all_, with_lids_at(open, frames_.whole)),
                         displaced(all_, open), graph, fit_.most);
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

    /// Adds the gradients of a frame.
    void add_frame(const VecX<T>& expression, const Random& random) {
        if (static_cast<Index>(points_.lids.size()) <= fit_.lids)
            return add_lids(points_, expression, random);
        add_lids({points_, fit_.lids, random.fork(2).uniform(0)}, expression, random);
    }
    void add_lids(const LidPoints& lids, const VecX<T>& expression, const Random& random) {
        const VecX<T> open = with_lids_at(expression, 0);
        const FacePart<T> around = all_.of(lids.around);
        const Columns<T> resting = displaced(around, open);
        Columns<T> closing = displaced(around, expression);
        move_out_of_eyeballs(eyes_, fit_.clear, resting, closing);
        const std::vector<double> growth = growth_of<T>(closing, resting, lids.near, fit_.most);

        const auto count = static_cast<Index>(lids.lids.size());
        const auto rest = static_cast<Index>(points_.others.size());
        std::vector<Index> which = lids.lids;
        for (Index k = 0; k < std::min(fit_.others, rest); ++k)
            which.push_back(points_.others[static_cast<std::size_t>(
                random.below(4 + static_cast<std::uint64_t>(k), rest))]);
        const FacePart<T> part = all_.of(which);
        Columns<T> steps = steps_before(part, expression);
        const Columns<T> at_rest = steps_before(part, open);
        for (Index i = 0; i < count; ++i)
            for (Index k = 0; k < 3; ++k) { // pictures of lids that close have taught some of it
                const T grown = at_rest(k, i) + T(std::log(growth[static_cast<std::size_t>(i)]));
                steps(k, i) = std::max(steps(k, i), grown);
            }
        Columns<T> places = displaced(part, expression);
        places.leftCols(count) = closing.leftCols(count);

        pull(Field{attributes_, Squash::none, gain_}, {part.feature, part.influence, expression},
             {count, steps, &LidErrors::attributes}, Columns<T>::Zero(8, part.position.cols()),
             g_attributes_);
        pull(Field{deform_, Squash::tanh, reach_}, {part.code, part.influence, expression},
             {count, places, &LidErrors::place}, part.position, g_deform_);
        if (reported_) ++seen_;
    }

    /// What a field is to give, lids first, and the error that tells how well it does.
    struct Wanted {
        Index lids;
        const Columns<T>& sum;
        double LidErrors::* error;
    };
    /// Adds the gradient of the mean squared difference of what a field is added to from `wanted`.
    template <class A>
    void pull(const Field<T, A>& field, const FieldInput<T>& input, const Wanted& wanted,
              Columns<T> sum, Network& gradient) {
        FieldTrace<T> trace;
        add_field(backend_, field, input, sum, trace);
        sum -= wanted.sum;
        if (reported_) {
            const auto mean = [](const auto& part) {
                return static_cast<double>(part.squaredNorm()) / static_cast<double>(part.size());
            };
            lids_.*wanted.error += mean(sum.leftCols(wanted.lids));
            others_.*wanted.error += mean(sum.rightCols(sum.cols() - wanted.lids));
        }
        const Columns<T> g = T(2.0 / (fit_.batch * static_cast<double>(sum.cols()))) * sum;
        field_vjp(backend_, field, {input.lambda, input.frame, trace}, g, {&gradient});
    }

    const B& backend_;
    const LidFit& fit_;
    const LidFrames<T>& frames_;
    T gain_, reach_; ///< of the fields
    LidEyeballs<T> eyes_;
    FacePart<T> all_;
    Network attributes_before_, deform_before_;
    LidPoints points_;
    Network attributes_, deform_, g_attributes_, g_deform_;
    Adam<Network> adam_attributes_, adam_deform_;
    bool reported_ = false;
    LidErrors lids_, others_; ///< sums of squares
    double seen_ = 0;         ///< frames in these
};

} // namespace detail

/// Fits exp_attributes and exp_deform of the face. `mixed` returns the expression of a mixed frame
/// by a Random. Nothing is done without steps, without blinks, or if a whole blink moves nothing
/// apart. Fitted again, what is fitted changes little.
template <Real T, EffectSet E, Backend B, class Mixed>
    requires (has_effect<E, Expression>)
FittedLids fit_lids(const B& backend, TwoStream<T, E>& avatar, const AvatarConfig& config,
                    const LandmarkRoles& roles, const std::type_identity_t<LidFrames<T>>& frames,
                    const Mixed& mixed, const LidFit& fit) {
    if (fit.steps == 0 || frames.blinks.empty() || !(frames.whole > 0) ||
        avatar.face.position.cols() < 5)
        return {};
    detail::LidFitter<T, E, B> fitter(backend, avatar, config, roles, frames, fit);
    if (fitter.points().lids.empty() || fitter.points().others.empty()) return {};
    for (int step = 0; step < fit.steps; ++step) fitter.step(step, mixed);
    avatar.face.exp_attributes = fitter.attributes();
    avatar.face.networks.exp_deform = fitter.deform();
    return fitter.result();
}

} // namespace rye
