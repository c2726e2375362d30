// SPDX-License-Identifier: Apache-2.0
// The selected policy keeps its bound against the oracle, is at most one rung finer than needed,
// and its report is correct. `bench_accuracy --only select` times the same on 100 scenes.
#include <rye/splat/select_accuracy.hpp>

#include <rye/splat/oracle.hpp>
#include <rye/splat/lanes.hpp>

#include <doctest/doctest.h>

#include "../support/scenes.hpp"

using namespace rye;
using namespace rye::test;

namespace {

/// The error of a rung's picture.
double error_of(const Scenery<float>& s, const Balanced& accuracy, const OracleImages& truth) {
    const auto r =
        Rasterizer<>{accuracy}.forward(XsimdBackend<>{}, s.gaussians, s.camera, s.background);
    return (r.feature.pixels.cast<double>() - truth.feature.pixels).cwiseAbs().maxCoeff();
}

} // namespace

TEST_CASE("select_accuracy: the bound is kept, by the first rung that keeps it or the next") {
    for (std::uint64_t seed = 0; seed < 8; ++seed) {
        CAPTURE(seed);
        const auto s = random_scene<float>(200, 3, 100 + seed, 0.02 + 0.03 * double(seed % 4));
        Gaussians<double> g;
        convert_fields(g, s.gaussians, [](float x) { return static_cast<double>(x); });
        const auto truth = oracle(g, s.camera.cast<double>(), s.background.cast<double>(),
                                  depth_order(s.gaussians, s.camera));
        for (const double bound : {2e-2, 1.0 / 255, 5e-4}) {
            CAPTURE(bound);
            const SelectedAccuracy chosen =
                select_accuracy(XsimdBackend<>{}, s.gaussians, s.camera, s.background, bound);
            CHECK(chosen.met);
            CHECK(error_of(s, chosen.accuracy, truth) <= bound);
            CHECK(chosen.sampled_error <= bound);
            std::size_t first = 0, mine = 0;
            while (error_of(s, accuracy_ladder[first].accuracy(), truth) > bound) ++first;
            while (chosen.name != accuracy_ladder[mine].name) ++mine;
            CHECK(mine >= first);
            CHECK(mine <= first + 1);
        }
    }
}

TEST_CASE("select_accuracy: what cannot be promised is not") {
    const auto s = random_scene<float>(50, 3, 5);
    const auto strict =
        select_accuracy(ScalarBackend<>{}, s.gaussians, s.camera, s.background, 1e-6);
    CHECK_FALSE(strict.met);
    CHECK(strict.name == "Exact32");
    const auto loose = select_accuracy(ScalarBackend<>{}, s.gaussians, s.camera, s.background, 1.0);
    CHECK(loose.name == accuracy_ladder.front().name);
    CHECK_THROWS_AS(select_accuracy(ScalarBackend<>{}, s.gaussians, s.camera, s.background, 0),
                    Error);
    const auto none = random_scene<float>(0, 3, 5);
    CHECK(
        select_accuracy(ScalarBackend<>{}, none.gaussians, none.camera, none.background, 0.01).met);
}

TEST_CASE("select_accuracy: the confidence is that of the sample") {
    auto s = random_scene<float>(60, 3, 6);
    s.camera.width = s.camera.height = 20 * detail::tile_edge;
    const auto chosen =
        select_accuracy(XsimdBackend<>{}, s.gaussians, s.camera, s.background, 0.01);
    CHECK(chosen.tiles == 128);
    CHECK(chosen.failing_share == doctest::Approx(3.0 / 64));
    detail::SelectSettings all;
    all.random_tiles = 400;
    CHECK(select_accuracy(XsimdBackend<>{}, s.gaussians, s.camera, s.background, 0.01, all)
              .failing_share == 0);
    // The same scene and seed give the same choice, independent of threads.
    const auto again = select_accuracy(XsimdBackend<>{}, s.gaussians, s.camera, s.background, 0.01);
    CHECK(again.name == chosen.name);
    CHECK(again.sampled_error == chosen.sampled_error);
}
