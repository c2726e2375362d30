// SPDX-License-Identifier: Apache-2.0
/// rye/train/expression_labels.hpp: expression coefficients of many frames of one head, corrected
/// by where its landmarks are, before any picture is read. The displacements by the coefficients
/// are those of a face model. Lengths in any unit; a frame is a column.
/// Source: a linear mixed model whose variances are estimated by expectation and maximisation
/// (Dempster, Laird and Rubin, 1977), with the rigid motions of generalised Procrustes analysis
/// (Gower, 1975).
#pragma once

#include <algorithm>
#include <cmath>
#include <type_traits>
#include <vector>

#include <Eigen/Cholesky>

#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>
#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/train/label_consistency.hpp>

namespace rye {

/// Expression coefficients that agree with the landmarks.
template <Real T>
struct AlignedExpressions {
    Columns<T> coefficients;            ///< E x F
    std::vector<RigidMotion<T>> motion; ///< of each frame, to the head at rest that all share
    T off = 0;                          ///< estimated standard deviation of a label's error
    T noise = 0;                        ///< estimated standard deviation of a landmark's coordinate
    T moved = 0;                        ///< root mean square of a coordinate by the corrections
};

namespace detail {

/// Settings of align_expressions.
struct ExpressionSettings {
    int rounds = 12;      ///< rounds of relinearised least squares
    double off = 0.03;    ///< initial standard deviation of a coefficient's error
    double noise = 0.01;  ///< initial standard deviation of a landmark's coordinate [unit]
    double turn = 0.2;   ///< standard deviation of a frame's rotation [rad]
    double shift = 0.2;  ///< standard deviation of its shift [unit]
};

/// Unknowns of align_expressions for E coefficients, F frames and L landmarks.
template <Real T>
struct ExpressionFit {
    const std::vector<Columns<T>>& frames; ///< 3 x L each
    const Columns<T>& shapes;              ///< E x 3 L
    const Columns<T>& labels;              ///< E x F
    Columns<T> change;                     ///< of the labels, E x F
    std::vector<RigidMotion<T>> motion;    ///< of each frame, to the head at rest
    VecX<T> noise2;                        ///< variance of a coordinate of each landmark, L
    T off2;                                ///< variance of a coefficient's error

    Index count() const { return static_cast<Index>(frames.size()); }
    Index landmarks() const { return noise2.size(); }

    /// Returns the landmarks of each frame, 3 x L, moved to the head at rest and without their
    /// expression, less their mean over frames.
    std::vector<Columns<T>> residuals() const {
        std::vector<Columns<T>> rest(frames.size());
        Columns<T> mean = Columns<T>::Zero(3, landmarks());
        for (Index f = 0; f < count(); ++f) {
            const auto at = static_cast<std::size_t>(f);
            rest[at] = motion[at](frames[at]);
            rest[at].reshaped() -= shapes.transpose() * (labels.col(f) + change.col(f));
            mean += rest[at] / static_cast<T>(count());
        }
        for (Columns<T>& r : rest) r -= mean;
        return rest;
    }

    /// Moves coefficients and motions by one round of least squares.
    void step(const ExpressionSettings& settings) {
        const Index n = count(), e = shapes.rows();
        const T turn2 = T(settings.turn * settings.turn);
        const T shift2 = T(settings.shift * settings.shift);
        const std::vector<Columns<T>> rest = residuals();
        VecX<T> weight(3 * landmarks());
        for (Index l = 0; l < landmarks(); ++l)
            weight.template segment<3>(3 * l).setConstant(1 / noise2[l]);
        const Columns<T> weighted = shapes * weight.asDiagonal(); // E x 3 L
        Columns<T> normal = Columns<T>::Zero(6 + e, 6 + e);
        normal.bottomRightCorner(e, e) = weighted * shapes.transpose();
        normal.bottomRightCorner(e, e).diagonal().array() += 1 / off2;
        T next_off2 = 0;
        std::vector<Vec<T, 6>> steps(frames.size());
        for (Index f = 0; f < n; ++f) {
            const auto at = static_cast<std::size_t>(f);
            const Columns<T> moved = motion[at](frames[at]);
            const VecX<T> residual = rest[at].reshaped();
            Columns<T> j(3 * landmarks(), 6);
            for (Index l = 0; l < landmarks(); ++l)
                j.template middleRows<3>(3 * l) = motion_jacobian(Vec3<T>(moved.col(l)));
            const Columns<T> wj = weight.asDiagonal() * j;
            normal.topLeftCorner(6, 6) = j.transpose() * wj;
            normal.topLeftCorner(6, 6).diagonal().head(3).array() += 1 / turn2;
            normal.topLeftCorner(6, 6).diagonal().tail(3).array() += 1 / shift2;
            normal.bottomLeftCorner(e, 6) = -shapes * wj;
            VecX<T> right(6 + e);
            Vec<T, 6> total;
            total << so3_log(motion[at].rotation), motion[at].translation;
            right.head(6) = -(wj.transpose() * residual);
            right.head(3) -= total.template head<3>() / turn2;
            right.segment(3, 3) -= total.template tail<3>() / shift2;
            right.tail(e) = weighted * residual - change.col(f) / off2;
            const Eigen::LDLT<Columns<T>, Eigen::Lower> solver(normal);
            const VecX<T> solution = solver.solve(right);
            const VecX<T> variance =
                solver.solve(Columns<T>::Identity(6 + e, 6 + e)).diagonal().tail(e);
            steps[at] = solution.head(6);
            change.col(f) += solution.tail(e);
            next_off2 += (change.col(f).squaredNorm() + variance.sum()) / static_cast<T>(e * n);
        }
        // What all frames have in common is the head at rest.
        change.colwise() -= change.rowwise().mean().eval();
        move(steps);
        off2 = std::max(next_off2, T(1e-10));
    }

    /// Moves each frame, so that the mean of all motions is the identity.
    void move(const std::vector<Vec<T, 6>>& steps) {
        Vec3<T> turn = Vec3<T>::Zero(), shift = Vec3<T>::Zero();
        for (std::size_t f = 0; f < frames.size(); ++f) {
            RigidMotion<T>& m = motion[f];
            m = RigidMotion<T>{so3_exp(Vec3<T>(steps[f].template head<3>())),
                               Vec3<T>(steps[f].template tail<3>())} *
                m;
            turn += so3_log(m.rotation) / static_cast<T>(count());
            shift += m.translation / static_cast<T>(count());
        }
        const RigidMotion<T> back = RigidMotion<T>{so3_exp(turn), shift}.inverse();
        for (RigidMotion<T>& m : motion) m = back * m;
    }

    /// Estimates the variance of each landmark anew.
    void weigh_landmarks(const ExpressionSettings& settings) {
        VecX<T> squares = VecX<T>::Zero(landmarks());
        for (const Columns<T>& r : residuals())
            squares += r.colwise().squaredNorm().transpose() / (3 * static_cast<T>(count() - 1));
        // A landmark that seems exact by chance must not decide alone.
        const T all = squares.mean();
        noise2 = squares.array().max(T(0.1) * all).max(T(1e-6 * settings.noise * settings.noise));
    }
};

} // namespace detail

/// Returns the coefficients and rigid motions by which the landmarks of all frames, 3 x L in the
/// frame of their head pose, are one head at rest and its displacements. shapes: E x 3 L, the
/// displacement (e, 3 l + axis) by a coefficient of 1; labels: E x F. Landmarks that something else
/// moves, such as lids, should not be among them. What the shapes cannot tell apart keeps its
/// labels. Errors of coefficients have mean 0 over frames, since a mean error is that of the head
/// at rest, and motions have the identity as their mean. A landmark is weighted by how well all
/// frames predict it, and the size of errors is estimated. Throws an Error for arrays that do not
/// fit the frames; fewer than three frames keep their labels.
template <Real T>
AlignedExpressions<T> align_expressions(const std::vector<Columns<T>>& frames,
                                        const std::type_identity_t<Columns<T>>& shapes,
                                        const std::type_identity_t<Columns<T>>& labels,
                                        const detail::ExpressionSettings& settings = {}) {
    const auto n = static_cast<Index>(frames.size());
    const Index e = shapes.rows(), landmarks = n > 0 ? frames.front().cols() : 0;
    require(labels.rows() == e && labels.cols() == n, "align_expressions: labels", "got ",
            labels.rows(), " x ", labels.cols(), ", expected ", e, " x ", n);
    require(n == 0 || shapes.cols() == 3 * landmarks, "align_expressions: shapes", "got ",
            shapes.cols(), " columns, expected 3 for each of ", landmarks, " landmarks");
    if (n < 3 || e == 0) return {labels, std::vector<RigidMotion<T>>(frames.size()), 0, 0, 0};
    detail::ExpressionFit<T> fit{frames,
                                 shapes,
                                 labels,
                                 Columns<T>::Zero(e, n),
                                 std::vector<RigidMotion<T>>(frames.size()),
                                 VecX<T>::Constant(landmarks, T(settings.noise * settings.noise)),
                                 T(settings.off * settings.off)};
    for (int round = 0; round < settings.rounds; ++round) {
        fit.step(settings);
        fit.weigh_landmarks(settings);
    }
    const T moved =
        (shapes.transpose() * fit.change).norm() / std::sqrt(static_cast<T>(3 * landmarks * n));
    return {labels + fit.change, fit.motion, std::sqrt(fit.off2), std::sqrt(fit.noise2.mean()),
            moved};
}

} // namespace rye
