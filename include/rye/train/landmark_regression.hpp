// SPDX-License-Identifier: Apache-2.0
/// rye/train/landmark_regression.hpp: displacements of landmarks as a linear function of expression
/// and gaze, with few coefficients per landmark. Blendshapes are linear and local: there are more
/// coefficients than, say, thirty frames, but few of them move one landmark. The regression then
/// holds for expressions that no frame has, and for eyes that look in different directions, unlike
/// a network fitted to the frames alone. Lids follow a gaze upward by another slope than downward.
/// Not in the paper: docs/deviations.md. Canonical units.
/// Source: ridge regression with a prior variance for each coefficient that is estimated from its
/// last value (iteratively reweighted least squares; FOCUSS, Gorodnitsky and Rao, 1997), so that
/// small coefficients vanish.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include <rye/avatar/weights.hpp>
#include <rye/core/random.hpp>
#include <rye/train/samples.hpp>

namespace rye {

/// Settings of the regression.
struct RegressionConfig {
    int iterations = 6;
    double ridge = 1e-3;    ///< of the squared residual, relative to a coefficient of variance 1
    double smallest = 3e-3; ///< displacement by a coefficient that counts as 0 [unit]
    /// E x L in (0, 1]: how far a coefficient of the expression may move a landmark, relative to
    /// the others (a brow's hardly moves a lip). Empty: all 1.
    Columns<double> expression_reach = {};
    /// E x 3 L, displacement (e, 3 l + axis) by a coefficient of 1 in a face model [unit]; the
    /// regression fits the remainder. Empty: unknown.
    Columns<double> expression_shapes = {};
    double noise = 0;       ///< standard deviation of what no regressor explains [unit]
    std::vector<Index> blinks = {}; ///< coefficients of the expression that close lids
};

namespace detail {

/// Solves A x = b in place for a symmetric positive definite A, n x n, and three columns of b.
/// Plain loops: the same bits for any width of vectors.
template <class A, class B>
void solve_positive(A& a, B& b) {
    const Index n = a.rows();
    for (Index j = 0; j < n; ++j) {
        double d = a(j, j);
        for (Index k = 0; k < j; ++k) d -= a(j, k) * a(j, k);
        a(j, j) = std::sqrt(d);
        for (Index i = j + 1; i < n; ++i) {
            double s = a(i, j);
            for (Index k = 0; k < j; ++k) s -= a(i, k) * a(j, k);
            a(i, j) = s / a(j, j);
        }
    }
    for (Index c = 0; c < b.cols(); ++c) {
        for (Index i = 0; i < n; ++i) {
            for (Index k = 0; k < i; ++k) b(i, c) -= a(i, k) * b(k, c);
            b(i, c) /= a(i, i);
        }
        for (Index i = n; i-- > 0;) {
            for (Index k = i + 1; k < n; ++k) b(i, c) -= a(k, i) * b(k, c);
            b(i, c) /= a(i, i);
        }
    }
}

/// Throws an Error for priors that do not fit E coefficients and L landmarks.
inline void require_prior(const RegressionConfig& config, Index expression, Index landmarks) {
    const auto require_rows = [&](const char* name, const Columns<double>& a, Index columns,
                                  bool good, const char* what) {
        require(a.size() == 0 || (a.rows() == expression && a.cols() == columns && good),
                "landmark_regression", "got an ", name, " of ", a.rows(), " x ", a.cols(),
                ", expected ", expression, " x ", columns, what);
    };
    const Columns<double>& reach = config.expression_reach;
    require_rows("expression_reach", reach, landmarks,
                 (reach.array() > 0 && reach.array() <= 1).all(), " numbers in (0, 1]");
    const Columns<double>& shapes = config.expression_shapes;
    require_rows("expression_shapes", shapes, 3 * landmarks, shapes.allFinite(), " finite numbers");
    for (const Index blink : config.blinks)
        require(blink >= 0 && blink < expression, "landmark_regression", "got coefficient ", blink,
                " among the blinks, expected one below ", expression);
}

} // namespace detail

namespace detail {

/// Regressors of an eye's gaze.
inline constexpr Index gaze_regressors = 3;
/// Reach of the third of them, by which slopes upward and downward differ, relative to the others:
/// small, as noise of the labels bends lines too.
inline constexpr double slope_reach = 0.2;

} // namespace detail

/// Returns the regressors of a frame: 1, the expression, and (pitch, yaw, |pitch|) [rad] of each
/// eye that the skin follows.
template <class T, EffectSet E>
std::vector<double> landmark_regressors(const Drivers<T, E>& drivers) {
    std::vector<double> x{1};
    if constexpr (has_effect<E, ReadsExpression>)
        for (Index i = 0; i < drivers.expression.size(); ++i)
            x.push_back(static_cast<double>(drivers.expression[i]));
    for_eyes([&]<std::size_t eye>() {
        if constexpr (detail::skin_follows<E, eye>) {
            const Vec2<T> angles = pitch_yaw(of_eye<eye>(drivers.gaze));
            for (const T& angle : {angles[0], angles[1]}) x.push_back(static_cast<double>(angle));
            x.push_back(std::abs(x[x.size() - 2]));
        }
    });
    return x;
}

/// Displacement of L landmarks: displacement(l, axis) = sum over k of coefficient(k, 3 l + axis)
/// x_k.
struct LandmarkRegression {
    Columns<double> coefficient; ///< K x 3 L [unit per unit of a regressor]
    bool knows_shapes = false;   ///< true if a face model gives a shape for every coefficient
    double largest = 0;          ///< largest weight of a coefficient in the frames, at least 0
    std::vector<Index> blinks;   ///< coefficients that close lids
    /// Largest weight of these in mixed frames: 1 if shapes are known, else that of the frames.
    double whole_blink = 0;

    /// Returns the displacement, 3 x L, by K regressors x.
    template <class T>
    Columns<T> displacement(const std::vector<double>& x) const {
        Columns<T> d(3, coefficient.cols() / 3);
        for (Index c = 0; c < coefficient.cols(); ++c) {
            double sum = 0;
            for (Index k = 0; k < coefficient.rows(); ++k)
                sum += coefficient(k, c) * x[static_cast<std::size_t>(k)];
            d(c % 3, c / 3) = static_cast<T>(sum);
        }
        return d;
    }
};

/// Fits the displacements of `frames` from the neutral landmarks, 3 x L. The prior of gaze at a
/// landmark follows its influence there: eyes that look the same way in all frames do not tell
/// which of them a lid follows. Throws an Error for frames with another number of landmarks, and
/// for an expression_reach or expression_shapes of another shape or with invalid values.
template <class T, EffectSet E, Backend B>
LandmarkRegression landmark_regression(const B& backend, const InfluenceInput<T>& neutral,
                                       const LandmarkRoles& roles,
                                       const std::vector<MeshSample<T, E>>& frames,
                                       const RegressionConfig& config = {}) {
    const Index n = static_cast<Index>(frames.size()), landmarks = neutral.landmarks.cols();
    std::vector<std::vector<double>> x;
    for (const MeshSample<T, E>& f : frames) {
        require(f.landmarks.cols() == landmarks, "landmark_regression", "got a frame of ",
                f.landmarks.cols(), " landmarks, expected ", landmarks);
        x.push_back(landmark_regressors(f.drivers));
    }
    LandmarkRegression r;
    if (n == 0) return r;
    const Index regressors = static_cast<Index>(x.front().size());
    // Largest prior variance of each regressor at each landmark.
    Columns<double> reach = Columns<double>::Ones(regressors, landmarks);
    if constexpr (has_effect<E, ReadsExpression>) {
        detail::require_prior(config, frames.front().drivers.expression.size(), landmarks);
        for (const MeshSample<T, E>& f : frames)
            if (f.drivers.expression.size() > 0)
                r.largest = std::max(r.largest,
                                     static_cast<double>(f.drivers.expression.maxCoeff()));
        r.blinks = config.blinks;
        for (const Index blink : config.blinks)
            for (const MeshSample<T, E>& f : frames)
                r.whole_blink = std::max(r.whole_blink,
                                         static_cast<double>(f.drivers.expression[blink]));
        if (config.expression_reach.size() > 0)
            reach.middleRows(1, config.expression_reach.rows()) = config.expression_reach;
    }
    const Columns<double>& shapes = config.expression_shapes;
    WeightsTrace<T, E> trace;
    const Weights<T, E> w = face_weights<T, E>(backend, neutral, roles, trace);
    Index row = regressors;
    for_eyes([&]<std::size_t eye>() {
        if constexpr (detail::skin_follows<E, eye>) row -= detail::gaze_regressors;
    });
    for_eyes([&]<std::size_t eye>() {
        if constexpr (detail::skin_follows<E, eye>) {
            for (Index l = 0; l < landmarks; ++l) {
                const double influence = static_cast<double>(of_eye<eye>(w.gaze)(0, l));
                reach(row, l) = reach(row + 1, l) = influence;
                reach(row + 2, l) = detail::slope_reach * influence;
            }
            row += detail::gaze_regressors;
        }
    });

    r.coefficient = Columns<double>::Zero(regressors, 3 * landmarks);
    const auto fit = [&](Index begin, Index end, Index) {
        Columns<double> a(n, n), b(n, 3), spread(n, regressors);
        std::vector<double> variance(static_cast<std::size_t>(regressors));
        for (Index l = begin; l < end; ++l) {
            for (Index k = 0; k < regressors; ++k)
                variance[static_cast<std::size_t>(k)] = reach(k, l) * reach(k, l);
            double ridge = std::max(config.ridge, config.noise * config.noise);
            for (int i = 0; i < config.iterations; ++i) {
                for (Index f = 0; f < n; ++f) {
                    for (Index k = 0; k < regressors; ++k)
                        spread(f, k) = x[static_cast<std::size_t>(f)][static_cast<std::size_t>(k)] *
                                       variance[static_cast<std::size_t>(k)];
                    for (Index g = 0; g <= f; ++g) {
                        double sum = f == g ? ridge : 0;
                        for (Index k = 0; k < regressors; ++k)
                            sum += spread(f, k) *
                                   x[static_cast<std::size_t>(g)][static_cast<std::size_t>(k)];
                        a(f, g) = sum;
                    }
                    for (Index axis = 0; axis < 3; ++axis) {
                        b(f, axis) = static_cast<double>(
                            frames[static_cast<std::size_t>(f)].landmarks(axis, l) -
                            neutral.landmarks(axis, l));
                        for (Index e = 0; e < shapes.rows(); ++e)
                            b(f, axis) -=
                                x[static_cast<std::size_t>(f)][static_cast<std::size_t>(1 + e)] *
                                shapes(e, 3 * l + axis);
                    }
                }
                detail::solve_positive(a, b);
                double most = 0;
                for (Index k = 0; k < regressors; ++k) {
                    double squares = 0;
                    for (Index axis = 0; axis < 3; ++axis) {
                        double sum = 0;
                        for (Index f = 0; f < n; ++f) sum += spread(f, k) * b(f, axis);
                        r.coefficient(k, 3 * l + axis) = sum;
                        squares += sum * sum;
                    }
                    double& v = variance[static_cast<std::size_t>(k)];
                    v = std::sqrt(squares / 3 + config.smallest * config.smallest) * reach(k, l);
                    most = std::max(most, v);
                }
                for (double& v : variance) v /= most;
                ridge = std::max(config.ridge, config.noise / most * (config.noise / most));
            }
        }
    };
    for_chunks(backend.threads, landmarks, 16, fit);
    r.knows_shapes = shapes.size() > 0;
    if (r.knows_shapes) r.whole_blink = 1;
    if (r.knows_shapes) r.coefficient.middleRows(1, shapes.rows()) += shapes;
    return r;
}

/// Returns the noise by which regressions of some of the frames predict the landmarks of the others
/// best (cross-validation): 0 for landmarks and expressions that agree, and for fewer than eight
/// frames. Regressions that know of no noise explain it by coefficients, and are off by several
/// times as much in frames that they have not seen.
template <class T, EffectSet E, Backend B>
double landmark_noise(const B& backend, const InfluenceInput<T>& neutral,
                      const LandmarkRoles& roles, const std::vector<MeshSample<T, E>>& frames,
                      RegressionConfig config = {}) {
    constexpr std::size_t parts = 4, fewest = 8;
    constexpr double clearly = 0.9; // less than this share of the error without noise
    if (frames.size() < fewest) return 0;
    const auto error = [&](double noise) {
        config.noise = noise;
        double sum = 0;
        for (std::size_t part = 0; part < parts; ++part) {
            std::vector<MeshSample<T, E>> seen;
            for (std::size_t f = 0; f < frames.size(); ++f)
                if (f % parts != part) seen.push_back(frames[f]);
            const LandmarkRegression r = landmark_regression(backend, neutral, roles, seen, config);
            for (std::size_t f = part; f < frames.size(); f += parts) {
                const Columns<T> got =
                    neutral.landmarks +
                    r.template displacement<T>(landmark_regressors(frames[f].drivers));
                sum += static_cast<double>((got - frames[f].landmarks).squaredNorm());
            }
        }
        return std::sqrt(sum);
    };
    double best = 0, least = clearly * error(0);
    for (const double noise : {0.0025, 0.005, 0.01, 0.015, 0.02, 0.03, 0.05})
        if (const double e = error(noise); e < least) {
            least = e;
            best = noise;
        }
    return best;
}

/// Returns a frame that `frames` do not show, with the landmarks of the regression: each
/// coefficient of the expression is that of one of two frames, or 0; if its shape is known, one in
/// eight is any coefficient of any frame, and one in eight is any number up to the largest that a
/// frame has, so that coefficients that no frame has occur too. In 3 of 10 frames lids close, by
/// any share up to whole_blink, both alike but for one in five: most captures hardly blink. Each
/// eye looks as in a frame of its own, up to 1.3 times as far aside. Poses are those of the first
/// frame. `random`: for this frame alone.
template <class T, EffectSet E>
MeshSample<T, E> mixed_frame(const std::vector<MeshSample<T, E>>& frames,
                             const LandmarkRegression& regression, const Columns<T>& neutral,
                             const Random& random) {
    const auto any = [&](std::uint64_t draw) -> const MeshSample<T, E>& {
        return frames[static_cast<std::size_t>(
            random.below(draw, static_cast<Index>(frames.size())))];
    };
    const MeshSample<T, E>& first = any(0);
    const MeshSample<T, E>& second = any(1);
    MeshSample<T, E> mixed;
    mixed.drivers = first.drivers;
    mixed.eye_displacement = first.eye_displacement;
    if constexpr (has_effect<E, ReadsExpression>)
        for (Index i = 0; i < mixed.drivers.expression.size(); ++i) {
            const Random own = random.fork(8 + static_cast<std::uint64_t>(i));
            const double u = random.uniform(8 + static_cast<std::uint64_t>(i));
            if (u < 0.25)
                mixed.drivers.expression[i] = T(0);
            else if (u < 0.625)
                mixed.drivers.expression[i] = second.drivers.expression[i];
            else if (regression.knows_shapes && u >= 0.875)
                mixed.drivers.expression[i] = T(regression.largest * own.uniform(0));
            else if (regression.knows_shapes && u >= 0.75)
                mixed.drivers.expression[i] =
                    frames[static_cast<std::size_t>(
                               own.below(0, static_cast<Index>(frames.size())))]
                        .drivers.expression[own.below(1, mixed.drivers.expression.size())];
        }
    if constexpr (has_effect<E, ReadsExpression>) {
        constexpr double blinking = 0.3, winking = 0.2;
        const Random own = random.fork(6);
        if (own.uniform(0) < blinking)
            for (std::size_t k = 0; k < regression.blinks.size(); ++k) {
                const double share = own.uniform(2 + 2 * k) < winking
                                         ? own.uniform(3 + 2 * k) : std::sqrt(own.uniform(1));
                mixed.drivers.expression[regression.blinks[k]] =
                    T(regression.whole_blink * share);
            }
    }
    for_eyes([&]<std::size_t eye>() {
        if constexpr (detail::skin_follows<E, eye>) {
            const Vec2<T> angles = pitch_yaw(of_eye<eye>(any(2 + eye).drivers.gaze));
            const T share = T(0.5 + 0.8 * random.uniform(4 + eye));
            of_eye<eye>(mixed.drivers.gaze) =
                gaze_vector(T(share * angles[0]), T(share * angles[1]));
        }
    });
    mixed.landmarks =
        neutral + regression.template displacement<T>(landmark_regressors(mixed.drivers));
    return mixed;
}

} // namespace rye
