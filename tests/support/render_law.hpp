// SPDX-License-Identifier: Apache-2.0
/// tests/support/render_law.hpp: the dot-product test <J v, w> = <v, J'w> of a render, for any
/// backend, rules and camera, with J v by duals through plain loops.
#pragma once

#include <doctest/doctest.h>

#include <rye/autodiff/check.hpp>
#include <rye/backend/scalar.hpp>
#include <rye/splat/rasterizer.hpp>

#include "scenes.hpp"

namespace rye::test {

/// The disagreement of the two sides for random cotangents of the colours, alpha and depth, and a
/// random direction of all numbers of the Gaussians.
template <class B, class A, class T, class Camera>
double render_law_gap(const Scenery<T>& s, const Camera& camera, const A& accuracy,
                      std::uint64_t seed) {
    using D = Dual<T, 1>;
    const Rasterizer<A> rasterizer{accuracy};
    const Index pixels = Index(camera.width) * camera.height;
    const Columns<T> wf = noise<T>(s.gaussians.channels(), pixels, seed + 1);
    const Columns<T> wa = noise<T>(1, pixels, seed + 2), wd = noise<T>(1, pixels, seed + 3);
    Gaussians<T> v = noise_like(s.gaussians, seed + 4);
    v.scale = v.scale.cwiseProduct(s.gaussians.scale).eval();

    const Raster<T> raster = rasterizer.forward(B{}, s.gaussians, camera, s.background);
    const Gaussians<T> g =
        rasterizer.vjp(B{}, s.gaussians, camera, s.background, raster, wf, &wa, &wd);
    Gaussians<T>::fields(
        [&](const std::string& name, const Columns<T>& a) {
            CHECK_MESSAGE(a.allFinite(), s.name << ": gradient of " << name);
        },
        g);
    Gaussians<D> dual(s.gaussians.count(), s.gaussians.channels());
    detail::seed_fields(dual, s.gaussians, v);
    const VecX<D> background = s.background.template cast<D>();
    const Raster<D> moved =
        rasterizer.forward(ScalarBackend<>{}, dual, camera.template cast<D>(), background);
    DotSum forward, reverse;
    const auto add = [&](const Columns<D>& a, const Columns<T>& w) {
        forward.add(Columns<T>(a.unaryExpr([](const D& x) { return x.d[0]; })), w);
    };
    add(moved.feature.pixels, wf);
    add(moved.alpha.pixels, wa);
    add(moved.depth.pixels, wd);
    reverse.add_all(g, v);
    CHECK((reverse.magnitude > 0 || raster.alpha.pixels.isZero(0)));
    const double scale = reverse.magnitude + 1e-30;
    return std::abs(forward.sum - reverse.sum) / scale;
}

} // namespace rye::test
