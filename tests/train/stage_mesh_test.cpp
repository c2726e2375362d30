// SPDX-License-Identifier: Apache-2.0
#include <rye/train/stage_mesh.hpp>

#include <doctest/doctest.h>

#include "../support/tiny_mesh.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using B = ScalarBackend<>;

template <class T>
double law_error(bool follow_gaze, ChosenMetric metric, std::uint64_t seed,
                 LaplacianUnit unit = LaplacianUnit::world) {
    using D = Dual<T, 1>;
    AvatarConfig config = tiny_config();
    config.metric = metric;
    const TetGrid<double> grid = tiny_grid();
    const GuidanceMesh<T> mesh = lifted<T>(tiny_mesh());
    MeshLossConfig weights;
    weights.laplacian = unit == LaplacianUnit::world ? 1 : 100; // more would drown the others
    weights.laplacian_unit = unit;
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
    detail::seed_fields(dual, mesh, direction);
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
    CHECK(law_error<double>(true, SquaredDistance{}, 4, LaplacianUnit::metre) <= 1e-12);
}

TEST_CASE("the guidance step: the Laplacian in metres does not depend on the world's unit") {
    const AvatarConfig config = tiny_config();
    const GuidanceMesh<double> mesh = tiny_mesh();
    const LandmarkRoles roles = tiny_roles();
    const TetGrid<double> grid = tiny_grid();
    struct Step {
        MeshLosses<double> losses;
        Columns<double> gradient;
    };
    // No pictures: g_world has the Laplacian's gradient alone.
    const auto step = [&](double scale, LaplacianUnit unit) {
        MeshLossConfig weights;
        weights.laplacian_unit = unit;
        const MeshStage<double> stage{{{config, roles, true}, weights}, grid};
        MeshSample<double> sample = tiny_sample<double>();
        sample.views.clear();
        sample.drivers.scale = scale;
        MeshTrace<double> trace;
        const MeshLosses<double> l = mesh_losses(B{}, mesh, stage, sample, trace);
        CHECK(l.vertices > 50);
        return Step{l, trace.g_world};
    };
    CHECK(MeshLossConfig{}.laplacian_unit == LaplacianUnit::metre);
    const Step world = step(1, LaplacianUnit::world), metre = step(1, LaplacianUnit::metre);
    CHECK(world.losses.laplacian > 0);
    CHECK(metre.losses.laplacian == doctest::Approx(world.losses.laplacian / 100).epsilon(1e-12));
    CHECK((100 * metre.gradient - world.gradient).norm() < 1e-12 * world.gradient.norm());
    CHECK(world.losses.total - metre.losses.total ==
          doctest::Approx(99 * world.losses.laplacian).epsilon(1e-9));
    // A world in metres and one in decimetres.
    const Step in_metres = step(0.1, LaplacianUnit::metre);
    CHECK(in_metres.losses.laplacian == doctest::Approx(metre.losses.laplacian).epsilon(1e-12));
    CHECK(step(0.1, LaplacianUnit::world).losses.laplacian ==
          doctest::Approx(world.losses.laplacian / 100).epsilon(1e-12));
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
