// SPDX-License-Identifier: Apache-2.0
/// rye/train/refine_labels.hpp: refinement of a frame's labels (gazes, head pose, expression) by
/// its photographs, with a trained avatar that is not changed: Gauss-Newton steps with Levenberg's
/// damping; the pictures' derivatives by forward mode of the rasterizer.
///     HostLabelDrawing drawing(backend, avatar, config, roles);  // or DeviceLabelDrawing
///     LabelRefiner refiner(backend.threads, drawing, unknowns);
///     const RefinedLabels found = refiner.refine(drivers, views);
///     moved_drivers(drivers, unknowns, found.change)
/// Unknowns are in units of their priors: 1 is one sigma from the label and costs 1. The cost of
/// the pixels is Huber's, over the residuals' variance, which each round estimates anew from their
/// median.
/// Derivatives of the driven Gaussians are differences; those of pictures are exact.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <rye/core/parallel.hpp>
#include <rye/math/levenberg.hpp>
#include <rye/train/label_drawing.hpp>

namespace rye {

/// Settings of LabelRefiner.
struct RefineSettings {
    LevenbergSettings levenberg = {};
    int rounds = 2;             ///< each with its own estimate of the variance
    double huber = 1.5;         ///< residual beyond which its cost is linear [standard deviations]
    double alike = 12;          ///< number of residuals that err together, and so count as one
    double least_noise = 0.002; ///< smallest standard deviation of a residual [colour]
    double difference = 0.1;    ///< step of the differences [sigma]
};

/// Result of a refinement.
struct RefinedLabels {
    VecX<double> change;             ///< of the labels, n, in the order and units of LabelUnknowns
    VecX<double> sigma;              ///< standard deviations, n, from (J^T J + priors)^-1
    double first_cost = 0, cost = 0; ///< at the label and at the end, both by the last variance
    double first_residual = 0, residual = 0; ///< RMS at the label, at the end [colour]
    double noise = 0; ///< standard deviation of a residual, from the median [colour]
    int steps = 0, refused = 0;
    bool settled = false; ///< true if further steps would change little
};

/// Refinement of the labels of frames of one avatar, which must not change.
template <Threads P, LabelDrawing D>
class LabelRefiner {
  public:
    using Number = typename D::Number;
    using Labels = typename D::Labels;

    /// Keeps a reference to the drawing.
    LabelRefiner(const P& threads, D& drawing, LabelUnknowns unknowns, RefineSettings settings = {})
        : threads_(threads),
          drawing_(&drawing),
          unknowns_(std::move(unknowns)),
          settings_(settings),
          sigma_(unknowns_.sigma()) {
        require(unknowns_.count() > 0, "LabelRefiner", "got no unknowns, expected one or more");
        for (const Index i : unknowns_.expression)
            require(i >= 0 && i < drawing.expression_width(), "LabelRefiner",
                    "got expression coefficient ", i, ", expected 0 to ",
                    drawing.expression_width() - 1);
        require(sigma_.allFinite() && sigma_.minCoeff() > 0, "LabelRefiner",
                "got a prior's sigma that is not positive");
    }

    /// Refines the labels of a frame. Throws an Error if no pixel counts or the avatar at its label
    /// is not finite.
    RefinedLabels refine(const Labels& label, const std::vector<LabelView<Number>>& views) {
        const Photographs of{label, views, used_pixels(views)};
        RefinedLabels r;
        VecX<double> x = VecX<double>::Zero(unknowns_.count());
        NormalEquations<double> last;
        for (int round = 0; round < std::max(1, settings_.rounds); ++round) {
            const std::vector<Columns<Number>> residuals = residuals_at(of, x);
            if (round == 0) r.first_residual = rms(of, residuals);
            require(round > 0 || std::isfinite(r.first_residual), "LabelRefiner",
                    "the avatar at the frame's label is not finite");
            noise_ = estimated_noise(residuals);
            const auto found = levenberg<double>(
                x, settings_.levenberg, [&](const VecX<double>& at) { return linearized(of, at); },
                [&](const VecX<double>& at) { return cost(of, at); });
            x = found.x;
            r.steps += found.steps;
            r.refused += found.refused;
            r.settled = found.settled;
            last = found.at;
        }
        r.cost = last.cost;
        r.first_cost = cost(of, VecX<double>::Zero(x.size()));
        r.residual = rms(of, residuals_at(of, x));
        r.noise = noise_;
        r.change = x.cwiseProduct(sigma_);
        r.sigma = covariance<double>(last.matrix).diagonal().cwiseSqrt().cwiseProduct(sigma_);
        return r;
    }

    /// Returns the derivatives of a view's colours with respect to the unknowns: three rows
    /// (channels) for each pixel in `pixels`, a column per unknown [colour per sigma of its prior].
    Columns<Number> jacobian(const Labels& label, const LabelView<Number>& view,
                             const std::vector<Index>& pixels, const VecX<double>& x) {
        differentiate(label, x);
        static_cast<void>(drawing_->picture(view));
        return drawing_->jacobian(view, pixels);
    }

    const LabelUnknowns& unknowns() const { return unknowns_; }

  private:
    /// A frame's photographs, and what of them counts.
    struct Photographs {
        const Labels& label;
        const std::vector<LabelView<Number>>& views;
        std::vector<std::vector<Index>> used; ///< pixels of each view
    };

    Labels labels_at(const Labels& label, const VecX<double>& x) const {
        return moved_drivers(label, unknowns_, x.cwiseProduct(sigma_));
    }
    /// Differentiates the driven Gaussians at x, and drives there.
    void differentiate(const Labels& label, const VecX<double>& x) {
        std::vector<Labels> moved;
        for (Index k = 0; k < x.size(); ++k) {
            VecX<double> at = x;
            at[k] += settings_.difference;
            moved.push_back(labels_at(label, at));
        }
        drawing_->differentiate(labels_at(label, x), moved, settings_.difference);
    }

    static std::vector<std::vector<Index>> used_pixels(
        const std::vector<LabelView<Number>>& views) {
        std::vector<std::vector<Index>> used;
        std::size_t all = 0;
        for (const LabelView<Number>& v : views) {
            const Index pixels = static_cast<Index>(v.camera.width) * v.camera.height;
            require(v.truth.rows() == 3 && v.truth.cols() == pixels && v.weight.rows() == 1 &&
                        v.weight.cols() == pixels,
                    "LabelRefiner", "a photograph has not the size of its camera");
            used.emplace_back();
            for (Index p = 0; p < pixels; ++p)
                if (v.weight(0, p) > Number(0)) used.back().push_back(p);
            all += used.back().size();
        }
        require(all > 0, "LabelRefiner", "got no pixel whose weight is above 0");
        return used;
    }

    /// Returns a view's render, by what was driven, minus its photograph, 3 x used pixels.
    Columns<Number> residual_of(const Photographs& of, std::size_t view) {
        const Columns<Number>& picture = drawing_->picture(of.views[view]);
        const std::vector<Index>& pixels = of.used[view];
        Columns<Number> r(3, static_cast<Index>(pixels.size()));
        for (std::size_t i = 0; i < pixels.size(); ++i)
            r.col(static_cast<Index>(i)) =
                picture.col(pixels[i]) - of.views[view].truth.col(pixels[i]);
        return r;
    }
    std::vector<Columns<Number>> residuals_at(const Photographs& of, const VecX<double>& x) {
        drawing_->drive(labels_at(of.label, x));
        std::vector<Columns<Number>> residuals;
        for (std::size_t v = 0; v < of.views.size(); ++v) residuals.push_back(residual_of(of, v));
        return residuals;
    }

    static double rms(const Photographs& of, const std::vector<Columns<Number>>& residuals) {
        double sum = 0, weights = 0;
        for (std::size_t v = 0; v < of.views.size(); ++v)
            for (Index i = 0; i < residuals[v].cols(); ++i) {
                const double w = weight_of(of, v, i);
                sum += w * residuals[v].col(i).template cast<double>().squaredNorm();
                weights += 3 * w;
            }
        return std::sqrt(sum / weights);
    }

    /// Returns 1.4826 times the median of the absolute residuals: the standard deviation of normal
    /// ones.
    double estimated_noise(const std::vector<Columns<Number>>& residuals) const {
        std::vector<Number> sizes;
        for (const Columns<Number>& r : residuals)
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

    double cost(const Photographs& of, const VecX<double>& x) {
        drawing_->drive(labels_at(of.label, x));
        double sum = x.squaredNorm();
        for (std::size_t v = 0; v < of.views.size(); ++v)
            sum += cost_of(of, v, residual_of(of, v)) / settings_.alike;
        return sum;
    }
    /// Returns the cost of a view's residual.
    double cost_of(const Photographs& of, std::size_t view, const Columns<Number>& r) const {
        return sum_chunks(threads_, r.cols(), chunk, 0.0, [&](Index b, Index e) {
            double s = 0;
            for (Index i = b; i < e; ++i) {
                double c = 0;
                for (Index k = 0; k < 3; ++k)
                    c += huber_cost(static_cast<double>(r(k, i)) / noise_);
                s += weight_of(of, view, i) * c;
            }
            return s;
        });
    }

    NormalEquations<double> linearized(const Photographs& of, const VecX<double>& x) {
        differentiate(of.label, x);
        const Index n = x.size();
        // Matrix and gradient side by side, starting with those of the priors.
        Columns<double> sums = Columns<double>::Zero(n + 1, n + 1);
        sums.topLeftCorner(n, n).setIdentity();
        sums.row(n).head(n) = x.transpose();
        double sum = x.squaredNorm();
        for (std::size_t v = 0; v < of.views.size(); ++v) {
            const Columns<Number> r = residual_of(of, v);
            sum += cost_of(of, v, r) / settings_.alike;
            sums += drawing_->sums(of.views[v], weighed(of, v, r)) / settings_.alike;
        }
        return {sum, sums.topLeftCorner(n, n), sums.row(n).head(n).transpose()};
    }
    /// Returns a view's colours with the weights of their squares.
    WeighedColours weighed(const Photographs& of, std::size_t view,
                           const Columns<Number>& r) const {
        WeighedColours w{of.used[view], Columns<double>(3, r.cols()), Columns<double>(3, r.cols())};
        for_chunks(threads_, r.cols(), chunk, [&](Index b, Index e, Index) {
            for (Index i = b; i < e; ++i)
                for (Index k = 0; k < 3; ++k) {
                    const double scaled = static_cast<double>(r(k, i)) / noise_;
                    const double root = std::sqrt(weight_of(of, view, i) * huber_weight(scaled));
                    w.scale(k, i) = root / noise_;
                    w.residual(k, i) = root * scaled;
                }
        });
        return w;
    }

    static double weight_of(const Photographs& of, std::size_t view, Index i) {
        return static_cast<double>(
            of.views[view].weight(0, of.used[view][static_cast<std::size_t>(i)]));
    }

    static constexpr Index chunk = 1024; ///< pixels

    P threads_;
    D* drawing_;
    LabelUnknowns unknowns_;
    RefineSettings settings_;
    VecX<double> sigma_; ///< standard deviations of the priors, n
    double noise_ = 1;   ///< standard deviation of a residual [colour]
};

} // namespace rye
