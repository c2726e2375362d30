// SPDX-License-Identifier: Apache-2.0
// Forward mode with vectors of 4, 8 and 16 floats (2, 4 and 8 doubles), by vectors of plain arrays
// on any machine, against the render on duals.
#include <rye/splat/jvp.hpp>

#include <doctest/doctest.h>

#include "../support/scenes.hpp"
#include "../support/array_lanes.hpp"

using namespace rye;
using namespace rye::test;

namespace {

/// The largest difference of images and tangents, relative to the largest number of each.
template <class B, class A>
double gap(const Scenery<double>& s, const A& accuracy) {
    Gaussians<double> v = noise_like(s.gaussians, 3);
    v.scale = v.scale.cwiseProduct(s.gaussians.scale);
    Pinhole<double> camera;
    camera.cx = 0.3;
    camera.camera_from_world.translation << 0.1, -0.2, 0.1;
    const RasterTangents<double> along{&v, &camera};
    const Rasterizer<A> rasterizer{accuracy};
    const auto lanes = rasterizer.jvp(B{}, s.gaussians, along, s.camera, s.background);
    const auto plain =
        rasterizer.jvp(ScalarBackend{Serial{}}, s.gaussians, along, s.camera, s.background);
    double worst = 0;
    const auto compare = [&](const Columns<double>& a, const Columns<double>& b) {
        REQUIRE(a.rows() == b.rows());
        REQUIRE(a.cols() == b.cols());
        if (a.size() == 0) return;
        worst = std::max(worst, (a - b).cwiseAbs().maxCoeff() / (1e-3 + b.cwiseAbs().maxCoeff()));
    };
    compare(lanes.value.feature.pixels, plain.value.feature.pixels);
    compare(lanes.value.alpha.pixels, plain.value.alpha.pixels);
    compare(lanes.feature, plain.feature);
    compare(lanes.alpha, plain.alpha);
    compare(lanes.depth, plain.depth);
    return worst;
}

} // namespace

TEST_CASE_TEMPLATE("widths: forward mode is that of duals", B, ArrayBackend<4>, ArrayBackend<8>,
                   ArrayBackend<16>) {
    for (const Index channels : {1, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 32, 33}) {
        CAPTURE(channels);
        const auto s = random_scene<double>(60, channels, std::uint64_t(channels));
        CHECK(gap<B>(s, Balanced(Exact64())) < 1e-10);
        CHECK(gap<B>(s, Balanced()) < 1e-10);
    }
    const auto s = random_scene<double>(60, 9, 1);
    CHECK(gap<B>(s, Compatible3dgsFloor()) < 1e-10);
}
