// SPDX-License-Identifier: Apache-2.0
// The oracle against itself: its sums in long double, its gradient against the rasterizer's without
// any shortcut, which the duals have checked.
#include <rye/splat/oracle_vjp.hpp>

#include <rye/splat/rasterizer.hpp>

#include <doctest/doctest.h>

#include "../support/scenes.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("oracle: sums in double are those in long double to 1e-12") {
    for (const auto& s : hard_scenes<double>(3)) {
        CAPTURE(s.name);
        const auto order = depth_order(s.gaussians, s.camera);
        const auto a = oracle(s.gaussians, s.camera, s.background, order);
        const auto b = oracle<long double>(s.gaussians, s.camera, s.background, order);
        CHECK((a.feature.pixels - b.feature.pixels).cwiseAbs().maxCoeff() < 1e-12);
        CHECK((a.depth.pixels - b.depth.pixels).cwiseAbs().maxCoeff() < 1e-12);
    }
}

TEST_CASE("oracle: the gradient by duals and by the adjoint agree to 1e-11, most to 1e-12") {
    for (const auto& s : hard_scenes<double>(3)) {
        if (s.gaussians.count() == 0) continue;
        CAPTURE(s.name);
        const auto order = depth_order(s.gaussians, s.camera);
        const Rasterizer<> exact{Exact64()};
        const auto r = exact.forward(ScalarBackend<>{}, s.gaussians, s.camera, s.background);
        const Columns<double> w = noise<double>(3, r.feature.size(), 1);
        const Columns<double> wa = noise<double>(1, r.feature.size(), 2);
        const auto truth = oracle_vjp({s.gaussians, s.camera, order, {}}, s.background, {w, wa});
        const auto g = exact.vjp(ScalarBackend<>{}, s.gaussians, s.camera, s.background, r, w, &wa);
        // Behind an opaque wall the rasterizer stops at 1e-14, the oracle never.
        const double bound = s.name == "opaque wall" ? 2e-11 : 1e-12;
        Gaussians<double>::fields(
            [&](const std::string& name, const Columns<double>& x, const Columns<double>& y) {
                CAPTURE(name);
                CHECK((x - y).norm() <= bound * y.norm());
            },
            g, truth);
    }
}
