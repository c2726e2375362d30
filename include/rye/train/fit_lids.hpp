// SPDX-License-Identifier: Apache-2.0
/// rye/train/fit_lids.hpp: fit, at the end of stage 2, of what expressions do to lids that close.
/// These stretch: their Gaussians move apart, and the eyeball shows between them; and some of them
/// pass through the eyeball, where only landmarks at the rims were fitted. Few pictures blink, so
/// that they do not teach it. The networks of the expression are fitted to scales that grow with the
/// distance to the neighbours and to places before the eyeball; elsewhere, and with open lids, to
/// what they gave before. Not in the paper: docs/deviations.md.
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
    for (Index e = 0; e < 2; ++e)
        balls.radius[static_cast<std::size_t>(e)] =
            eyes.position.middleCols(eyes.first_point(e), eyes.points_of(e)).colwise().norm().mean();
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

/// Least growth by a whole blink of a point that is fitted.
inline constexpr double least_growth = 1.1;
/// Share of the frames that are mixed ones; the others are the capture's.
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

/// Returns the expression with these coefficients at 0.
template <class T>
VecX<T> with_open_lids(VecX<T> expression, const std::vector<Index>& blinks) {
    for (const Index k : blinks) expression[k] = T(0);
    return expression;
}

/// Returns how far apart points are in one frame relative to another: for each point the mean of
/// the squared distances to its neighbours, at least 1 and at most `most`. Columns of both are the
/// points, then neighbours; near: places of the four of each of `count` points.
template <class T>
std::vector<double> growth_of(const Columns<T>& apart, const Columns<T>& before,
                              const std::vector<std::array<Index, 4>>& near, double most) {
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

} // namespace detail

/// Fits exp_attributes and exp_deform of the face. `mixed` returns the expression of a mixed frame
/// by a Random. Nothing is done without steps, without blinks, or if a whole blink moves nothing
/// apart. Fitted again, what is fitted changes little.
template <Real T, EffectSet E, Backend B, class Mixed>
    requires (has_effect<E, Expression>)
FittedLids fit_lids(const B& backend, TwoStream<T, E>& avatar, const AvatarConfig& config,
                    const LandmarkRoles& roles, const std::type_identity_t<LidFrames<T>>& frames,
                    const Mixed& mixed, const LidFit& fit) {
    FaceStream<T, E>& face = avatar.face;
    const std::vector<Index>& blinks = frames.blinks;
    const std::vector<VecX<T>>& expressions = frames.expressions;
    const LidEyeballs<T> eyes = lid_eyeballs(avatar.eyes);
    FittedLids result;
    if (fit.steps == 0 || blinks.empty() || !(frames.whole > 0) || face.position.cols() < 5)
        return result;
    const detail::FacePart<T> all = detail::whole_face<T>(backend, face, config, roles);
    const NeighbourGraph graph = four_nearest_by_grid(backend, face.position);
    const auto displaced = [&](const detail::FacePart<T>& part, const VecX<T>& expression) {
        Columns<T> to = part.position;
        FieldTrace<T> trace;
        add_field(backend,
                  Field{face.networks.exp_deform, Squash::tanh, T(config.deform_scale)},
                  {part.code, part.influence, expression}, to, trace);
        return to;
    };

    // Points that a whole blink moves apart, and their neighbours.
    std::vector<Index> lids, others;
    VecX<T> closed = VecX<T>::Zero(expressions.front().size());
    for (const Index k : blinks) closed[k] = T(frames.whole);
    const std::vector<double> by_blink =
        detail::growth_of<T>(displaced(all, closed),
                             displaced(all, detail::with_open_lids(closed, blinks)), graph, fit.most);
    for (const Index i : influenced(backend, all.influence))
        (by_blink[static_cast<std::size_t>(i)] > detail::least_growth ? lids : others).push_back(i);
    result.points = static_cast<Index>(lids.size());
    if (lids.empty() || others.empty()) return result;
    std::vector<Index> with_neighbours = lids, place(graph.size(), -1);
    for (std::size_t k = 0; k < lids.size(); ++k)
        place[static_cast<std::size_t>(lids[k])] = static_cast<Index>(k);
    std::vector<std::array<Index, 4>> near(lids.size());
    for (std::size_t k = 0; k < lids.size(); ++k)
        for (std::size_t n = 0; n < 4; ++n) {
            const Index j = graph[static_cast<std::size_t>(lids[k])][n];
            Index& at = place[static_cast<std::size_t>(j)];
            if (at < 0) {
                at = static_cast<Index>(with_neighbours.size());
                with_neighbours.push_back(j);
            }
            near[k][n] = at;
        }
    const detail::FacePart<T> around = all.of(with_neighbours);
    const Index count = result.points, rest = std::min(fit.others,
                                                       static_cast<Index>(others.size()));

    using Network = std::remove_cvref_t<decltype(face.exp_attributes)>;
    const Network before = face.exp_attributes;
    const T gain = T(config.attribute_scale), reach = T(config.deform_scale);
    Network attributes = before, deform = face.networks.exp_deform;
    Network g_attributes = zeros_like(attributes), g_deform = zeros_like(deform);
    Adam<Network> adam_attributes(attributes), adam_deform(deform);
    LidErrors lid_squares, other_squares;
    double seen = 0;
    for (int step = 0; step < fit.steps; ++step) {
        set_zero(backend.threads, g_attributes);
        set_zero(backend.threads, g_deform);
        const bool reported = step >= fit.steps - std::max(1, fit.steps / 10);
        for (int b = 0; b < fit.batch; ++b) {
            const Random random = fit.random.fork(static_cast<std::uint64_t>(step) *
                                                      static_cast<std::uint64_t>(fit.batch) +
                                                  static_cast<std::uint64_t>(b));
            VecX<T> expression = expressions[static_cast<std::size_t>(
                random.below(0, static_cast<Index>(expressions.size())))];
            if (random.uniform(1) < detail::mixed_lids) {
                expression = mixed(random.fork(1));
                if (random.uniform(2) < detail::blinking_lids)
                    for (const Index k : blinks)
                        expression[k] = T(frames.whole * std::sqrt(random.uniform(3)));
            }
            const VecX<T> open = detail::with_open_lids(expression, blinks);
            const Columns<T> resting = displaced(around, open);
            Columns<T> closing = displaced(around, expression);
            move_out_of_eyeballs(eyes, fit.clear, resting, closing);
            const std::vector<double> growth =
                detail::growth_of<T>(closing, resting, near, fit.most);

            std::vector<Index> which = lids;
            for (Index k = 0; k < rest; ++k)
                which.push_back(others[static_cast<std::size_t>(
                    random.below(4 + static_cast<std::uint64_t>(k),
                                 static_cast<Index>(others.size())))]);
            const detail::FacePart<T> part = all.of(which);
            const Index n = count + rest;
            const T share = T(2.0 / (static_cast<double>(fit.batch) * static_cast<double>(n)));
            FieldTrace<T> trace;
            // Adds the gradient of the mean squared difference of a field's sum from what is wanted.
            const auto pull = [&](const Network& network, Squash squash, T by,
                                  const Columns<T>& inputs, const Columns<T>& wanted, Columns<T> sum,
                                  double LidErrors::* error, Network& gradient) {
                const Field field{network, squash, by};
                add_field(backend, field, {inputs, part.influence, expression}, sum, trace);
                sum -= wanted;
                if (reported) {
                    const double rows = static_cast<double>(sum.rows());
                    lid_squares.*error += static_cast<double>(sum.leftCols(count).squaredNorm()) /
                                          (rows * static_cast<double>(count));
                    other_squares.*error += static_cast<double>(sum.rightCols(rest).squaredNorm()) /
                                            (rows * static_cast<double>(rest));
                }
                const Columns<T> g = share * sum;
                field_vjp(backend, field, {part.influence, expression, trace}, g, {&gradient});
            };
            const auto steps_before = [&](const VecX<T>& code) {
                Columns<T> sum = Columns<T>::Zero(8, n);
                add_field(backend, Field{before, Squash::none, gain},
                          {part.feature, part.influence, code}, sum, trace);
                return sum;
            };
            Columns<T> wanted = steps_before(expression);
            const Columns<T> at_rest = steps_before(open);
            for (Index i = 0; i < count; ++i)
                for (Index k = 0; k < 3; ++k) // pictures of lids that close have taught some of it
                    wanted(k, i) = std::max(
                        wanted(k, i),
                        at_rest(k, i) + T(std::log(growth[static_cast<std::size_t>(i)])));
            pull(attributes, Squash::none, gain, part.feature, wanted, Columns<T>::Zero(8, n),
                 &LidErrors::attributes, g_attributes);
            Columns<T> places = displaced(part, expression);
            places.leftCols(count) = closing.leftCols(count);
            pull(deform, Squash::tanh, reach, part.code, places, part.position, &LidErrors::place,
                 g_deform);
            if (reported) ++seen;
        }
        const double decay = std::pow(0.05, static_cast<double>(step) / fit.steps);
        const auto by = [&](double rate) {
            return [rate](const std::string&) { return rate; };
        };
        adam_step(backend, attributes, g_attributes, adam_attributes, by(fit.rate * decay));
        adam_step(backend, deform, g_deform, adam_deform, by(fit.deform_rate * decay));
    }
    face.exp_attributes = std::move(attributes);
    face.networks.exp_deform = std::move(deform);
    const auto root = [&](const LidErrors& squares) {
        return LidErrors{std::sqrt(squares.attributes / seen), std::sqrt(squares.place / seen)};
    };
    result.lids = root(lid_squares);
    result.others = root(other_squares);
    return result;
}

} // namespace rye
