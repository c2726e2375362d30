// SPDX-License-Identifier: Apache-2.0
// The reverse derivative of the whole rasterizer against its forward derivative on duals, by the
// dot-product test <J v, w> = <v, J^T w>, relative to the sum of the magnitudes of the terms.
#include <rye/splat/rasterizer.hpp>

#include <doctest/doctest.h>

#include "../support/render_law.hpp"

using namespace rye;
using namespace rye::test;

namespace {

template <class B, class A, class T>
double gap(const Scenery<T>& s, const A& accuracy, std::uint64_t seed) {
    return render_law_gap<B>(s, s.camera, accuracy, seed);
}

} // namespace

TEST_CASE("rasterizer vjp: dot-product test on random scenes") {
    for (std::uint64_t seed = 0; seed < 6; ++seed)
        for (const Index channels : {1, 3, 5}) {
            CAPTURE(seed);
            const auto s = random_scene<double>(80, channels, seed);
            CHECK(gap<ScalarBackend<>>(s, Balanced(), seed) < 1e-13);
            CHECK(gap<ScalarBackend<>>(s, Balanced(Exact64()), seed) < 1e-13);
            CHECK(gap<ScalarBackend<>>(s, Balanced(Fast()), seed) < 1e-13);
            CHECK(gap<ScalarBackend<>>(s, Compatible3dgsFloor(), seed) < 1e-13);
        }
}

TEST_CASE("rasterizer vjp: dot-product test on hard scenes") {
    for (const auto& s : hard_scenes<double>(3)) {
        CAPTURE(s.name);
        CHECK(gap<ScalarBackend<>>(s, Balanced(), 11) < 1e-12);
        CHECK(gap<ScalarBackend<>>(s, Balanced(Exact64()), 12) < 1e-12);
    }
}

TEST_CASE("rasterizer vjp: dot-product test in float") {
    for (std::uint64_t seed = 0; seed < 6; ++seed)
        CHECK(gap<ScalarBackend<>>(random_scene<float>(80, 3, seed), Balanced(), seed) < 2e-6);
    for (const auto& s : hard_scenes<float>(3)) {
        CAPTURE(s.name);
        // A needle of length sigma px has exponents that are uncertain by u sigma / sqrt(dilation).
        const bool needles = s.name == "needles of 300 px";
        CHECK(gap<ScalarBackend<>>(s, Balanced(), 13) < (needles ? 1e-4 : 1e-5));
    }
}

TEST_CASE("rasterizer vjp: the background's gradient is the transmittance") {
    const auto s = random_scene<double>(40, 2, 3);
    const Rasterizer<> rasterizer;
    const auto at = [&](double step) {
        VecX<double> b = s.background;
        b[1] += step;
        return rasterizer.forward(ScalarBackend<>{}, s.gaussians, s.camera, b);
    };
    const auto raster = at(0);
    const Columns<double> w = noise<double>(2, raster.feature.size(), 1);
    const double slope = (at(1).feature.pixels - raster.feature.pixels).cwiseProduct(w).sum();
    CHECK(background_vjp(raster, w)[1] == doctest::Approx(slope).epsilon(1e-12));
}

TEST_CASE("rasterizer vjp: a Gaussian of the colour behind it has exactly no gradient of opacity") {
    auto s = random_scene<double>(30, 3, 4);
    s.gaussians.feature.colwise() = s.background;
    const Rasterizer<> rasterizer;
    const auto raster = rasterizer.forward(ScalarBackend<>{}, s.gaussians, s.camera, s.background);
    // Sums of equal products are equal, so every difference s - b is 0, not merely small.
    const auto g = rasterizer.vjp(ScalarBackend<>{}, s.gaussians, s.camera, s.background, raster,
                                  noise<double>(3, raster.feature.size(), 2));
    CHECK(g.opacity.cwiseAbs().maxCoeff() == 0);
    CHECK(g.mean.cwiseAbs().maxCoeff() == 0);
    CHECK(g.feature.cwiseAbs().maxCoeff() > 0);
}
