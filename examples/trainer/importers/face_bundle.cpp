// SPDX-License-Identifier: Apache-2.0
#include "importers/face_bundle.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

#include <rye/core/error.hpp>
#include <rye/math/levenberg.hpp>
#include <rye/math/rotation.hpp>

#include "data/median.hpp"
#include "data/threads.hpp"

namespace rye::trainer {
namespace {

using Slope = Mat3<double>;
constexpr double huber = 2;         ///< sigmas from which on errors count linearly
constexpr double least_sigma = 0.1; ///< [px]
constexpr double first_depth_sigmas = 5; ///< errors of depths over those of places, at first
constexpr Index of_pose = 7;        ///< unknowns of a head: turn, shift, offset of its depths

Mat3<double> skew(const Vec3<double>& v) {
    Mat3<double> m;
    m << 0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0;
    return m;
}

/// Returns J with so3_exp(w + d) = so3_exp(J d) so3_exp(w) to first order.
Mat3<double> left_jacobian(const Vec3<double>& w) {
    const double s = w.squaredNorm(), angle = std::sqrt(s);
    const double a = s < 1e-8 ? 0.5 - s / 24 : (1 - std::cos(angle)) / s;
    const double b = s < 1e-8 ? 1.0 / 6 - s / 120 : (angle - std::sin(angle)) / (s * angle);
    const Mat3<double> k = skew(w);
    return Mat3<double>::Identity() + a * k + b * k * k;
}

/// A landmark as a tracker sees it: place and depth behind the head's origin [px], but for an
/// offset of all depths of a picture. Derivatives by the landmark and by the head's translation.
struct Projected {
    Vec3<double> at;
    Slope by_point, by_shift;
};
Projected project(const Vec3<double>& turned, const Vec3<double>& shift, double focal, double depth,
                  const BundleSettings& s) {
    const Vec3<double> p = turned + shift;
    const double x = p.x() / p.z(), y = p.y() / p.z();
    Projected out;
    out.at << focal * x + s.cx, focal * y + s.cy, focal * turned.z() / depth;
    out.by_shift << focal / p.z(), 0, -focal * x / p.z(), 0, focal / p.z(), -focal * y / p.z(), 0, 0,
        0;
    out.by_point = out.by_shift;
    out.by_point(2, 2) = focal / depth;
    return out;
}

class Bundle {
  public:
    Bundle(const std::vector<FaceView>& views, const Columns<double>& rest,
           const BundleSettings& settings)
        : views_(views), guess_(rest), s_(settings) {
        const Index n = rest.cols(), k = views.front().drivers.size();
        b_.focal = s_.focal;
        b_.rest = rest;
        b_.shapes = Columns<double>::Zero(3 * n, k);
        b_.mean = VecX<double>::Zero(k);
        b_.sigma = Columns<double>::Constant(3, n, s_.first_sigma);
        b_.sigma.row(2) *= first_depth_sigmas;
        offset_ = VecX<double>::Zero(frames());
        for (const FaceView& v : views) {
            b_.heads.push_back(v.head);
            b_.mean += v.drivers / static_cast<double>(views.size());
        }
        for (Index i = 0; i < n; i += s_.stride) chosen_.push_back(i);
    }

    FaceBundle run() {
        for (int round = 0; round < s_.rounds; ++round) {
            weigh();
            adjust();
            program_threads().run(b_.rest.cols(), [&](Index i) { fit_landmark(i); });
            measure_errors();
        }
        return b_;
    }

  private:
    Index frames() const { return static_cast<Index>(views_.size()); }
    const FaceView& view(Index f) const { return views_[static_cast<std::size_t>(f)]; }

    Vec3<double> in_head(Index f, Index i) const {
        return b_.rest.col(i) + b_.shapes.middleRows(3 * i, 3) * (view(f).drivers - b_.mean);
    }
    double depth(Index f) const { return b_.heads[static_cast<std::size_t>(f)].translation.z(); }
    Vec3<double> error(Index f, Index i) const {
        const Rigid<double>& head = b_.heads[static_cast<std::size_t>(f)];
        Vec3<double> off = project(head.turn(in_head(f, i)), head.translation, b_.focal, depth(f), s_).at -
                           view(f).seen.col(i);
        off[2] += offset_[f];
        return off;
    }

    /// Weighs each landmark in each view by the size of its error, N x F.
    void weigh() {
        weight_.resize(b_.rest.cols(), frames());
        for (Index f = 0; f < frames(); ++f)
            for (Index i = 0; i < b_.rest.cols(); ++i) {
                const double off = error(f, i).cwiseQuotient(Vec3<double>(b_.sigma.col(i))).norm();
                weight_(i, f) = std::min(1.0, huber / std::max(off, 1e-9));
            }
    }
    /// Weights of the three numbers of a landmark in a view.
    Vec3<double> weights(Index f, Index i) const {
        return weight_(i, f) * b_.sigma.col(i).cwiseAbs2().cwiseInverse();
    }

    /// Unknowns of the bundle: logarithm of the focal length; of each head a turn, a shift and an
    /// offset of depths; the places of the chosen landmarks.
    Index size() const { return 1 + of_pose * frames() + 3 * static_cast<Index>(chosen_.size()); }

    /// The head's pose by its unknowns.
    Rigid<double> moved(const VecX<double>& x, Index f) const {
        const Rigid<double>& h = b_.heads[static_cast<std::size_t>(f)];
        const Vec3<double> turn = x.segment<3>(1 + of_pose * f), shift = x.segment<3>(4 + of_pose * f);
        return {so3_exp(turn) * h.rotation, h.translation + shift};
    }

    template <class Each>
    void for_each_error(const VecX<double>& x, Each&& each) const {
        const double focal = b_.focal * std::exp(x[0]);
        for (Index f = 0; f < frames(); ++f) {
            const Rigid<double> head = moved(x, f);
            for (std::size_t k = 0; k < chosen_.size(); ++k) {
                const Index i = chosen_[k], at = 1 + of_pose * frames() + 3 * static_cast<Index>(k);
                const Vec3<double> shift = x.segment<3>(at);
                const Vec3<double> turned = head.rotation * (in_head(f, i) + shift);
                const Projected p = project(turned, head.translation, focal, depth(f), s_);
                Vec3<double> off = p.at - view(f).seen.col(i);
                off[2] += offset_[f] + x[7 + of_pose * f];
                each(f, at, Vec3<double>(weights(f, i) / s_.alike), p, turned, head, off);
            }
        }
    }

    double prior_cost(const VecX<double>& x) const {
        double sum = 0;
        const double focal = (std::log(b_.focal / s_.focal) + x[0]) / s_.focal_sigma;
        for (std::size_t k = 0; k < chosen_.size(); ++k)
            sum += (off_guess(k) + x.segment<3>(1 + of_pose * frames() + 3 * static_cast<Index>(k)))
                       .squaredNorm();
        double turns = 0;
        for (Index f = 0; f < frames(); ++f) turns += off_turn(x, f).squaredNorm();
        return focal * focal + sum / (s_.rest_sigma * s_.rest_sigma) + of_turns() * turns;
    }
    double of_turns() const {
        return s_.turn_sigma > 0 ? 1 / (s_.turn_sigma * s_.turn_sigma) : 0;
    }
    Vec3<double> off_turn(const VecX<double>& x, Index f) const {
        return so3_log(Mat3<double>(moved(x, f).rotation * view(f).head.rotation.transpose()));
    }
    Vec3<double> off_guess(std::size_t k) const {
        return b_.rest.col(chosen_[k]) - guess_.col(chosen_[k]);
    }

    double cost(const VecX<double>& x) const {
        double sum = prior_cost(x);
        for_each_error(x, [&](Index, Index, const Vec3<double>& w, const Projected&,
                              const Vec3<double>&, const Rigid<double>&, const Vec3<double>& r) {
            sum += w.dot(r.cwiseAbs2());
        });
        return sum;
    }

    NormalEquations<double> linearized(const VecX<double>& x) const {
        NormalEquations<double> e{prior_cost(x), Columns<double>::Zero(size(), size()),
                                  VecX<double>::Zero(size())};
        const double of_focal = 1 / (s_.focal_sigma * s_.focal_sigma);
        e.matrix(0, 0) = of_focal;
        e.gradient[0] = of_focal * (std::log(b_.focal / s_.focal) + x[0]);
        const double of_rest = 1 / (s_.rest_sigma * s_.rest_sigma);
        for (std::size_t k = 0; k < chosen_.size(); ++k) {
            const Index at = 1 + of_pose * frames() + 3 * static_cast<Index>(k);
            e.matrix.block<3, 3>(at, at).diagonal().setConstant(of_rest);
            e.gradient.segment<3>(at) = of_rest * (off_guess(k) + x.segment<3>(at));
        }
        for (Index f = 0; f < frames(); ++f) { // errors of turns are small
            const Index at = 1 + of_pose * f;
            e.matrix.block<3, 3>(at, at).diagonal().setConstant(of_turns());
            e.gradient.segment<3>(at) = of_turns() * off_turn(x, f);
        }
        std::vector<Mat3<double>> turns;
        for (Index f = 0; f < frames(); ++f) turns.push_back(left_jacobian(x.segment<3>(1 + of_pose * f)));
        for_each_error(x, [&](Index f, Index at, const Vec3<double>& w, const Projected& p,
                              const Vec3<double>& turned, const Rigid<double>& head,
                              const Vec3<double>& r) {
            Eigen::Matrix<double, 3, 1 + of_pose> j;
            j.col(0) = p.at - Vec3<double>(s_.cx, s_.cy, 0);
            j.middleCols<3>(1) = -p.by_point * skew(turned) * turns[static_cast<std::size_t>(f)];
            j.middleCols<3>(4) = p.by_shift;
            j.col(7) = Vec3<double>::UnitZ();
            const Slope of_point = p.by_point * head.rotation;
            const Eigen::Matrix<double, of_pose, 3> wj = j.rightCols<of_pose>().transpose() * w.asDiagonal();
            const Mat3<double> wp = of_point.transpose() * w.asDiagonal();
            const Index pose = 1 + of_pose * f;
            e.cost += w.dot(r.cwiseAbs2());
            e.matrix(0, 0) += w.dot(j.col(0).cwiseAbs2());
            e.matrix.block<of_pose, 1>(pose, 0) += wj * j.col(0);
            e.matrix.block<3, 1>(at, 0) += wp * j.col(0);
            e.matrix.block<of_pose, of_pose>(pose, pose) += wj * j.rightCols<of_pose>();
            e.matrix.block<3, of_pose>(at, pose) += wp * j.rightCols<of_pose>();
            e.matrix.block<3, 3>(at, at) += wp * of_point;
            e.gradient[0] += w.cwiseProduct(r).dot(j.col(0));
            e.gradient.segment<of_pose>(pose) += wj * r;
            e.gradient.segment<3>(at) += wp * r;
        });
        return e;
    }

    void adjust() {
        LevenbergSettings how;
        how.steps = 12;
        const LevenbergResult<double> found = levenberg<double>(
            VecX<double>::Zero(size()), how, [&](const VecX<double>& x) { return linearized(x); },
            [&](const VecX<double>& x) { return cost(x); });
        for (Index f = 0; f < frames(); ++f) {
            Rigid<double>& head = b_.heads[static_cast<std::size_t>(f)];
            head = moved(found.x, f);
            offset_[f] += found.x[7 + of_pose * f];
        }
        for (std::size_t k = 0; k < chosen_.size(); ++k)
            b_.rest.col(chosen_[k]) +=
                found.x.segment<3>(1 + of_pose * frames() + 3 * static_cast<Index>(k));
        b_.focal *= std::exp(found.x[0]);
        const Eigen::LLT<Columns<double>> factor(found.at.matrix);
        if (factor.info() == Eigen::Success)
            b_.focal_deviation = std::sqrt(factor.solve(VecX<double>::Unit(size(), 0))[0]);
    }

    /// Fits place and shapes of a landmark to its views, with heads and camera as they are.
    void fit_landmark(Index i) {
        const Index k = b_.mean.size(), n = 3 * (k + 1);
        for (int step = 0; step < 2; ++step) {
            Columns<double> matrix = Columns<double>::Zero(n, n);
            VecX<double> gradient = VecX<double>::Zero(n), own(n);
            own.head<3>() = b_.rest.col(i) - guess_.col(i);
            for (Index d = 0; d < k; ++d) own.segment<3>(3 + 3 * d) = b_.shapes.block<3, 1>(3 * i, d);
            VecX<double> prior =
                VecX<double>::Constant(n, 1 / (s_.shape_sigma * s_.shape_sigma));
            prior.head<3>().setConstant(1 / (s_.rest_sigma * s_.rest_sigma));
            matrix.diagonal() = prior;
            gradient = prior.cwiseProduct(own);
            Columns<double> row(3, n);
            for (Index f = 0; f < frames(); ++f) {
                const Rigid<double>& head = b_.heads[static_cast<std::size_t>(f)];
                const Projected p = project(head.turn(in_head(f, i)), head.translation, b_.focal,
                                            depth(f), s_);
                const Vec3<double> root = weights(f, i).cwiseSqrt();
                const Slope slope = root.asDiagonal() * p.by_point * head.rotation;
                row.leftCols<3>() = slope;
                for (Index d = 0; d < k; ++d)
                    row.middleCols<3>(3 + 3 * d) = (view(f).drivers[d] - b_.mean[d]) * slope;
                matrix.selfadjointView<Eigen::Lower>().rankUpdate(row.transpose());
                gradient += row.transpose() * root.cwiseProduct(error(f, i));
            }
            const VecX<double> by = -matrix.selfadjointView<Eigen::Lower>().llt().solve(gradient);
            b_.rest.col(i) += by.head<3>();
            for (Index d = 0; d < k; ++d) b_.shapes.block<3, 1>(3 * i, d) += by.segment<3>(3 + 3 * d);
        }
    }

    void measure_errors() {
        constexpr double to_sigma = 1.4826; // of the median of absolute values
        std::vector<double> places, depths;
        for (Index i = 0; i < b_.rest.cols(); ++i) {
            places.clear();
            depths.clear();
            for (Index f = 0; f < frames(); ++f) {
                const Vec3<double> off = error(f, i).cwiseAbs();
                places.insert(places.end(), {off.x(), off.y()});
                depths.push_back(off.z());
            }
            b_.sigma.col(i).head<2>().setConstant(std::max(least_sigma, to_sigma * median(places)));
            b_.sigma(2, i) = std::max(least_sigma, to_sigma * median(depths));
        }
        b_.residual.clear();
        for (Index f = 0; f < frames(); ++f) {
            double sum = 0;
            for (Index i = 0; i < b_.rest.cols(); ++i)
                sum += error(f, i).head<2>().squaredNorm() / (2 * b_.sigma(0, i) * b_.sigma(0, i));
            b_.residual.push_back(std::sqrt(sum / static_cast<double>(b_.rest.cols())));
        }
    }

    const std::vector<FaceView>& views_;
    const Columns<double>& guess_;
    BundleSettings s_;
    FaceBundle b_;
    std::vector<Index> chosen_;
    Columns<double> weight_;
    VecX<double> offset_; ///< of the depths of each view [px]
};

} // namespace

Columns<double> FaceBundle::landmarks(const VecX<double>& drivers) const {
    const VecX<double> moved = shapes * (drivers - mean);
    return rest + Eigen::Map<const Columns<double>>(moved.data(), 3, rest.cols());
}

FaceBundle bundle_face(const std::vector<FaceView>& views, const Columns<double>& rest,
                       const BundleSettings& settings) {
    require(views.size() >= 3, "bundle_face", "got ", views.size(), " views, expected 3 or more");
    return Bundle(views, rest, settings).run();
}

} // namespace rye::trainer
