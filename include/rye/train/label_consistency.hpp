// SPDX-License-Identifier: Apache-2.0
/// rye/train/label_consistency.hpp: consistency of the labels of many frames, before any picture is
/// read: prediction of a frame's quantity from the other frames, rigid motions that align the
/// frames of one head, and removal of noise from landmarks that their neighbours do not share.
/// Lengths in any unit; a frame is a column.
/// Source: ridge regression with leave-one-out residuals in closed form (Golub, Heath and Wahba,
/// 1979); generalised Procrustes analysis (Gower, 1975); Wiener's filter over the eigenvectors of a
/// graph's Laplacian.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <type_traits>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>
#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>

namespace rye {

namespace detail {

/// Eigenvectors of a positive semidefinite matrix, and their values, largest first. Reflections are
/// applied one at a time: in blocks, Eigen would take 18 kB from the stack.
template <Real T>
struct PositiveModes {
    Columns<T> vectors;
    VecX<T> values;

    explicit PositiveModes(const Columns<T>& a) {
        const Index n = a.rows();
        const Eigen::Tridiagonalization<Columns<T>> tridiagonal(a);
        Eigen::SelfAdjointEigenSolver<Columns<T>> solver;
        solver.computeFromTridiagonal(tridiagonal.diagonal(), tridiagonal.subDiagonal());
        vectors = solver.eigenvectors().rowwise().reverse();
        values = solver.eigenvalues().reverse().cwiseMax(T(0));
        for (Index k = n - 2; k >= 0; --k) {
            VecX<T> v = tridiagonal.packedMatrix().col(k).tail(n - k - 1);
            v[0] = T(1);
            const VecX<T> along = vectors.bottomRows(n - k - 1).transpose() * v;
            vectors.bottomRows(n - k - 1).noalias() -=
                (tridiagonal.householderCoefficients()[k] * v) * along.transpose();
        }
    }
};

/// Linear regressions of quantities of F frames on the frames' drivers, each with the ridge that
/// best predicts left-out frames.
template <Real T>
class LeftOutRidge {
  public:
    /// x: K regressors x F frames. Throws an Error for fewer than three frames.
    explicit LeftOutRidge(const Columns<T>& x) {
        const Index n = x.cols();
        require(n >= 3, "LeftOutRidge", "got ", n, " frames, expected 3 or more");
        const Columns<T> centred = x.colwise() - x.rowwise().mean();
        const detail::PositiveModes<T> modes(centred.transpose() * centred);
        vectors_ = modes.vectors;
        values_ = modes.values;
        const T largest = std::max(values_.maxCoeff(), T(1e-12));
        ridges_ = {std::numeric_limits<T>::infinity()};
        for (T r = 30; r > T(1e-4); r /= 3) ridges_.push_back(r * largest);
    }

    /// Predictions of some quantities, D x F.
    struct Fit {
        Columns<T> fitted;   ///< D x F
        Columns<T> left_out; ///< each frame as predicted by the others, D x F
        T rms = 0;           ///< error of left_out
        T ridge = 0;         ///< infinite if the mean is the best prediction
    };
    /// Returns the fit of y, D x F, whose rows share a ridge.
    Fit fit(const Columns<T>& y) const {
        Fit best;
        best.rms = std::numeric_limits<T>::infinity();
        const Index n = y.cols();
        const VecX<T> mean = y.rowwise().mean();
        const Columns<T> turned = (y.colwise() - mean) * vectors_; // D x F
        for (const T ridge : ridges_) {
            VecX<T> keep = VecX<T>::Zero(n);
            if (std::isfinite(ridge)) keep = values_.array() / (values_.array() + ridge);
            Columns<T> fitted = turned * keep.asDiagonal() * vectors_.transpose();
            fitted.colwise() += mean;
            Columns<T> left_out = fitted;
            for (Index f = 0; f < n; ++f) {
                const T own = 1 / static_cast<T>(n) +
                              (vectors_.row(f).transpose().array().square() * keep.array()).sum();
                const T rest = std::max(1 - own, T(1e-9));
                left_out.col(f) = y.col(f) - (y.col(f) - fitted.col(f)) / rest;
            }
            const T rms = std::sqrt((y - left_out).squaredNorm() / static_cast<T>(y.size()));
            // A regression must be better than the mean by more than chance.
            if (rms < T(best.ridge == ridges_.front() ? 0.97 : 1.0) * best.rms)
                best = {std::move(fitted), std::move(left_out), rms, ridge};
        }
        return best;
    }

    /// Returns the F x F matrix that maps a quantity of the frames to its errors, each frame
    /// predicted by the others.
    Columns<T> left_out_residual(T ridge) const {
        const Index n = vectors_.rows();
        VecX<T> keep = VecX<T>::Zero(n);
        if (std::isfinite(ridge)) keep = values_.array() / (values_.array() + ridge);
        Columns<T> off = -(vectors_ * keep.asDiagonal() * vectors_.transpose());
        off.array() -= 1 / static_cast<T>(n);
        off.diagonal().array() += 1;
        for (Index f = 0; f < n; ++f) off.row(f) /= std::max(off(f, f), T(1e-9));
        return off;
    }

  private:
    Columns<T> vectors_; ///< F x F
    VecX<T> values_;
    std::vector<T> ridges_; ///< the infinite one first
};
template <class X>
LeftOutRidge(const Eigen::MatrixBase<X>&) -> LeftOutRidge<typename X::Scalar>;

} // namespace detail

/// Rigid motion R x + t.
template <Real T>
struct RigidMotion {
    Mat3<T> rotation = Mat3<T>::Identity();
    Vec3<T> translation = Vec3<T>::Zero();

    Columns<T> operator()(const Columns<T>& x) const {
        return (rotation * x).colwise() + translation;
    }
    /// Returns the motion that applies `first`, then this one.
    RigidMotion<T> operator*(const RigidMotion<T>& first) const {
        return {rotation * first.rotation, rotation * first.translation + translation};
    }
    RigidMotion<T> inverse() const {
        return {rotation.transpose(), -(rotation.transpose() * translation)};
    }
};

namespace detail {

/// Returns the 3 x 6 derivative of a point's motion by a small rotation and shift.
template <Real T>
Mat<T, 3, 6> motion_jacobian(const Vec3<T>& x) {
    Mat<T, 3, 6> j;
    j << 0, x.z(), -x.y(), 1, 0, 0, -x.z(), 0, x.x(), 0, 1, 0, x.y(), -x.x(), 0, 0, 0, 1;
    return j;
}

} // namespace detail

/// Settings of align_frames.
struct AlignSettings {
    int rounds = 8;        ///< rounds of relinearised least squares
    double turn = 0.005;   ///< initial standard deviation of a frame's rotation [rad]
    double shift = 0.005;  ///< initial standard deviation of its shift [unit]
    double alike = 70;     ///< landmarks that an expression moves alike
};

/// Returns the motions that bring the landmarks of each frame, 3 x L in the frame of its head pose,
/// to the positions predicted from the other frames; their mean over frames is the identity. x: K
/// regressors x F frames, which move landmarks; reach: K x L in [0, 1], how far each may move a
/// landmark relative to the others, or empty for all alike. The motions of all frames are the
/// unknowns of one least-squares problem, whose residuals are those of the left-out predictions:
/// these are linear in the landmarks, hence in small motions. The expected size of motions is
/// estimated in rounds. A landmark is weighted by how well it is predicted, and less in a frame
/// where it disagrees with the stillest landmarks.
template <Real T>
std::vector<RigidMotion<T>> align_frames(const std::vector<Columns<T>>& frames, const Columns<T>& x,
                                         const std::type_identity_t<Columns<T>>& reach = {},
                                         const AlignSettings& settings = {}) {
    const auto n = static_cast<Index>(frames.size());
    std::vector<RigidMotion<T>> motion(frames.size());
    if (n < 3) return motion;
    const Index landmarks = frames.front().cols();
    // Landmarks moved by the same regressors share a regression.
    std::vector<detail::LeftOutRidge<T>> ridges;
    std::vector<std::size_t> ridge_of(static_cast<std::size_t>(landmarks), 0);
    if (reach.size() == 0) ridges.emplace_back(x);
    std::map<std::vector<int>, std::size_t> same;
    for (Index l = 0; l < reach.cols(); ++l) {
        std::vector<int> levels;
        VecX<T> rounded(reach.rows());
        for (Index k = 0; k < reach.rows(); ++k) {
            levels.push_back(static_cast<int>(std::lround(4 * std::sqrt(reach(k, l)))));
            rounded[k] = T(std::pow(levels.back() / 4.0, 2));
        }
        const auto [found, is_new] = same.emplace(levels, ridges.size());
        if (is_new) ridges.emplace_back(rounded.asDiagonal() * x);
        ridge_of[static_cast<std::size_t>(l)] = found->second;
    }
    T turn2 = T(settings.turn * settings.turn), shift2 = T(settings.shift * settings.shift);
    const auto centred = [&] {
        Vec3<T> turn = Vec3<T>::Zero(), shift = Vec3<T>::Zero();
        for (const RigidMotion<T>& m : motion) {
            turn += so3_log(m.rotation) / static_cast<T>(n);
            shift += m.translation / static_cast<T>(n);
        }
        const RigidMotion<T> back = RigidMotion<T>{so3_exp(turn), shift}.inverse();
        for (RigidMotion<T>& m : motion) m = back * m;
    };
    for (int round = 0; round < settings.rounds; ++round) {
        // Landmarks as moved so far, 3 x F each, and their statistics.
        std::vector<Columns<T>> now(static_cast<std::size_t>(landmarks), Columns<T>(3, n));
        for (Index f = 0; f < n; ++f) {
            const auto at = static_cast<std::size_t>(f);
            const Columns<T> moved = motion[at](frames[at]);
            for (Index l = 0; l < landmarks; ++l)
                now[static_cast<std::size_t>(l)].col(f) = moved.col(l);
        }
        std::vector<T> spread, by;
        for (std::size_t l = 0; l < now.size(); ++l) {
            const typename detail::LeftOutRidge<T>::Fit fit = ridges[ridge_of[l]].fit(now[l]);
            spread.push_back(std::max(fit.rms, T(1e-9)));
            by.push_back(fit.ridge);
        }
        std::vector<T> sorted = spread;
        const auto quarter = sorted.begin() + landmarks / 4;
        std::nth_element(sorted.begin(), quarter, sorted.end());
        const T still2 = *quarter * *quarter;
        Columns<T> normal = Columns<T>::Zero(6 * n, 6 * n);
        VecX<T> right = VecX<T>::Zero(6 * n);
        for (std::size_t l = 0; l < now.size(); ++l) {
            const Columns<T> off = ridges[ridge_of[l]].left_out_residual(by[l]);
            const Columns<T> residual = now[l] * off.transpose(); // 3 x F
            // The error of a landmark beyond that of still ones is shared by those that move with
            // it: many of them tell no more than one.
            const T excess = std::max(T(0), spread[l] * spread[l] - T(1.25) * still2);
            VecX<T> weight(n); // in units of still2^-1
            for (Index f = 0; f < n; ++f) {
                const T outlying = 1 + residual.col(f).squaredNorm() / (12 * still2);
                weight[f] = still2 / ((still2 + T(settings.alike) * excess) * outlying * outlying);
            }
            const Mat<T, 3, 6> j = detail::motion_jacobian(Vec3<T>(now[l].rowwise().mean()));
            const Mat<T, 6, 6> jj = j.transpose() * j;
            const Columns<T> weighted = weight.asDiagonal() * off;
            const Columns<T> both = off.transpose() * weighted;
            const Columns<T> pulled = j.transpose() * residual * weighted; // 6 x F
            for (Index f = 0; f < n; ++f) {
                right.template segment<6>(6 * f) -= pulled.col(f);
                for (Index g = 0; g <= f; ++g)
                    normal.template block<6, 6>(6 * f, 6 * g) += both(f, g) * jj;
            }
        }
        VecX<T> total(6 * n);
        for (Index f = 0; f < n; ++f) {
            const RigidMotion<T>& m = motion[static_cast<std::size_t>(f)];
            total.template segment<3>(6 * f) = so3_log(m.rotation);
            total.template segment<3>(6 * f + 3) = m.translation;
        }
        for (Index i = 0; i < 6 * n; ++i) {
            const T p = still2 / (i % 6 < 3 ? turn2 : shift2);
            normal(i, i) += p;
            right[i] -= p * total[i];
        }
        const Eigen::LDLT<Columns<T>, Eigen::Lower> solver(normal);
        const VecX<T> step = solver.solve(right);
        const Columns<T> inverse = solver.solve(Columns<T>::Identity(6 * n, 6 * n));
        total += step;
        turn2 = shift2 = 0;
        for (Index i = 0; i < 6 * n; ++i)
            (i % 6 < 3 ? turn2 : shift2) +=
                (total[i] * total[i] + still2 * inverse(i, i)) / static_cast<T>(3 * n);
        for (Index f = 0; f < n; ++f) {
            const Vec<T, 6> s = step.template segment<6>(6 * f);
            RigidMotion<T>& m = motion[static_cast<std::size_t>(f)];
            m = RigidMotion<T>{so3_exp(Vec3<T>(s.template head<3>())),
                               Vec3<T>(s.template tail<3>())} *
                m;
        }
        centred();
    }
    return motion;
}

/// Landmarks of frames without the noise that neighbours do not share.
template <Real T>
struct SmoothedLandmarks {
    std::vector<Columns<T>> frames; ///< 3 x L each
    T noise = 0;                    ///< estimated standard deviation of a coordinate's noise
};

/// Removes noise from the landmarks of frames, 3 x L each: differences from their mean over frames
/// are filtered over the eigenvectors of the landmarks' neighbourhood, each scaled by its share
/// above the noise, which is estimated from the roughest quarter of them.
template <Real T>
SmoothedLandmarks<T> smoothed_landmarks(const std::vector<Columns<T>>& frames) {
    SmoothedLandmarks<T> s{frames, 0};
    const auto n = static_cast<Index>(frames.size());
    if (n < 3) return s;
    const Index landmarks = frames.front().cols();
    Columns<T> mean = Columns<T>::Zero(3, landmarks);
    for (const Columns<T>& f : frames) mean += f / static_cast<T>(n);
    constexpr Index near = 8;
    const Index neighbours = std::min(near, landmarks - 1);
    Columns<T> laplacian = Columns<T>::Zero(landmarks, landmarks);
    for (Index l = 0; l < landmarks; ++l) {
        std::vector<std::pair<T, Index>> by_distance;
        for (Index k = 0; k < landmarks; ++k)
            if (k != l) by_distance.emplace_back((mean.col(k) - mean.col(l)).squaredNorm(), k);
        std::sort(by_distance.begin(), by_distance.end());
        for (Index i = 0; i < neighbours; ++i) {
            const Index k = by_distance[static_cast<std::size_t>(i)].second;
            laplacian(l, k) = laplacian(k, l) = -1;
        }
    }
    for (Index l = 0; l < landmarks; ++l) laplacian(l, l) = -laplacian.row(l).sum();
    const Columns<T> modes = // smoothest first
        detail::PositiveModes<T>(laplacian).vectors.rowwise().reverse();
    std::vector<Columns<T>> parts; // 3 x L of each frame
    for (const Columns<T>& f : frames) parts.push_back((f - mean) * modes);
    // Energy of a coordinate of each mode, over frames, corrected for the subtracted mean.
    const T left = static_cast<T>(n - 1) / static_cast<T>(n);
    VecX<T> energy = VecX<T>::Zero(landmarks);
    for (const Columns<T>& p : parts)
        energy += p.colwise().squaredNorm().transpose() / (3 * static_cast<T>(n) * left);
    std::vector<T> rough(energy.data() + 3 * landmarks / 4, energy.data() + landmarks);
    std::nth_element(rough.begin(), rough.begin() + static_cast<std::ptrdiff_t>(rough.size() / 2),
                     rough.end());
    const T variance = rough[rough.size() / 2];
    s.noise = std::sqrt(variance);
    // Over a few modes together, so that chance does not decide about one.
    constexpr Index together = 3;
    for (Index m = 0; m < landmarks; m += together) {
        const Index count = std::min(together, landmarks - m);
        const T mine = energy.segment(m, count).mean();
        const T keep = mine > variance ? 1 - variance / mine : 0;
        for (Columns<T>& p : parts) p.middleCols(m, count) *= keep;
    }
    for (std::size_t f = 0; f < frames.size(); ++f)
        s.frames[f] = mean + parts[f] * modes.transpose();
    return s;
}

} // namespace rye
