// SPDX-License-Identifier: Apache-2.0
#include <rye/train/fit_deformation.hpp>

#include <cmath>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/core/thread_pool.hpp>
#include <rye/train/initialize.hpp>

#include "../support/tiny_avatar.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using B = ScalarBackend<>;

/// Frames in which the first expression coefficient lifts all landmarks, and the second moves them
/// sideways.
std::vector<MeshSample<double>> frames_of(const GuidanceMesh<double>& mesh) {
    Draw draw{{8, 0}};
    std::vector<MeshSample<double>> frames(6);
    for (MeshSample<double>& f : frames) {
        f.drivers = tiny_drivers<double>();
        f.drivers.expression = draw.columns(3, 1, 0.8);
        f.landmarks = mesh.landmarks;
        f.landmarks.row(1).array() += 0.15 * f.drivers.expression[0];
        f.landmarks.row(0).array() += 0.1 * f.drivers.expression[1];
        f.eye_displacement = Columns<double>::Zero(3, 2);
    }
    return frames;
}

} // namespace

TEST_CASE("the deformations fit the landmarks of all frames, and nothing else is touched") {
    Draw draw;
    const AvatarConfig config = tiny_config();
    GuidanceMesh<double> mesh =
        GuidanceMesh<double>::init(config, tiny_landmarks(draw), Random{3, 0});
    const GuidanceMesh<double> before = mesh;
    const auto frames = frames_of(mesh);
    const auto fit = [&](int steps) {
        mesh = before;
        return fit_deformation<double>(B{}, mesh, {config, tiny_roles(), true}, frames,
                                       {steps, 2, 5e-3, Random{1, 0}});
    };
    const double first = fit(6);
    const double last = fit(1500);
    CHECK(first > 0.03);
    CHECK(last < 0.2 * first);
    const GuidanceMesh<double> once = mesh;
    CHECK(fit(1500) == last);  // to the bit
    GuidanceMesh<double>::fields([](const std::string& name, const auto& now, const auto& then,
                                    const auto& old) {
        CHECK(now == then);
        const bool moves = name.starts_with("exp_deform") ||
                           name.find("gaze_deform") != std::string::npos;
        if (!moves) CHECK_MESSAGE(now == old, name);
    }, mesh, once, before);
    CHECK(mesh.networks.exp_deform.weight.front() != before.networks.exp_deform.weight.front());
}

TEST_CASE("many landmarks are fitted in pieces, whose sum is the error of all, by any threads") {
    Draw draw;
    const AvatarConfig config = tiny_config();
    Columns<double> landmarks(3, 2500); // three pieces
    landmarks << tiny_landmarks(draw), draw.columns(3, 2500 - 66, 0.6);
    const GuidanceMesh<double> before =
        GuidanceMesh<double>::init(config, landmarks, Random{3, 0});
    std::vector<MeshSample<double>> frames = frames_of(before);
    frames.resize(1);
    const LandmarkStage stage{config, tiny_roles(), true};
    const auto deform = [&](const GuidanceMesh<double>& mesh) {
        LandmarkTrace<double> trace;
        return static_cast<double>(
            landmark_losses(B{}, mesh, {stage, MeshLossConfig{}}, frames[0], trace).deform);
    };
    const auto fitted = [&](const auto& backend, int steps, double& left) {
        GuidanceMesh<double> mesh = before;
        left = fit_deformation<double>(backend, mesh, stage, frames,
                                       {steps, 2, 5e-3, Random{1, 0}});
        return mesh;
    };
    double first = 0, last = 0, same = 0;
    fitted(B{}, 1, first);
    CHECK(first == doctest::Approx(std::sqrt(deform(before))).epsilon(1e-12));
    const GuidanceMesh<double> mesh = fitted(B{}, 30, last);
    CHECK(last < 0.8 * first);
    CHECK(std::sqrt(deform(mesh)) < last);
    ThreadPool pool(3);
    const GuidanceMesh<double> again =
        fitted(ScalarBackend<ThreadPool::Handle>{pool.threads()}, 30, same);
    CHECK(same == last);
    GuidanceMesh<double>::fields(
        [](const std::string& name, const auto& x, const auto& y) { CHECK_MESSAGE(x == y, name); },
        mesh, again);
}

TEST_CASE("lids that weigh more are fitted sooner") {
    Draw draw;
    const AvatarConfig config = tiny_config();
    const GuidanceMesh<double> before =
        GuidanceMesh<double>::init(config, tiny_landmarks(draw), Random{3, 0});
    std::vector<MeshSample<double>> frames = frames_of(before);
    for (MeshSample<double>& f : frames)
        for (Index k = 36; k < 48; ++k) f.landmarks(1, k) -= 0.3 * f.drivers.expression[2];
    const LandmarkStage stage{config, tiny_roles(), true};
    const auto off_at_lids = [&](double lids) {
        GuidanceMesh<double> mesh = before;
        DeformationFit fit{800, 2, 5e-3, Random{1, 0}};
        fit.lids = lids;
        fit_deformation<double>(B{}, mesh, stage, frames, fit);
        double squares = 0;
        for (const MeshSample<double>& f : frames) {
            LandmarkTrace<double> trace;
            landmark_losses(B{}, mesh, {stage, MeshLossConfig{}}, f, trace);
            squares += (trace.deformed - f.landmarks).middleCols(36, 12).squaredNorm();
        }
        return std::sqrt(squares);
    };
    const double alike = off_at_lids(1);
    CHECK(alike > 0.1);
    CHECK(off_at_lids(10) < 0.8 * alike);
}

TEST_CASE("drivers that start at zero change nothing before training") {
    AvatarConfig config = tiny_config();
    config.drivers_from_zero = true;
    const FaceNetworks<double> n = FaceNetworks<double>::init(config, Random{1, 0});
    Draw draw;
    const Columns<double> points = draw.columns(config.position_code(), 5);
    const Mlp<double>& m = n.exp_deform;
    const Columns<double> neutral =
        mlp_forward<double>(B{}, m, points, VecX<double>::Zero(3), nullptr);
    const Columns<double> driven =
        mlp_forward<double>(B{}, m, points, VecX<double>::Ones(3), nullptr);
    CHECK(neutral == driven);
    CHECK(neutral.norm() > 0);
}

TEST_CASE("points in an eyeball leave it by the shortest way, others stay") {
    Columns<double> ball(3, 2);
    ball << 0, 0.1, 0, 0, 0.2, 0;
    Columns<double> points(3, 3);
    points << 1.05, 1, 1.5, 2, 2, 2, 3.05, 3.1, 3;
    const Columns<double> before = points;
    const Vec3<double> centre(1, 2, 3);
    leave_eyeball<double>(ball, centre, points);
    for (Index i = 0; i < 2; ++i) {
        const Vec3<double> d = points.col(i) - centre;
        CHECK(d.norm() > 0.2);
        CHECK(d.norm() < 0.21);
        CHECK(d.normalized().dot((before.col(i) - centre).normalized()) == doctest::Approx(1));
    }
    CHECK(points.col(2) == before.col(2));
}
