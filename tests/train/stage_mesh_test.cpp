// SPDX-License-Identifier: Apache-2.0
#include <rye/train/stage_mesh.hpp>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>

#include <rye/train/initialize.hpp>

#include "../support/tiny_avatar.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using B = ScalarBackend<>;

TetGrid<double> tiny_grid() {
    return bcc_grid<double>(Vec3<double>(-1.6, -1.5, -1.5), Vec3<double>(1.6, 1.7, 1.7), 0.5);
}

template <class T>
TetGrid<T> grid_in(const TetGrid<double>& g) {
    return {g.vertices.unaryExpr([](double x) { return T(static_cast<real_t<T>>(x)); }), g.topology};
}

/// A guidance mesh that has learned a sphere.
GuidanceMesh<double> tiny_mesh() {
    Draw draw;
    GuidanceMesh<double> m =
        GuidanceMesh<double>::init(tiny_config(), tiny_landmarks(draw), Random{3, 0});
    pretrain_sphere<double>(B{}, m, tiny_config(), {Vec3<double>(0, 0.1, 0.1), 1.6, 60, 5e-3},
                            Random{4, 0});
    m.eye_offset.mlp.weight.back() = draw.columns(6, m.eye_offset.mlp.weight.back().cols(), 0.3);
    return m;
}

template <class T>
MeshSample<T> tiny_sample() {
    Draw draw{{5, 0}};
    const auto columns = [&](Index rows, Index cols, double size, double middle) {
        return Columns<T>(draw.columns(rows, cols, size).unaryExpr(
            [&](double x) { return T(static_cast<real_t<T>>(x + middle)); }));
    };
    MeshSample<T> s;
    s.drivers = tiny_drivers<T>();
    s.landmarks = columns(3, 66, 0.5, 0.2);
    s.eye_displacement = columns(3, 2, 0.05, 0);
    for (int v = 0; v < 2; ++v) {
        MeshView<T> view;
        view.camera = tiny_camera(26 + v, 22).cast<real_t<T>>();
        view.truth = Image<T>(26 + v, 22, 3);
        view.truth.pixels = columns(3, view.truth.size(), 0.5, 0.5);
        view.mask = columns(1, view.truth.size(), 0.5, 0.5);
        view.visible = Columns<T>::Ones(1, view.truth.size());
        view.visible(0, 7) = T(0);
        s.views.push_back(view);
    }
    return s;
}

template <class T>
double law_error(bool follow_gaze, ChosenMetric metric, std::uint64_t seed) {
    using D = Dual<T, 1>;
    AvatarConfig config = tiny_config();
    config.metric = metric;
    const TetGrid<double> grid = tiny_grid();
    const GuidanceMesh<T> mesh = lifted<T>(tiny_mesh());
    MeshLossConfig weights;
    weights.laplacian = 1;  // 100 would drown the others
    MeshTrace<T> trace;
    const LandmarkRoles roles = tiny_roles();
    const WeightedLandmarks landmarks{{config, roles, follow_gaze}, weights};
    const TetGrid<T> own = grid_in<T>(grid);
    const MeshStage<T> stage{landmarks, own};
    const MeshLosses<T> l = mesh_losses(B{}, mesh, stage, tiny_sample<T>(), trace);
    CHECK(l.vertices > 50);
    GuidanceMesh<T> grad = zeros_like(mesh);
    mesh_losses_vjp(B{}, mesh, stage, trace, grad);
    const GuidanceMesh<T> direction = random_like(mesh, Random{seed, 5});
    GuidanceMesh<D> dual = lifted<D>(mesh);
    seed_fields(dual, mesh, direction);
    MeshTrace<D> dual_trace;
    const TetGrid<D> dual_grid = grid_in<D>(grid);
    const MeshStage<D> dual_stage{landmarks, dual_grid};
    const MeshLosses<D> dl = mesh_losses(B{}, dual, dual_stage, tiny_sample<D>(), dual_trace);
    DotSum by_vjp, by_dual;
    by_vjp.add_all(grad, direction);
    by_dual.sum = static_cast<double>(dl.total.d[0]);
    CHECK(by_vjp.magnitude > 0.01);
    return disagreement(by_vjp, by_dual);
}

} // namespace

TEST_CASE("the guidance step: its vjp is the transpose of its duals, in double") {
    CHECK(law_error<double>(false, SquaredDistance{}, 1) <= 1e-12);
    CHECK(law_error<double>(true, SquaredDistance{}, 2) <= 1e-12);
    CHECK(law_error<double>(true, EuclideanDistance{}, 3) <= 1e-12);
}

TEST_CASE("the guidance step: its vjp is the transpose of its duals, in float") {
    CHECK(law_error<float>(true, SquaredDistance{}, 1) <= 1e-5);
}

TEST_CASE("no surface: image terms are left out, the others train on") {
    const AvatarConfig config = tiny_config();
    GuidanceMesh<double> mesh = tiny_mesh();
    mesh.geometry.bias.back()(0, 0) += 50;  // everywhere outside
    MeshTrace<double> trace;
    const LandmarkRoles roles = tiny_roles();
    const MeshLossConfig weights;
    const TetGrid<double> grid = tiny_grid();
    const MeshStage<double> stage{{{config, roles, true}, weights}, grid};
    const MeshLosses<double> l = mesh_losses(B{}, mesh, stage, tiny_sample<double>(), trace);
    CHECK(l.vertices == 0);
    CHECK(l.rgb == 0);
    CHECK(l.deform > 0);
    GuidanceMesh<double> grad = zeros_like(mesh);
    mesh_losses_vjp(B{}, mesh, stage, trace, grad);
    GuidanceMesh<double>::fields([](const std::string&, const auto& a) { CHECK(a.allFinite()); }, grad);
    CHECK_THROWS_WITH_AS(
        (initialize_avatar<double>(B{}, mesh, config, AvatarInit<double>{}, Random{})),
        doctest::Contains("no surface"), Error);
}
