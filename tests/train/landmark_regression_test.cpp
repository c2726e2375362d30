// SPDX-License-Identifier: Apache-2.0
#include <rye/train/landmark_regression.hpp>

#include <algorithm>
#include <cmath>
#include <vector>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/core/thread_pool.hpp>
#include <rye/train/fit_deformation.hpp>

#include "../support/hostile.hpp"
#include "../support/tiny_avatar.hpp"

using namespace rye;
using namespace rye::test;

namespace {

constexpr Index coefficients = 20;
using B = ScalarBackend<>;

/// Which of the coefficients moves a landmark, and where to: one of them each. Lids rise with the
/// gaze of their own eye too.
struct Subject {
    AvatarConfig config = tiny_config();
    LandmarkRoles roles = tiny_roles();
    Columns<double> neutral, direction;

    Subject() {
        Draw draw;
        neutral = tiny_landmarks(draw);
        direction = draw.columns(3, neutral.cols(), 0.2);
        config.expression = coefficients;
    }
    MeshSample<double> frame(const VecX<double>& expression, const Vec2<double>& left,
                             const Vec2<double>& right) const {
        MeshSample<double> f;
        f.drivers.expression = expression;
        f.drivers.gaze = {gaze_vector(left[0], left[1]), gaze_vector(right[0], right[1])};
        f.drivers.pose.setZero();
        f.eye_displacement = Columns<double>::Zero(3, 2);
        f.landmarks = neutral;
        for (Index l = 0; l < neutral.cols(); ++l)
            f.landmarks.col(l) += expression[l % coefficients] * direction.col(l);
        for (const Index l : roles.eye[0]) f.landmarks(1, l) += 0.2 * left[0];
        for (const Index l : roles.eye[1]) f.landmarks(1, l) += 0.2 * right[0];
        return f;
    }
    /// Fewer frames than coefficients, in each of which a few are not 0, and both eyes look the
    /// same way.
    std::vector<MeshSample<double>> frames(Index count) const {
        Draw draw{{11, 0}};
        std::vector<MeshSample<double>> all;
        for (Index f = 0; f < count; ++f) {
            VecX<double> e = VecX<double>::Zero(coefficients);
            for (int k = 0; k < 5; ++k)
                e[draw.random.below(draw.next++, coefficients)] = 0.5 + 0.5 * draw();
            const Vec2<double> gaze(0.4 * draw(), 0.5 * draw());
            all.push_back(frame(e, gaze, gaze));
        }
        return all;
    }
    LandmarkRegression regression(const std::vector<MeshSample<double>>& frames,
                                  const RegressionConfig& prior = {}) const {
        return landmark_regression<double, PaperEffects>(B{}, {config, neutral, neutral}, roles,
                                                         frames, prior);
    }
    /// Relative error for the coefficient k alone.
    double error(const LandmarkRegression& r, Index k) const {
        const MeshSample<double> f = frame(0.6 * VecX<double>::Unit(coefficients, k),
                                           Vec2<double>(0.2, 0.1), Vec2<double>(0.2, 0.1));
        const Columns<double> got =
            neutral + r.displacement<double>(landmark_regressors(f.drivers));
        return (got - f.landmarks).norm() / (neutral - f.landmarks).norm();
    }
};

double rms(const Columns<double>& a, const Columns<double>& b) {
    return std::sqrt((a - b).squaredNorm() / static_cast<double>(a.cols()));
}

} // namespace

TEST_CASE("few frames give the displacements of expressions that none of them has") {
    const Subject subject;
    const auto frames = subject.frames(16);
    const LandmarkRegression r = subject.regression(frames);
    Draw draw{{12, 0}};
    for (int trial = 0; trial < 8; ++trial) {
        VecX<double> e = VecX<double>::Zero(coefficients);
        for (int k = 0; k < 3; ++k) e[draw.random.below(draw.next++, coefficients)] = 0.6;
        const MeshSample<double> f =
            subject.frame(e, Vec2<double>(0.2, 0.1), Vec2<double>(0.2, 0.1));
        const Columns<double> got =
            subject.neutral + r.displacement<double>(landmark_regressors(f.drivers));
        const double moved = rms(subject.neutral, f.landmarks);
        CHECK(rms(got, f.landmarks) < 0.2 * moved);
    }
}

TEST_CASE("fewer frames do where it is known which coefficients move a landmark") {
    const Subject subject;
    const auto frames = subject.frames(10);
    RegressionConfig prior;
    prior.expression_reach = Columns<double>::Constant(coefficients, subject.neutral.cols(), 0.05);
    // A third of the coefficients may move a landmark, the right one among them.
    for (Index l = 0; l < subject.neutral.cols(); ++l)
        for (Index k = 0; k < coefficients; ++k)
            if (k % 3 == (l % coefficients) % 3) prior.expression_reach(k, l) = 1;
    const LandmarkRegression without = subject.regression(frames);
    const LandmarkRegression with = subject.regression(frames, prior);
    double before = 0, after = 0;
    for (Index k = 0; k < coefficients; ++k) {
        before += subject.error(without, k) / coefficients;
        after += subject.error(with, k) / coefficients;
    }
    CHECK(before > 0.3);
    CHECK(after < 0.7 * before);
}

TEST_CASE("known shapes hold for coefficients that are 0 in all frames") {
    const Subject subject;
    auto frames = subject.frames(10);
    for (MeshSample<double>& f : frames) {
        VecX<double> e = f.drivers.expression;
        e[3] = 0;
        const auto angles = [&](std::size_t eye) { return pitch_yaw(f.drivers.gaze[eye]); };
        f = subject.frame(e, angles(0), angles(1));
    }
    RegressionConfig prior;
    prior.expression_shapes = Columns<double>::Zero(coefficients, 3 * subject.neutral.cols());
    for (Index l = 0; l < subject.neutral.cols(); ++l)
        prior.expression_shapes.row(l % coefficients).segment(3 * l, 3) =
            subject.direction.col(l).transpose();
    const LandmarkRegression without = subject.regression(frames);
    const LandmarkRegression with = subject.regression(frames, prior);
    CHECK(subject.error(without, 3) > 0.7);
    CHECK(subject.error(with, 3) < 0.1);
    CHECK(!without.knows_shapes);
    CHECK(with.knows_shapes);
    double largest = 0;
    std::vector<double> weights;
    for (const MeshSample<double>& f : frames) {
        const VecX<double>& e = f.drivers.expression;
        largest = std::max(largest, e.maxCoeff());
        weights.insert(weights.end(), e.data(), e.data() + e.size());
    }
    CHECK(with.largest == largest);
    int shown = 0, of_no_frame = 0; // weights of the coefficient that no frame has
    for (std::uint64_t k = 0; k < 200; ++k) {
        const auto mixed = [&](const LandmarkRegression& r) {
            return mixed_frame(frames, r, subject.neutral, Random{k, 0}).drivers.expression[3];
        };
        CHECK(mixed(without) == 0);
        const double weight = mixed(with);
        const bool known = std::find(weights.begin(), weights.end(), weight) != weights.end();
        shown += known && weight != 0 ? 1 : 0;
        of_no_frame += known ? 0 : 1;
        if (!known) {
            CHECK(weight > 0);
            CHECK(weight < largest);
        }
    }
    CHECK(shown > 3);
    CHECK(of_no_frame > 10);
    CHECK(of_no_frame < 40);
}

TEST_CASE("priors that do not fit the frames are refused") {
    const Subject subject;
    const auto frames = subject.frames(4);
    const Index landmarks = subject.neutral.cols();
    RegressionConfig prior;
    prior.expression_reach = Columns<double>::Ones(coefficients, landmarks - 1);
    CHECK_FAULT(subject.regression(frames, prior), "expected 20 x 66 numbers in (0, 1]");
    prior.expression_reach = Columns<double>::Ones(coefficients, landmarks);
    for (const double bad : {0.0, -1.0, 1.5, std::nan("")}) {
        prior.expression_reach(2, 5) = bad;
        CHECK_FAULT(subject.regression(frames, prior), "expected 20 x 66 numbers in (0, 1]");
    }
    prior.expression_reach.resize(0, 0);
    prior.expression_shapes = Columns<double>::Zero(coefficients, 3 * landmarks);
    prior.expression_shapes(0, 0) = std::nan("");
    CHECK_FAULT(subject.regression(frames, prior), "expected 20 x 198 finite numbers");
    prior.expression_shapes = Columns<double>::Zero(2, 3 * landmarks);
    CHECK_FAULT(subject.regression(frames, prior), "expression_shapes of 2 x 198");
}

TEST_CASE("a lid follows its own eye though no frame has eyes apart") {
    const Subject subject;
    const LandmarkRegression r = subject.regression(subject.frames(24));
    const VecX<double> rest = VecX<double>::Zero(coefficients);
    const MeshSample<double> apart =
        subject.frame(rest, Vec2<double>(0.3, 0), Vec2<double>(-0.3, 0));
    const Columns<double> d = r.displacement<double>(landmark_regressors(apart.drivers));
    for (const Index l : subject.roles.eye[0]) CHECK(d(1, l) == doctest::Approx(0.06).epsilon(0.2));
    for (const Index l : subject.roles.eye[1])
        CHECK(d(1, l) == doctest::Approx(-0.06).epsilon(0.2));
}

TEST_CASE("lids follow a gaze upward by another slope than downward") {
    const Subject subject;
    auto frames = subject.frames(24);
    const auto lid = [](double pitch) { return pitch > 0 ? 0.1 * pitch : 0.4 * pitch; };
    for (MeshSample<double>& f : frames)
        for (std::size_t eye = 0; eye < 2; ++eye) {
            const double pitch = pitch_yaw(f.drivers.gaze[eye])[0];
            for (const Index l : subject.roles.eye[eye])
                f.landmarks(1, l) += lid(pitch) - 0.2 * pitch;
        }
    const LandmarkRegression r = subject.regression(frames);
    const VecX<double> rest = VecX<double>::Zero(coefficients);
    for (const double pitch : {-0.3, 0.3}) {
        CAPTURE(pitch);
        const MeshSample<double> f =
            subject.frame(rest, Vec2<double>(pitch, 0), Vec2<double>(pitch, 0));
        const Columns<double> d = r.displacement<double>(landmark_regressors(f.drivers));
        for (std::size_t eye = 0; eye < 2; ++eye)
            for (const Index l : subject.roles.eye[eye])
                CHECK(std::abs(d(1, l) - lid(pitch)) < 0.01);
    }
}

TEST_CASE("the coefficients do not depend on the number of threads") {
    const Subject subject;
    const auto frames = subject.frames(16);
    const LandmarkRegression one = subject.regression(frames);
    ThreadPool pool(2);
    const ScalarBackend<ThreadPool::Handle> two{pool.threads()};
    const LandmarkRegression other = landmark_regression<double, PaperEffects>(
        two, {subject.config, subject.neutral, subject.neutral}, subject.roles, frames);
    CHECK(one.coefficient == other.coefficient);
    CHECK(one.coefficient.allFinite());
}

TEST_CASE("frames of other landmarks are refused") {
    const Subject subject;
    auto frames = subject.frames(3);
    frames[1].landmarks.conservativeResize(3, 10);
    CHECK_FAULT(subject.regression(frames), "got a frame of 10 landmarks, expected 66");
}

TEST_CASE("noise of landmarks is found, and no coefficient explains it") {
    const Subject subject;
    const auto noise_of = [&](const std::vector<MeshSample<double>>& frames) {
        return landmark_noise<double, PaperEffects>(
            B{}, {subject.config, subject.neutral, subject.neutral}, subject.roles, frames);
    };
    auto frames = subject.frames(24);
    const auto unseen = subject.frames(32);
    CHECK(noise_of(frames) == 0);
    Draw draw{{13, 0}};
    for (MeshSample<double>& f : frames)
        f.landmarks += draw.columns(3, f.landmarks.cols(), 0.015 * std::sqrt(3.0)); // to one sigma
    const double noise = noise_of(frames);
    CAPTURE(noise);
    CHECK(noise >= 0.005);
    CHECK(noise <= 0.03);
    const auto error = [&](double knows) {
        RegressionConfig prior;
        prior.noise = knows;
        const LandmarkRegression r = subject.regression(frames, prior);
        double sum = 0;
        for (std::size_t f = 24; f < unseen.size(); ++f)
            sum += rms(subject.neutral +
                           r.displacement<double>(landmark_regressors(unseen[f].drivers)),
                       unseen[f].landmarks);
        return sum;
    };
    CAPTURE(error(noise));
    CAPTURE(error(0));
    CHECK(error(noise) < 0.8 * error(0));
    frames.resize(7);
    CHECK(noise_of(frames) == 0); // too few to tell
}

TEST_CASE("mixed frames: coefficients of two frames or 0, landmarks of the regression") {
    const Subject subject;
    const auto frames = subject.frames(6);
    const LandmarkRegression r = subject.regression(frames);
    bool differs = false;
    for (std::uint64_t k = 0; k < 20; ++k) {
        const MeshSample<double> m = mixed_frame(frames, r, subject.neutral, Random{k, 0});
        for (Index i = 0; i < coefficients; ++i) {
            bool known = m.drivers.expression[i] == 0;
            for (const auto& f : frames)
                known |= m.drivers.expression[i] == f.drivers.expression[i];
            CHECK(known);
        }
        CHECK(m.landmarks ==
              subject.neutral + r.displacement<double>(landmark_regressors(m.drivers)));
        differs |= angular_error(m.drivers.gaze[0], m.drivers.gaze[1]) > 0.1;
        CHECK(m.landmarks ==
              mixed_frame(frames, r, subject.neutral, Random{k, 0}).landmarks); // to the bit
    }
    CHECK(differs);
}

TEST_CASE("mixed frames blink, wholly where shapes are known, else as far as a frame does") {
    const Subject subject;
    auto frames = subject.frames(6);
    for (auto& f : frames) f.drivers.expression[1] *= 0.1; // eyes that hardly close
    double largest = 0;
    for (const auto& f : frames)
        for (const Index k : {1, 2}) largest = std::max(largest, f.drivers.expression[k]);
    for (const bool known : {false, true}) {
        CAPTURE(known);
        RegressionConfig prior;
        prior.blinks = {1, 2};
        if (known)
            prior.expression_shapes =
                Columns<double>::Zero(coefficients, 3 * subject.neutral.cols());
        const LandmarkRegression r = subject.regression(frames, prior);
        const double whole = known ? 1 : largest;
        CHECK(r.whole_blink == whole);
        int alike = 0, nearly = 0;
        for (std::uint64_t k = 0; k < 1000; ++k) {
            const VecX<double> e =
                mixed_frame(frames, r, subject.neutral, Random{k, 0}).drivers.expression;
            CHECK(e.maxCoeff() <= std::max(whole, r.largest));
            alike += e[1] == e[2] && e[1] > 0;
            nearly += e[1] == e[2] && e[1] > 0.8 * whole;
        }
        // 0.3 of the frames blink, of which 0.8 squared with both eyes alike; of these 0.36 nearly.
        CHECK(alike > 0.14 * 1000);
        CHECK(nearly > 0.04 * 1000);
    }
    RegressionConfig wrong;
    wrong.blinks = {coefficients};
    CHECK_THROWS_WITH_AS(subject.regression(frames, wrong), doctest::Contains("among the blinks"),
                         Error);
}

TEST_CASE("networks fitted to mixed frames too are nearer to expressions that no frame has") {
    const Subject subject;
    const auto frames = subject.frames(12);
    const auto error = [&](double mixed) {
        GuidanceMesh<double> mesh =
            GuidanceMesh<double>::init(subject.config, subject.neutral, Random{3, 0});
        DeformationFit fit{300, 2, 8e-3, Random{1, 0}};
        fit.mixed = mixed;
        const LandmarkStage stage{subject.config, subject.roles, true};
        fit_deformation<double>(B{}, mesh, stage, frames, fit);
        double squares = 0;
        for (Index k = 0; k < coefficients; ++k) {
            const MeshSample<double> f = subject.frame(0.5 * VecX<double>::Unit(coefficients, k),
                                                       Vec2<double>::Zero(), Vec2<double>::Zero());
            LandmarkTrace<double> trace;
            squares += static_cast<double>(
                landmark_losses(B{}, mesh, {stage, MeshLossConfig{}}, f, trace).deform);
        }
        return std::sqrt(squares);
    };
    CHECK(error(0.7) < 0.8 * error(0));
}
