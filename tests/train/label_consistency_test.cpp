// SPDX-License-Identifier: Apache-2.0
#include <rye/train/label_consistency.hpp>

#include <cmath>
#include <limits>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>

#include "../support/hostile.hpp"

using namespace rye;

namespace {

constexpr double degree = 3.14159265358979323846 / 180;
constexpr double infinite = std::numeric_limits<double>::infinity();

/// Standard normal numbers, one after the other.
struct Normal {
    Random random;
    std::uint64_t next = 0;
    double operator()() { return random.normal(next++); }
    Columns<double> columns(Index rows, Index cols, double size = 1) {
        Columns<double> m(rows, cols);
        for (Index i = 0; i < m.size(); ++i) m(i) = size * (*this)();
        return m;
    }
};

/// Frame f of y as the others predict it: a + b x_f of the a, b that minimise
/// |y - a - b x|^2 + ridge |b|^2 over them, by the normal equations of (a, b). No ridge: b is 0.
VecX<double> left_out_by_force(const Columns<double>& x, const Columns<double>& y, Index f,
                               double ridge) {
    const Index k = std::isfinite(ridge) ? x.rows() : 0;
    Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(k + 1, k + 1);
    Eigen::MatrixXd right = Eigen::MatrixXd::Zero(k + 1, y.rows());
    const auto with_one = [&](Index g) {
        VecX<double> v(k + 1);
        v << 1, x.col(g).head(k);
        return v;
    };
    for (Index g = 0; g < x.cols(); ++g) {
        if (g == f) continue;
        normal += with_one(g) * with_one(g).transpose();
        right += with_one(g) * y.col(g).transpose();
    }
    for (Index i = 1; i <= k; ++i) normal(i, i) += ridge; // a is free
    const Eigen::MatrixXd ab = Eigen::LDLT<Eigen::MatrixXd>(normal).solve(right);
    return ab.transpose() * with_one(f);
}

double rms(const Columns<double>& x) {
    return std::sqrt(x.squaredNorm() / static_cast<double>(x.size()));
}

/// A head of which what is below y = -0.1 moves linearly by regressors, the more the lower it is,
/// and the rest is still.
struct Head {
    static constexpr Index landmarks = 96, drives = 4;
    Columns<double> rest = Columns<double>(3, landmarks);
    Columns<double> direction; ///< 3 drives x landmarks
    Columns<double> reach = Columns<double>::Zero(drives, landmarks);

    Head() {
        const Random random{5, 0};
        for (Index l = 0; l < landmarks; ++l) {
            const auto i = static_cast<std::uint64_t>(2 * l);
            const double x = 1.5 * random.uniform(i) - 0.75, y = 1.8 * random.uniform(i + 1) - 0.9;
            rest.col(l) << x, y, 1 - 0.5 * x * x - 0.3 * y * y;
        }
        Normal normal{{6, 0}};
        const Columns<double> of = normal.columns(3 * drives, 1, 0.15);
        direction = Columns<double>::Zero(3 * drives, landmarks);
        for (Index l = 0; l < landmarks; ++l) {
            const double low = -0.1 - rest(1, l);
            if (low <= 0) continue;
            direction.col(l) = low * of;
            reach.col(l).setOnes();
        }
    }
    Columns<double> regressors(Index frames) const {
        const Random random{8, 0};
        Columns<double> x(drives, frames);
        for (Index i = 0; i < x.size(); ++i)
            x(i) = 2 * random.uniform(static_cast<std::uint64_t>(i)) - 1;
        return x;
    }
    /// Each frame after the motion that its pose's error is, with noise.
    std::vector<Columns<double>> frames(const Columns<double>& x,
                                        const std::vector<RigidMotion<double>>& error,
                                        double noise = 0) const {
        Normal normal{{9, 0}};
        std::vector<Columns<double>> all;
        for (Index f = 0; f < x.cols(); ++f) {
            Columns<double> at = rest;
            for (Index k = 0; k < drives; ++k) at += x(k, f) * direction.middleRows(3 * k, 3);
            all.push_back(error[static_cast<std::size_t>(f)](at) +
                          normal.columns(3, landmarks, noise));
        }
        return all;
    }
};

std::vector<RigidMotion<double>> pose_errors(Index frames, double turn, double shift) {
    Normal normal{{10, 0}};
    std::vector<RigidMotion<double>> all(static_cast<std::size_t>(frames));
    for (RigidMotion<double>& m : all) {
        m.rotation = so3_exp(Vec3<double>(normal.columns(3, 1, turn)));
        m.translation = normal.columns(3, 1, shift);
    }
    return all;
}

/// Root mean squares of a coordinate of motions, without what all frames have in common.
struct Spread {
    double turn = 0, shift = 0;
    Vec3<double> mean_turn = Vec3<double>::Zero(), mean_shift = Vec3<double>::Zero();

    explicit Spread(const std::vector<RigidMotion<double>>& motions) {
        const auto n = static_cast<double>(motions.size());
        for (const RigidMotion<double>& m : motions) {
            mean_turn += so3_log(m.rotation) / n;
            mean_shift += m.translation / n;
        }
        for (const RigidMotion<double>& m : motions) {
            turn += (so3_log(m.rotation) - mean_turn).squaredNorm() / (3 * n);
            shift += (m.translation - mean_shift).squaredNorm() / (3 * n);
        }
        turn = std::sqrt(turn);
        shift = std::sqrt(shift);
    }
};

/// Returns the errors that are left after the motions that were found.
std::vector<RigidMotion<double>> remaining(const std::vector<RigidMotion<double>>& found,
                                           const std::vector<RigidMotion<double>>& error) {
    std::vector<RigidMotion<double>> all;
    for (std::size_t f = 0; f < error.size(); ++f) all.push_back(found[f] * error[f]);
    return all;
}

} // namespace

TEST_CASE("left-out predictions are those of fits without the frame") {
    constexpr Index frames = 11;
    Normal normal{{1, 0}};
    Columns<double> few = normal.columns(3, frames);
    few.colwise() += Vec3<double>(5, -2, 0.3); // the intercept matters
    const Columns<double> many = normal.columns(17, frames); // more regressors than frames
    const Columns<double> y =
        normal.columns(2, frames) + normal.columns(2, 3) * few + Columns<double>::Ones(2, frames);
    for (const Columns<double>& x : {few, many}) {
        const detail::LeftOutRidge regression(x);
        for (const double ridge : {0.1, 1.0, 25.0, infinite}) {
            CAPTURE(x.rows());
            CAPTURE(ridge);
            const Eigen::MatrixXd off = regression.left_out_residual(ridge);
            const Columns<double> residual = y * off.transpose();
            for (Index f = 0; f < frames; ++f) {
                const VecX<double> by_force = y.col(f) - left_out_by_force(x, y, f, ridge);
                CHECK((residual.col(f) - by_force).norm() < 1e-9);
                CHECK(off(f, f) == doctest::Approx(1)); // no prediction uses the frame itself
            }
        }
        const detail::LeftOutRidge<double>::Fit fit = regression.fit(y);
        CAPTURE(fit.ridge);
        for (Index f = 0; f < frames; ++f) {
            const VecX<double> by_force = left_out_by_force(x, y, f, fit.ridge);
            CHECK((fit.left_out.col(f) - by_force).norm() < 1e-9);
        }
        CHECK(fit.rms == doctest::Approx(rms(y - fit.left_out)));
    }
}

TEST_CASE("the mean predicts what has nothing to do with the regressors") {
    constexpr Index frames = 20;
    int mean = 0;
    for (std::uint64_t seed = 0; seed < 20; ++seed) {
        Normal normal{{seed, 2}};
        const Columns<double> x = normal.columns(6, frames);
        const Columns<double> y = normal.columns(12, frames);
        const detail::LeftOutRidge<double>::Fit fit = detail::LeftOutRidge(x).fit(y);
        CHECK(fit.rms > 0.8);
        if (!std::isinf(fit.ridge)) continue;
        ++mean;
        for (Index f = 0; f < frames; ++f) {
            const VecX<double> others =
                (y.rowwise().sum() - y.col(f)) / static_cast<double>(frames - 1);
            CHECK((fit.left_out.col(f) - others).norm() < 1e-9);
            CHECK((fit.fitted.col(f) - y.rowwise().mean()).norm() < 1e-9);
        }
    }
    CHECK(mean == 20);
}

TEST_CASE("a linear quantity is predicted, also by as many regressors as a third of the frames") {
    constexpr Index frames = 24;
    Normal normal{{3, 0}};
    const Columns<double> x = normal.columns(8, frames);
    Columns<double> y = normal.columns(5, 8) * x;
    y.colwise() += normal.columns(5, 1, 10).col(0);
    const double moved = rms(y.colwise() - y.rowwise().mean());
    const detail::LeftOutRidge<double>::Fit fit = detail::LeftOutRidge(x).fit(y);
    CAPTURE(fit.ridge);
    CHECK(std::isfinite(fit.ridge));
    CHECK(fit.rms < 2e-3 * moved);
    CHECK(rms(y - fit.fitted) < fit.rms);
    // With noise the predictions are hardly worse than it.
    const detail::LeftOutRidge<double>::Fit noisy =
        detail::LeftOutRidge(x).fit(y + normal.columns(5, frames, 0.1));
    CHECK(std::isfinite(noisy.ridge));
    CHECK(noisy.rms < 0.2);
    CHECK(noisy.ridge >= fit.ridge);
}

TEST_CASE("regressions of fewer than three frames are refused") {
    CHECK_FAULT(detail::LeftOutRidge(Columns<double>::Ones(4, 2)),
                "got 2 frames, expected 3 or more");
    CHECK_NOTHROW(
        detail::LeftOutRidge(Columns<double>::Ones(4, 3))); // that all are alike is no fault
    const detail::LeftOutRidge<double>::Fit fit =
        detail::LeftOutRidge(Columns<double>::Ones(4, 3)).fit(Vec3<double>(1, 2, 6).transpose());
    CHECK(fit.left_out(0, 2) == doctest::Approx(1.5));
}

TEST_CASE("rigid motions: one after the other, and back") {
    const std::vector<RigidMotion<double>> m = pose_errors(2, 0.3, 0.5);
    const Columns<double> x = Normal{{4, 0}}.columns(3, 5);
    CHECK(((m[0] * m[1])(x) - m[0](m[1](x))).norm() < 1e-12);
    CHECK((m[0].inverse()(m[0](x)) - x).norm() < 1e-12);
}

TEST_CASE("frames without pose errors stay where they are") {
    const Head head;
    const Columns<double> x = head.regressors(24);
    const auto frames = head.frames(x, std::vector<RigidMotion<double>>(24));
    for (const Columns<double>& reach : {Columns<double>(), head.reach})
        for (const RigidMotion<double>& m : align_frames(frames, x, reach)) {
            CHECK(so3_log(m.rotation).norm() < 1e-3);
            CHECK(m.translation.norm() < 1e-3);
        }
}

TEST_CASE("pose errors are found by a head that moves as its regressors say") {
    constexpr Index count = 24;
    const Head head;
    const Columns<double> x = head.regressors(count);
    const auto error = pose_errors(count, 0.6 * degree, 0.01);
    const Spread before(error);
    REQUIRE(before.turn > 0.5 * degree);
    REQUIRE(before.shift > 0.008);
    for (const double noise : {0.0, 0.015}) {
        const auto frames = head.frames(x, error, noise);
        for (const Columns<double>& reach : {Columns<double>(), head.reach}) {
            const auto found = align_frames(frames, x, reach);
            const Spread after(remaining(found, error)), motion(found);
            const double times = noise > 0 ? 2 : 3;
            CAPTURE(noise);
            CAPTURE(reach.size());
            CAPTURE(before.turn / after.turn);
            CAPTURE(before.shift / after.shift);
            CHECK(times * after.turn < before.turn);
            CHECK(times * after.shift < before.shift);
            CHECK(motion.mean_turn.norm() < 1e-8);
            CHECK(motion.mean_shift.norm() < 1e-8);
            for (const RigidMotion<double>& m : found)
                CHECK((m.rotation * m.rotation.transpose() - Mat3<double>::Identity()).norm() <
                      1e-12);
        }
    }
}

TEST_CASE("one frame far off does not pull the others along") {
    constexpr Index count = 24;
    const Head head;
    const Columns<double> x = head.regressors(count);
    std::vector<RigidMotion<double>> error(count);
    error[7].rotation = so3_exp(Vec3<double>(0, 3 * degree, 0));
    error[7].translation << 0.03, 0, -0.02;
    const auto found = align_frames(head.frames(x, error, 0.003), x);
    const auto left = remaining(found, error);
    for (const RigidMotion<double>& m : left) {
        const RigidMotion<double> relative = m * left[0].inverse();
        CHECK(so3_log(relative.rotation).norm() < 0.3 * degree);
        CHECK(relative.translation.norm() < 0.005);
    }
}

TEST_CASE("fewer than three frames are not aligned") {
    const Head head;
    for (const Index count : {1, 2}) {
        const Columns<double> x = head.regressors(count);
        const auto error = pose_errors(count, 0.02, 0.02);
        const auto found = align_frames(head.frames(x, error), x);
        REQUIRE(static_cast<Index>(found.size()) == count);
        for (const RigidMotion<double>& m : found) {
            CHECK(m.rotation == Mat3<double>::Identity());
            CHECK(m.translation == Vec3<double>::Zero());
        }
    }
    CHECK(align_frames({}, Columns<double>(4, 0)).empty());
}

namespace {

/// Returns as many landmarks as the program has, about evenly over a cap, with smooth displacements
/// of second order in the place, 0.04 in all.
std::vector<Columns<double>> smoothly_moved(Index frames) {
    constexpr Index side = 20;
    const Random random{11, 0};
    Columns<double> rest(3, side * side);
    for (Index l = 0; l < rest.cols(); ++l) {
        const auto within = [&](Index cell, Index k) {
            const double u = random.uniform(static_cast<std::uint64_t>(2 * l + k));
            return (static_cast<double>(cell) + 0.2 + 0.6 * u) / static_cast<double>(side) - 0.5;
        };
        const double x = 1.5 * within(l % side, 0), y = 1.8 * within(l / side, 1);
        rest.col(l) << x, y, 1 - 0.5 * x * x - 0.3 * y * y;
    }
    Normal normal{{12, 0}};
    std::vector<Columns<double>> all;
    for (Index f = 0; f < frames; ++f) {
        const Columns<double> by = normal.columns(3, 6, 0.03);
        Columns<double> at = rest;
        for (Index l = 0; l < rest.cols(); ++l) {
            const double u = rest(0, l), v = rest(1, l);
            Vec<double, 6> terms;
            terms << 1, u, v, u * u, u * v, v * v;
            at.col(l) += by * terms;
        }
        all.push_back(at);
    }
    return all;
}

double rms_between(const std::vector<Columns<double>>& a, const std::vector<Columns<double>>& b) {
    double squares = 0;
    for (std::size_t f = 0; f < a.size(); ++f) squares += std::pow(rms(a[f] - b[f]), 2);
    return std::sqrt(squares / static_cast<double>(a.size()));
}

} // namespace

TEST_CASE("noise of landmarks is measured and taken off, smooth displacements stay") {
    constexpr double noise = 0.015;
    const auto truth = smoothly_moved(24);
    auto noisy = truth;
    Normal normal{{13, 0}};
    for (Columns<double>& f : noisy) f += normal.columns(3, f.cols(), noise);
    const SmoothedLandmarks s = smoothed_landmarks(noisy);
    const double before = rms_between(noisy, truth), after = rms_between(s.frames, truth);
    CAPTURE(before);
    CAPTURE(after);
    CHECK(s.noise == doctest::Approx(noise).epsilon(0.2));
    CHECK(before == doctest::Approx(noise).epsilon(0.1));
    CHECK(after < 0.5 * before);
    // Their mean over frames is not what neighbours tell of, and stays.
    Columns<double> mean = Columns<double>::Zero(3, truth[0].cols());
    for (std::size_t f = 0; f < noisy.size(); ++f) mean += s.frames[f] - noisy[f];
    CHECK(mean.cwiseAbs().maxCoeff() < 1e-10);
}

TEST_CASE("landmarks without noise hardly change") {
    const auto truth = smoothly_moved(24);
    const SmoothedLandmarks s = smoothed_landmarks(truth);
    CAPTURE(s.noise);
    CHECK(s.noise < 1.5e-3);
    CHECK(rms_between(s.frames, truth) < 1e-3);
    CHECK(rms_between(truth, std::vector<Columns<double>>(24, truth[0])) > 0.03);
    // Fewer than three frames tell nothing.
    const std::vector<Columns<double>> two(truth.begin(), truth.begin() + 2);
    const SmoothedLandmarks same = smoothed_landmarks(two);
    CHECK(same.noise == 0);
    CHECK(same.frames[1] == two[1]);
}

TEST_CASE("the same labels give the same bits") {
    const Head head;
    const Columns<double> x = head.regressors(12);
    const auto frames = head.frames(x, pose_errors(12, 0.6 * degree, 0.01), 0.015);
    const auto one = align_frames(frames, x, head.reach);
    const auto other = align_frames(frames, x, head.reach);
    const SmoothedLandmarks a = smoothed_landmarks(frames), b = smoothed_landmarks(frames);
    CHECK(a.noise == b.noise);
    for (std::size_t f = 0; f < frames.size(); ++f) {
        CHECK(one[f].rotation == other[f].rotation);
        CHECK(one[f].translation == other[f].translation);
        CHECK(a.frames[f] == b.frames[f]);
    }
    const detail::LeftOutRidge regression(x);
    const Columns<double> y = frames[0].leftCols(12);
    CHECK(regression.fit(y).left_out == detail::LeftOutRidge(x).fit(y).left_out);
}
