// SPDX-License-Identifier: Apache-2.0
/// rye/train/refine_labels.hpp: refinement of a frame's labels (gazes, head pose, expression) by
/// its photographs, with a trained avatar that is not changed: Gauss-Newton steps with Levenberg's
/// damping; the pictures' derivatives by forward mode of the rasterizer.
///     LabelRefiner refiner(backend, avatar, config, roles, unknowns);
///     const RefinedLabels found = refiner.refine(drivers, views);
///     moved_drivers(drivers, unknowns, found.change)
/// Unknowns are in units of their priors: 1 is one sigma from the label and costs 1. The cost of
/// the pixels is Huber's, over the residuals' variance, which each round estimates anew from their
/// median.
/// Derivatives of the driven Gaussians are central differences by DriveCache, which recomputes only
/// what a driver moves; those of pictures are exact.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include <rye/interactive/drive_cache.hpp>
#include <rye/math/levenberg.hpp>
#include <rye/rig/gaze.hpp>
#include <rye/splat/jvp.hpp>

namespace rye {

/// Effects whose labels are refined: two eyes that turn, a head pose and an expression.
template <class E>
concept RefinedEffects =
    KeptFromFrameToFrame<E> && eye_turns<E, 0> && eye_turns<E, 1> && has_effect<E, HeadPose> &&
    has_effect<E, ReadsHeadPose> && has_effect<E, ReadsExpression>;

/// Unknowns of a frame and the standard deviations of their priors.
struct LabelUnknowns {
    bool gaze = true;              ///< pitch and yaw of both eyes, 4 unknowns
    bool pose = true;              ///< axis-angle and translation, 6 unknowns
    std::vector<Index> expression; ///< refined coefficients, ascending
    double gaze_sigma = 0.07;      ///< angle of a gaze [rad]
    double rotation_sigma = 0.0175; ///< entry of the axis-angle [rad]
    double translation_sigma = 0.02; ///< coordinate of the translation [world unit]
    double expression_sigma = 0.1; ///< coefficient of the expression

    Index gaze_count() const { return gaze ? 4 : 0; }
    Index pose_count() const { return pose ? 6 : 0; }
    /// Returns the number of unknowns, n: the gazes' (left pitch, yaw, right pitch, yaw), the
    /// pose's, the expression's.
    Index count() const {
        return gaze_count() + pose_count() + static_cast<Index>(expression.size());
    }
    /// Returns the standard deviations of the unknowns, n.
    VecX<double> sigma() const {
        VecX<double> s(count());
        s.head(gaze_count()).setConstant(gaze_sigma);
        if (pose) {
            s.segment(gaze_count(), 3).setConstant(rotation_sigma);
            s.segment(gaze_count() + 3, 3).setConstant(translation_sigma);
        }
        s.tail(static_cast<Index>(expression.size())).setConstant(expression_sigma);
        return s;
    }
};

/// Returns the direction after changes of its pitch and yaw [rad].
template <Scalar T>
Vec3<T> moved_gaze(const Vec3<T>& gaze, const T& pitch, const T& yaw) {
    const Vec2<T> angles = pitch_yaw(gaze);
    return gaze_vector<T>(angles[0] + pitch, angles[1] + yaw);
}

/// Returns the drivers after changes, n, in the order of LabelUnknowns.
template <class T, EffectSet E, class Change>
Drivers<T, E> moved_drivers(const Drivers<T, E>& label, const LabelUnknowns& u,
                            const Eigen::MatrixBase<Change>& change) {
    Drivers<T, E> d = label;
    const auto at = [&](Index k) { return T(change[k]); };
    Index k = 0;
    if (u.gaze)
        for (std::size_t eye = 0; eye < 2; ++eye, k += 2)
            d.gaze[eye] = moved_gaze<T>(label.gaze[eye], at(k), at(k + 1));
    if (u.pose)
        for (Index i = 0; i < 6; ++i) d.pose[i] += at(k++);
    for (const Index i : u.expression) d.expression[i] += at(k++);
    return d;
}

/// Photograph of a frame: colours on the background, and weights of pixels.
template <class T>
struct LabelView {
    Pinhole<T> camera;
    Columns<T> truth;      ///< 3 x pixels
    Columns<T> weight;     ///< 1 x pixels, 0..1
    Vec3<T> background{T(1), T(1), T(1)};
};

/// Settings of LabelRefiner.
struct RefineSettings {
    LevenbergSettings levenberg = {};
    int rounds = 2;            ///< each with its own estimate of the variance
    double huber = 1.5;        ///< residual beyond which its cost is linear [standard deviations]
    double alike = 12;         ///< number of residuals that err together, and so count as one
    double least_noise = 0.002; ///< smallest standard deviation of a residual [colour]
    double difference = 0.1;   ///< step of the central differences [sigma]
};

/// Result of a refinement.
struct RefinedLabels {
    VecX<double> change;  ///< of the labels, n, in the order and units of LabelUnknowns
    VecX<double> sigma;   ///< standard deviations, n, from (J^T J + priors)^-1
    double first_cost = 0, cost = 0; ///< at the label and at the end, both by the last variance
    double first_residual = 0, residual = 0; ///< RMS at the label, at the end [colour]
    double noise = 0;     ///< standard deviation of a residual, from the median [colour]
    int steps = 0, refused = 0;
    bool settled = false; ///< true if further steps would change little
};

/// Refinement of the labels of frames of one avatar, which must not change.
template <Backend B, Real T, RefinedEffects E, AccuracyPolicy A = FeaturesOnly<Balanced>>
class LabelRefiner {
  public:
    /// Keeps references: the avatar, its configuration and roles must outlive the refiner.
    LabelRefiner(const B& backend, const TwoStream<T, E>& avatar,
                 std::reference_wrapper<const AvatarConfig> config,
                 std::reference_wrapper<const LandmarkRoles> roles, LabelUnknowns unknowns,
                 RefineSettings settings = {}, const Rasterizer<A>& rasterizer = {})
        : backend_(backend),
          cache_(backend, avatar, config, roles),
          unknowns_(std::move(unknowns)),
          settings_(settings),
          rasterizer_(rasterizer),
          sigma_(unknowns_.sigma()) {
        require(unknowns_.count() > 0, "LabelRefiner", "got no unknowns, expected one or more");
        for (const Index i : unknowns_.expression)
            require(i >= 0 && i < config.get().expression, "LabelRefiner",
                    "got expression coefficient " + std::to_string(i) + ", expected 0 to " +
                        std::to_string(config.get().expression - 1));
        require(sigma_.allFinite() && sigma_.minCoeff() > 0, "LabelRefiner",
                "got a prior's sigma that is not positive");
    }

    /// Refines the labels of a frame. Throws an Error if no pixel counts or the avatar at its label
    /// is not finite.
    RefinedLabels refine(const Drivers<T, E>& label, const std::vector<LabelView<T>>& views) {
        const std::vector<std::vector<Index>> used = used_pixels(views);
        RefinedLabels r;
        VecX<double> x = VecX<double>::Zero(unknowns_.count());
        NormalEquations<double> last;
        for (int round = 0; round < std::max(1, settings_.rounds); ++round) {
            const std::vector<Columns<T>> residuals = residuals_at(label, views, used, x);
            if (round == 0) r.first_residual = rms(residuals, views, used);
            require(round > 0 || std::isfinite(r.first_residual), "LabelRefiner",
                    "the avatar at the frame's label is not finite");
            noise_ = estimated_noise(residuals);
            const auto found = levenberg<double>(
                x, settings_.levenberg,
                [&](const VecX<double>& at) { return linearized(label, views, used, at); },
                [&](const VecX<double>& at) { return cost(label, views, used, at); });
            x = found.x;
            r.steps += found.steps;
            r.refused += found.refused;
            r.settled = found.settled;
            last = found.at;
        }
        r.cost = last.cost;
        r.first_cost = cost(label, views, used, VecX<double>::Zero(x.size()));
        r.residual = rms(residuals_at(label, views, used, x), views, used);
        r.noise = noise_;
        r.change = x.cwiseProduct(sigma_);
        r.sigma = covariance<double>(last.matrix).diagonal().cwiseSqrt().cwiseProduct(sigma_);
        return r;
    }

    /// Returns the derivatives of a view's colours with respect to the unknowns: three rows
    /// (channels) for each pixel in `pixels`, a column per unknown [colour per sigma of its prior].
    Columns<T> jacobian(const Drivers<T, E>& label, const LabelView<T>& view,
                        const std::vector<Index>& pixels, const VecX<double>& x) {
        const std::vector<Gaussians<T>> tangents = tangents_at(label, x);
        const Gaussians<T> g = colours(drive(label, x));
        return jacobian_of(g, tangents, view, pixels);
    }

    const LabelUnknowns& unknowns() const { return unknowns_; }

  private:
    /// Returns the Gaussians with their first three features.
    static Gaussians<T> colours(const Gaussians<T>& g) {
        Gaussians<T> c;
        c.mean = g.mean;
        c.rotation = g.rotation;
        c.scale = g.scale;
        c.opacity = g.opacity;
        c.feature = g.feature.topRows(3);
        return c;
    }

    Drivers<T, E> drivers_at(const Drivers<T, E>& label, const VecX<double>& x) const {
        return moved_drivers(label, unknowns_, x.cwiseProduct(sigma_));
    }
    const Gaussians<T>& drive(const Drivers<T, E>& label, const VecX<double>& x) {
        return cache_.update(drivers_at(label, x));
    }

    /// Returns the derivatives of the driven Gaussians with respect to each unknown.
    std::vector<Gaussians<T>> tangents_at(const Drivers<T, E>& label, const VecX<double>& x) {
        std::vector<Gaussians<T>> tangents;
        const double h = settings_.difference;
        for (Index k = 0; k < x.size(); ++k) {
            VecX<double> at = x;
            at[k] = x[k] + h;
            Gaussians<T> t = colours(drive(label, at));
            at[k] = x[k] - h;
            const Gaussians<T> before = colours(drive(label, at));
            Gaussians<T>::fields(
                [&](const std::string&, auto& to, const auto& from) {
                    to = (to - from) * T(1 / (2 * h));
                },
                t, before);
            tangents.push_back(std::move(t));
        }
        return tangents;
    }

    Columns<T> jacobian_of(const Gaussians<T>& g, const std::vector<Gaussians<T>>& tangents,
                           const LabelView<T>& view, const std::vector<Index>& pixels) {
        Columns<T> j(3 * static_cast<Index>(pixels.size()), static_cast<Index>(tangents.size()));
        const VecX<T> background = view.background;
        for (std::size_t k = 0; k < tangents.size(); ++k) {
            const RasterTangents<T> direction{.gaussians = &tangents[k], .camera = nullptr};
            rasterizer_.jvp_into(backend_, g, direction, view.camera, background, drawn_,
                                 &scratch_);
            for (std::size_t i = 0; i < pixels.size(); ++i)
                j.template block<3, 1>(3 * static_cast<Index>(i), static_cast<Index>(k)) =
                    drawn_.feature.col(pixels[i]);
        }
        return j;
    }

    static std::vector<std::vector<Index>> used_pixels(const std::vector<LabelView<T>>& views) {
        std::vector<std::vector<Index>> used;
        std::size_t all = 0;
        for (const LabelView<T>& v : views) {
            const Index pixels = static_cast<Index>(v.camera.width) * v.camera.height;
            require(v.truth.rows() == 3 && v.truth.cols() == pixels && v.weight.rows() == 1 &&
                        v.weight.cols() == pixels,
                    "LabelRefiner", "a photograph has not the size of its camera");
            used.emplace_back();
            for (Index p = 0; p < pixels; ++p)
                if (v.weight(0, p) > T(0)) used.back().push_back(p);
            all += used.back().size();
        }
        require(all > 0, "LabelRefiner", "got no pixel whose weight is above 0");
        return used;
    }

    /// Returns render minus photograph, 3 x used pixels per view.
    std::vector<Columns<T>> residuals_at(const Drivers<T, E>& label,
                                         const std::vector<LabelView<T>>& views,
                                         const std::vector<std::vector<Index>>& used,
                                         const VecX<double>& x) {
        const Gaussians<T> g = colours(drive(label, x));
        std::vector<Columns<T>> residuals;
        for (std::size_t v = 0; v < views.size(); ++v)
            residuals.push_back(residual_of(g, views[v], used[v]));
        return residuals;
    }
    /// Returns the residual of one view; NaN if Gaussians are not finite, which would draw nothing.
    Columns<T> residual_of(const Gaussians<T>& g, const LabelView<T>& view,
                           const std::vector<Index>& pixels) {
        rasterizer_.forward_into(backend_, g, view.camera, VecX<T>(view.background), raster_,
                                 &scratch_);
        Columns<T> r(3, static_cast<Index>(pixels.size()));
        if (raster_.trace.non_finite > 0)
            return Columns<T>::Constant(r.rows(), r.cols(), std::numeric_limits<T>::quiet_NaN());
        for (std::size_t i = 0; i < pixels.size(); ++i)
            r.col(static_cast<Index>(i)) =
                raster_.feature.pixels.col(pixels[i]) - view.truth.col(pixels[i]);
        return r;
    }

    static double rms(const std::vector<Columns<T>>& residuals,
                      const std::vector<LabelView<T>>& views,
                      const std::vector<std::vector<Index>>& used) {
        double sum = 0, weights = 0;
        for (std::size_t v = 0; v < views.size(); ++v)
            for (std::size_t i = 0; i < used[v].size(); ++i) {
                const auto w = static_cast<double>(views[v].weight(0, used[v][i]));
                sum += w * residuals[v].col(static_cast<Index>(i)).template cast<double>()
                               .squaredNorm();
                weights += 3 * w;
            }
        return std::sqrt(sum / weights);
    }

    /// Returns 1.4826 times the median of the absolute residuals: the standard deviation of normal
    /// ones.
    double estimated_noise(const std::vector<Columns<T>>& residuals) const {
        std::vector<T> sizes;
        for (const Columns<T>& r : residuals)
            for (Index i = 0; i < r.size(); ++i) sizes.push_back(std::abs(r.data()[i]));
        const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
        std::nth_element(sizes.begin(), middle, sizes.end());
        return std::max(settings_.least_noise, 1.4826 * static_cast<double>(*middle));
    }

    /// Returns Huber's cost of a residual, in units of the noise.
    double huber_cost(double r) const {
        const double size = std::abs(r), d = settings_.huber;
        return size <= d ? r * r : d * (2 * size - d);
    }
    /// Returns the weight of a residual's square in the normal equations.
    double huber_weight(double r) const {
        const double size = std::abs(r);
        return size <= settings_.huber ? 1 : settings_.huber / size;
    }

    double cost(const Drivers<T, E>& label, const std::vector<LabelView<T>>& views,
                const std::vector<std::vector<Index>>& used, const VecX<double>& x) {
        const Gaussians<T> g = colours(drive(label, x));
        double sum = x.squaredNorm();
        for (std::size_t v = 0; v < views.size(); ++v) {
            const Columns<T> r = residual_of(g, views[v], used[v]);
            const double part = sum_chunks(
                backend_.threads, r.cols(), chunk, 0.0, [&](Index b, Index e) {
                    double s = 0;
                    for (Index i = b; i < e; ++i) {
                        double c = 0;
                        for (Index k = 0; k < 3; ++k)
                            c += huber_cost(static_cast<double>(r(k, i)) / noise_);
                        s += weight_of(views[v], used[v], i) * c;
                    }
                    return s;
                });
            sum += part / settings_.alike;
        }
        return sum;
    }

    NormalEquations<double> linearized(const Drivers<T, E>& label,
                                       const std::vector<LabelView<T>>& views,
                                       const std::vector<std::vector<Index>>& used,
                                       const VecX<double>& x) {
        const std::vector<Gaussians<T>> tangents = tangents_at(label, x);
        const Gaussians<T> g = colours(drive(label, x));
        const Index n = x.size();
        // Matrix, gradient and cost side by side, starting with those of the priors.
        Columns<double> sums = Columns<double>::Zero(n + 1, n + 1);
        sums.topLeftCorner(n, n).setIdentity();
        sums.row(n).head(n) = x.transpose();
        double sum = x.squaredNorm();
        for (std::size_t v = 0; v < views.size(); ++v) {
            const Columns<T> r = residual_of(g, views[v], used[v]);
            const Columns<T> j = jacobian_of(g, tangents, views[v], used[v]);
            const auto part = [&](Index b, Index e) -> Columns<double> {
                Columns<double> rows(3 * (e - b), n + 1);
                rows.leftCols(n) = j.middleRows(3 * b, 3 * (e - b)).template cast<double>();
                double costs = 0;
                for (Index i = b; i < e; ++i) {
                    const double pixel = weight_of(views[v], used[v], i);
                    for (Index k = 0; k < 3; ++k) {
                        const Index row = 3 * (i - b) + k;
                        const double scaled = static_cast<double>(r(k, i)) / noise_;
                        const double root = std::sqrt(pixel * huber_weight(scaled));
                        rows.row(row).head(n) *= root / noise_;
                        rows(row, n) = root * scaled;
                        costs += pixel * huber_cost(scaled);
                    }
                }
                Columns<double> square = rows.transpose() * rows;
                square(n, n) = costs;
                return square;
            };
            const Columns<double> none = Columns<double>::Zero(n + 1, n + 1);
            const Columns<double> all = sum_chunks(backend_.threads, r.cols(), chunk, none, part);
            sums += all / settings_.alike;
        }
        sum += sums(n, n);
        return {sum, sums.topLeftCorner(n, n), sums.row(n).head(n).transpose()};
    }

    static double weight_of(const LabelView<T>& view, const std::vector<Index>& pixels, Index i) {
        return static_cast<double>(view.weight(0, pixels[static_cast<std::size_t>(i)]));
    }

    static constexpr Index chunk = 1024; ///< pixels

    B backend_;
    DriveCache<B, T, E> cache_;
    LabelUnknowns unknowns_;
    RefineSettings settings_;
    Rasterizer<A> rasterizer_;
    VecX<double> sigma_;   ///< standard deviations of the priors, n
    double noise_ = 1;     ///< standard deviation of a residual [colour]
    RasterJvp<T, A::outputs> drawn_;
    Raster<T, A::outputs> raster_;
    RasterScratch<T> scratch_;
};

} // namespace rye
