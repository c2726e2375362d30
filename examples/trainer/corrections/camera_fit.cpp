// SPDX-License-Identifier: Apache-2.0
#include "corrections/camera_fit.hpp"

#include <cmath>

#include <rye/math/rotation.hpp>

#include "corrections/point_equations.hpp"

namespace rye::trainer {
namespace {

constexpr Index of_camera = 7; ///< number of unknowns: turn, shift, log_focal

/// Least-squares problem. The unknowns are those of all cameras, unless they are held, and three
/// for each point, in units of their priors' deviations.
class Fit {
  public:
    Fit(const std::vector<Pinhole<double>>& cameras, const Columns<double>& points,
        const std::vector<SeenPoint>& seen, const CameraPriors& priors)
        : cameras_(cameras),
          points_(points),
          seen_(seen),
          priors_(priors) {}

    VecX<double> solve(bool cameras_held) {
        first_point_ = cameras_held ? 0 : of_camera * static_cast<Index>(cameras_.size());
        const VecX<double> start = VecX<double>::Zero(first_point_ + points_.size());
        LevenbergSettings settings;
        settings.steps = 30;
        settings.tolerance = 1e-7;
        return levenberg<double>(
                   start, settings, [&](const VecX<double>& x) { return linearized(x); },
                   [&](const VecX<double>& x) { return cost(x); })
            .x;
    }
    CameraChange change(const VecX<double>& x, int camera) const {
        CameraChange c;
        if (first_point_ == 0) return c;
        const auto part = x.segment<of_camera>(of_camera * static_cast<Index>(camera));
        c.turn = priors_.turn * part.head<3>();
        c.shift = priors_.shift * part.segment<3>(3);
        c.log_focal = priors_.focal * part[6];
        return c;
    }
    double deviation(Index point) const {
        return point < priors_.first_loose ? priors_.point : priors_.loose;
    }
    Vec3<double> offset(const VecX<double>& x, Index point) const {
        return deviation(point) * x.segment<3>(first_point_ + 3 * point);
    }
    /// Returns the distance of the seen point from its expected position [px].
    Vec2<double> off(const VecX<double>& x, const SeenPoint& s) const {
        const Pinhole<double> c =
            changed(cameras_[static_cast<std::size_t>(s.camera)], change(x, s.camera));
        const Vec3<double> point = points_.col(s.point) + offset(x, s.point);
        return c.project_point(point).head<2>() - s.at;
    }

  private:
    /// Bound of Huber's cost, in deviations: quadratic below, linear above.
    static constexpr double bend = 2;
    static double huber(double squared) {
        return squared <= bend * bend ? squared : 2 * bend * std::sqrt(squared) - bend * bend;
    }
    static double weight(double squared) {
        return squared <= bend * bend ? 1 : bend / std::sqrt(squared);
    }
    double cost(const VecX<double>& x) const {
        double sum = x.squaredNorm();
        for (const SeenPoint& s : seen_)
            sum += huber(off(x, s).squaredNorm() / (s.sigma * s.sigma));
        return sum;
    }

    /// Returns the derivatives of a position in the picture: 2 x (a camera's unknowns, the
    /// point's).
    Mat<double, 2, of_camera + 3> derivatives(const VecX<double>& x, const SeenPoint& s) const {
        const Pinhole<double>& is = cameras_[static_cast<std::size_t>(s.camera)];
        const CameraChange by = change(x, s.camera);
        const Pinhole<double> c = changed(is, by);
        const Vec3<double> world = points_.col(s.point) + offset(x, s.point);
        const Vec3<double> at = c.camera_from_world.apply(world);
        Mat<double, 2, 3> of_at;
        of_at << c.fx / at.z(), 0, -c.fx * at.x() / (at.z() * at.z()), //
            0, c.fy / at.z(), -c.fy * at.y() / (at.z() * at.z());
        Mat3<double> turned; // derivative of turn x at by a small turn
        turned << 0, at.z(), -at.y(), -at.z(), 0, at.x(), at.y(), -at.x(), 0;
        Mat<double, 2, of_camera + 3> d;
        d.leftCols<3>() = priors_.turn * of_at * turned;
        d.middleCols<3>(3) = -priors_.shift * of_at * so3_exp(by.turn);
        d.col(6) = priors_.focal * Vec2<double>(c.fx * at.x() / at.z(), c.fy * at.y() / at.z());
        d.rightCols<3>() = deviation(s.point) * of_at * c.camera_from_world.rotation;
        return d;
    }

    PointEquations linearized(const VecX<double>& x) const {
        PointEquations n(x, first_point_);
        n.cost = cost(x);
        for (const SeenPoint& s : seen_) {
            const Vec2<double> r = off(x, s) / s.sigma;
            const double w = weight(r.squaredNorm());
            const Mat<double, 2, of_camera + 3> d = derivatives(x, s) / s.sigma;
            const auto camera = d.leftCols<of_camera>();
            const auto point = d.rightCols<3>();
            const Index p = 3 * static_cast<Index>(s.point);
            n.points[static_cast<std::size_t>(s.point)] += w * point.transpose() * point;
            n.gradient.segment<3>(first_point_ + p) += w * point.transpose() * r;
            if (first_point_ == 0) continue;
            const Index k = of_camera * static_cast<Index>(s.camera);
            n.shared.block<of_camera, of_camera>(k, k) += w * camera.transpose() * camera;
            n.tied.block<of_camera, 3>(k, p) += w * camera.transpose() * point;
            n.gradient.segment<of_camera>(k) += w * camera.transpose() * r;
        }
        return n;
    }

    const std::vector<Pinhole<double>>& cameras_;
    const Columns<double>& points_;
    const std::vector<SeenPoint>& seen_;
    const CameraPriors& priors_;
    Index first_point_ = 0;
};

} // namespace

Pinhole<double> changed(const Pinhole<double>& camera, const CameraChange& change) {
    Pinhole<double> c = camera;
    Rigid<double>& m = c.camera_from_world;
    const Mat3<double> turn = so3_exp(change.turn);
    m.rotation = turn * m.rotation;
    m.translation = turn * (m.translation - change.shift);
    c.fx *= std::exp(change.log_focal);
    c.fy *= std::exp(change.log_focal);
    return c;
}

CameraFit fit_cameras(const std::vector<Pinhole<double>>& cameras, const Columns<double>& points,
                      const std::vector<SeenPoint>& seen, const CameraPriors& priors) {
    Fit fit(cameras, points, seen, priors);
    CameraFit found;
    const auto distances = [&](const VecX<double>& x) {
        std::vector<double> all;
        for (const SeenPoint& s : seen) all.push_back(fit.off(x, s).norm());
        return all;
    };
    found.before = distances(fit.solve(true));
    const VecX<double> x = fit.solve(false);
    found.after = distances(x);
    for (std::size_t c = 0; c < cameras.size(); ++c)
        found.changes.push_back(fit.change(x, static_cast<int>(c)));
    found.offsets.resize(3, points.cols());
    for (Index p = 0; p < points.cols(); ++p) found.offsets.col(p) = fit.offset(x, p);
    return found;
}

} // namespace rye::trainer
