// SPDX-License-Identifier: Apache-2.0
#include <rye/train/expression_labels.hpp>

#include <cmath>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>

#include "../support/hostile.hpp"

using namespace rye;

namespace {

constexpr double degree = 3.14159265358979323846 / 180;

/// Standard normal numbers, one after the other.
struct Normal {
    Random random;
    std::uint64_t next = 0;
    Columns<double> columns(Index rows, Index cols, double size = 1) {
        Columns<double> m(rows, cols);
        for (Index i = 0; i < m.size(); ++i) m(i) = size * random.normal(next++);
        return m;
    }
};

/// A head with shapes that move a disc of it each.
struct Head {
    static constexpr Index landmarks = 600, shapes = 9, frames = 16;
    Columns<double> rest{3, landmarks};
    Columns<double> moves{shapes, 3 * landmarks};
    Columns<double> expression{shapes, frames};

    Head() {
        const Random random{5, 0};
        for (Index l = 0; l < landmarks; ++l) {
            const auto i = static_cast<std::uint64_t>(2 * l);
            const double x = 1.5 * random.uniform(i) - 0.75, y = 1.8 * random.uniform(i + 1) - 0.9;
            rest.col(l) << x, y, 1 - 0.5 * x * x - 0.3 * y * y;
        }
        Normal normal{{6, 0}};
        const Columns<double> directions = normal.columns(3, shapes, 0.06);
        for (Index e = 0; e < shapes; ++e)
            for (Index l = 0; l < landmarks; ++l) {
                const double away = (rest.col(l) - rest.col(61 * e)).norm();
                moves.row(e).segment<3>(3 * l) =
                    std::exp(-away * away / 0.08) * directions.col(e).transpose();
            }
        expression = normal.columns(shapes, frames, 0.3).cwiseAbs();
    }
    /// Landmarks of the frames, each in the frame of a wrong head pose, with noise.
    std::vector<Columns<double>> seen(const std::vector<RigidMotion<double>>& pose_error,
                                      double noise) const {
        Normal normal{{9, 0}};
        std::vector<Columns<double>> all;
        for (Index f = 0; f < frames; ++f) {
            Columns<double> at = rest;
            at.reshaped() += moves.transpose() * expression.col(f);
            all.push_back(pose_error[static_cast<std::size_t>(f)](at) +
                          normal.columns(3, landmarks, noise));
        }
        return all;
    }
};

std::vector<RigidMotion<double>> pose_errors(double turn, double shift) {
    Normal normal{{10, 0}};
    std::vector<RigidMotion<double>> all(static_cast<std::size_t>(Head::frames));
    for (RigidMotion<double>& m : all)
        m = {so3_exp(Vec3<double>(normal.columns(3, 1, turn))), normal.columns(3, 1, shift)};
    return all;
}

/// Root mean square of what is left of pose errors, without what all frames have in common [deg].
double turn_left(const std::vector<RigidMotion<double>>& found,
                 const std::vector<RigidMotion<double>>& error) {
    std::vector<Vec3<double>> turns;
    Vec3<double> mean = Vec3<double>::Zero();
    const auto n = static_cast<double>(found.size());
    for (std::size_t f = 0; f < found.size(); ++f) {
        turns.push_back(so3_log(Mat3<double>(found[f].rotation * error[f].rotation)));
        mean += turns.back() / n;
    }
    double sum = 0;
    for (const Vec3<double>& t : turns) sum += (t - mean).squaredNorm() / n;
    return std::sqrt(sum) / degree;
}

double rms(const Columns<double>& x) {
    return std::sqrt(x.squaredNorm() / static_cast<double>(x.size()));
}

/// The labels' errors, of mean 0 over frames.
Columns<double> label_errors(double size) {
    Normal normal{{21, 0}};
    Columns<double> e = normal.columns(Head::shapes, Head::frames, size);
    e.colwise() -= e.rowwise().mean().eval();
    return e;
}

} // namespace

TEST_CASE("expressions: errors of coefficients and head poses are found together") {
    const Head head;
    const auto poses = pose_errors(0.6 * degree, 0.01);
    const auto frames = head.seen(poses, 0.015);
    const Columns<double> labels = head.expression + label_errors(0.2);
    const AlignedExpressions a = align_expressions(frames, head.moves, labels);
    const double before = rms(labels - head.expression),
                 after = rms(a.coefficients - head.expression);
    CAPTURE(before);
    CAPTURE(after);
    CHECK(after < 0.35 * before);
    CHECK(a.off == doctest::Approx(before).epsilon(0.15));
    CHECK(a.noise == doctest::Approx(0.015).epsilon(0.05));
    CHECK(a.moved == doctest::Approx(rms(head.moves.transpose() *
                                         (labels - head.expression))).epsilon(0.1));
    CHECK(turn_left(a.motion, poses) < 0.2);
    CHECK(turn_left(std::vector<RigidMotion<double>>(poses.size()), poses) > 0.8);
    CHECK(rms((a.coefficients - labels).rowwise().mean()) < 1e-12);
}

TEST_CASE("expressions: right labels stay, and shapes that move nothing tell nothing") {
    Head head;
    head.moves.row(3).setZero();
    const auto poses = pose_errors(0.6 * degree, 0.01);
    Columns<double> labels = head.expression;
    const AlignedExpressions right = align_expressions(head.seen(poses, 0), head.moves, labels);
    CHECK(rms(right.coefficients - labels) < 1e-3);
    CHECK(right.moved < 1e-4);
    CHECK(turn_left(right.motion, poses) < 1e-3);
    labels += label_errors(0.2);
    const AlignedExpressions a = align_expressions(head.seen(poses, 0.015), head.moves, labels);
    CHECK((a.coefficients - labels).row(3).norm() == 0);
    CHECK((a.coefficients - labels).row(4).norm() > 0.3);
}

TEST_CASE("expressions: arrays that do not fit, few frames, and the same bits") {
    const Head head;
    const auto frames = head.seen(pose_errors(0.6 * degree, 0.01), 0.015);
    CHECK_FAULT(align_expressions(frames, head.moves, head.expression.leftCols(3)),
                "align_expressions: labels: got 9 x 3, expected 9 x 16");
    CHECK_FAULT(align_expressions(frames, head.moves.leftCols(9), head.expression),
                "align_expressions: shapes: got 9 columns");
    const std::vector<Columns<double>> two(frames.begin(), frames.begin() + 2);
    const AlignedExpressions kept =
        align_expressions(two, head.moves, head.expression.leftCols(2));
    CHECK(kept.coefficients == head.expression.leftCols(2));
    const AlignedExpressions a = align_expressions(frames, head.moves, head.expression),
                             b = align_expressions(frames, head.moves, head.expression);
    CHECK(a.coefficients == b.coefficients);
    CHECK(a.motion[5].rotation == b.motion[5].rotation);
}
