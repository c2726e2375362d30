// SPDX-License-Identifier: Apache-2.0
#include "driving/fit_expressions.hpp"

#include <cmath>

#include <Eigen/Cholesky>

#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/fit_rigid.hpp"

namespace rye::trainer {
namespace {

using Matrix = Eigen::MatrixXd;

/// Deviation of what no coefficient explains in a landmark's coordinate [dm]: 0.3 mm.
constexpr double noise = 3e-3;

/// Returns the landmarks of a frame in the head's frame, 198 numbers.
VecX<double> in_head(const CaptureFrame& f) {
    const Mat3<double> back = so3_exp(Vec3<double>(f.pose.head<3>())).transpose();
    Columns<double> p(3, f.landmarks.cols());
    for (Index i = 0; i < p.cols(); ++i)
        p.col(i) = back * (f.landmarks.col(i) - f.pose.tail<3>()) / f.scale;
    return Eigen::Map<const VecX<double>>(p.data(), p.size());
}

/// Returns x with the least |A x - b|^2 / noise^2 + sum of (x_i / sigma_i)^2, for each column of b.
Matrix ridge(const Matrix& a, const Matrix& b, const VecX<double>& sigma) {
    Matrix n = a.transpose() * a / (noise * noise);
    for (Index i = 0; i < n.rows(); ++i) n(i, i) += 1 / (sigma[i] * sigma[i]);
    return n.ldlt().solve(a.transpose() * b / (noise * noise));
}

/// Landmarks by coefficients: at rest (198), and what each moves at 1 (198 x E).
struct LinearFace {
    VecX<double> rest;
    Matrix shapes;
    VecX<double> sigma; ///< of each coefficient over the frames; those that do not vary: tiny
};

LinearFace linear_face(const Capture& capture, const std::string& who) {
    const auto frames = static_cast<Index>(capture.frames.size());
    require(frames >= least_fit_frames, who, "got ", frames, " frames, expected at least ",
            least_fit_frames, " to fit coefficients without names");
    const auto count = static_cast<Index>(capture.frames.front().expression.size());
    constexpr Index looks = 4;
    Matrix x = Matrix::Zero(frames, count + looks);
    Matrix y(frames, 3 * capture.frames.front().landmarks.cols());
    for (Index i = 0; i < frames; ++i) {
        const CaptureFrame& f = capture.frames[static_cast<std::size_t>(i)];
        for (Index k = 0; k < count; ++k)
            x(i, k) = static_cast<double>(f.expression[static_cast<std::size_t>(k)]);
        for (std::size_t e = 0; e < 2 && f.has_gaze; ++e)
            x.block(i, count + 2 * static_cast<Index>(e), 1, 2) =
                pitch_yaw(f.eyes[e].optical).transpose();
        y.row(i) = in_head(f).transpose();
    }
    const Eigen::RowVectorXd x_mean = x.colwise().mean(), y_mean = y.colwise().mean();
    x.rowwise() -= x_mean;
    y.rowwise() -= y_mean;
    // In units of the deviations a coefficient moves landmarks by about as much as any other.
    VecX<double> deviation =
        (x.colwise().squaredNorm() / static_cast<double>(frames)).cwiseSqrt().transpose();
    require(y.cwiseAbs().maxCoeff() > noise, who,
            "landmarks of all frames are alike, so no "
            "coefficient moves anything");
    const VecX<double> scale = deviation.cwiseMax(1e-6);
    const Matrix unit = x.array().rowwise() / scale.transpose().array();
    constexpr double moves = 0.02; // of a landmark by a coefficient's deviation [dm]: 2 mm
    const Matrix shapes = ridge(unit, y, VecX<double>::Constant(unit.cols(), moves)).transpose();
    LinearFace face;
    face.shapes = (shapes.array().rowwise() / scale.transpose().array()).matrix().leftCols(count);
    // A coefficient that no frame varies moves nothing, whatever its number.
    for (Index k = 0; k < count; ++k)
        if (deviation[k] < 1e-6) face.shapes.col(k).setZero();
    face.rest = y_mean.transpose() - face.shapes * x_mean.head(count).transpose();
    face.sigma = (3 * deviation.head(count)).cwiseMax(1e-6);
    return face;
}

} // namespace

Columns<double> landmarks_at(const HeadModel& model, const VecX<double>& weights) {
    const Points v =
        model.vertices(weights, VecX<double>::Zero(static_cast<Index>(lid_names.size())));
    Columns<double> all(3, 68);
    for (std::size_t i = 0; i < 68; ++i) all.col(static_cast<Index>(i)) = v.col(model.landmarks[i]);
    return common_landmarks(all, "landmarks_at");
}

ExpressionMix fitted_mix(const HeadModel& model, const Capture& capture, const std::string& who) {
    const LinearFace face = linear_face(capture, who);
    const auto names = static_cast<Index>(model.expression_names.size());
    const Columns<double> rest = landmarks_at(model, VecX<double>::Zero(names));
    const Columns<double> own =
        Eigen::Map<const Columns<double>>(face.rest.data(), 3, face.rest.size() / 3);
    const auto spread = [](const Columns<double>& p) {
        return (p.colwise() - p.rowwise().mean()).norm();
    };
    const double scale = spread(own) / spread(rest);
    const Mat3<double> turn = fit_rigid(Columns<double>(scale * rest), own).rotation;
    Matrix moved(face.rest.size(), names);
    for (Index k = 0; k < names; ++k) {
        const Columns<double> d =
            scale * (turn * (landmarks_at(model, VecX<double>::Unit(names, k)) - rest));
        moved.col(k) = Eigen::Map<const VecX<double>>(d.data(), d.size());
    }
    return {model.expression_names, ridge(face.shapes, moved, face.sigma)};
}

} // namespace rye::trainer
