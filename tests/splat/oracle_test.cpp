// SPDX-License-Identifier: Apache-2.0
// Every accuracy policy against the oracle (every Gaussian at every pixel in double): the bounds of
// the presets, on random and on hard scenes.
#include <rye/splat/oracle.hpp>

#include <rye/splat/lanes.hpp>

#include <doctest/doctest.h>

#include "../support/scenes.hpp"

using namespace rye;
using namespace rye::test;

namespace {

struct Gap {
    double largest = 0, rms = 0;
};

/// Errors of a policy's images relative to the oracle, for the same inputs. Presets that share
/// compile-time rules are passed as fields of one type, which is compiled once.
template <class B, class T>
Gap gap(const Scenery<T>& s, const Balanced& accuracy) {
    const Raster<T> r = Rasterizer<>{accuracy}.forward(B{}, s.gaussians, s.camera, s.background);
    Gaussians<double> g;
    convert_fields(g, s.gaussians, [](T x) { return static_cast<double>(x); });
    const OracleImages truth =
        oracle(g, s.camera.template cast<double>(), s.background.template cast<double>(),
               depth_order(s.gaussians, s.camera));
    const Columns<double> feature =
        r.feature.pixels.template cast<double>() - truth.feature.pixels;
    const Columns<double> alpha = r.alpha.pixels.template cast<double>() - truth.alpha.pixels;
    const Columns<double> depth = r.depth.pixels.template cast<double>() - truth.depth.pixels;
    // Depths are of the order of 3; alpha and features of 1.
    return {std::max({feature.cwiseAbs().maxCoeff(), alpha.cwiseAbs().maxCoeff(),
                      depth.cwiseAbs().maxCoeff() / 4}),
            std::sqrt(feature.cwiseAbs2().mean())};
}

template <class T>
std::vector<Scenery<T>> all_scenes() {
    std::vector<Scenery<T>> all = hard_scenes<T>(3);
    for (std::uint64_t seed = 0; seed < 3; ++seed) all.push_back(random_scene<T>(80, 3, seed));
    return all;
}

using Lanes = XsimdBackend<>;

} // namespace

TEST_CASE("oracle: Exact64 is the truth to 1e-11") {
    for (const auto& s : all_scenes<double>()) {
        CAPTURE(s.name);
        CHECK(gap<ScalarBackend<>>(s, Exact64()).largest < 1e-11);
        CHECK(gap<Lanes>(s, Exact64()).largest < 1e-11);
    }
}

TEST_CASE("oracle: the presets in float keep their promises") {
    for (const auto& s : all_scenes<float>()) {
        CAPTURE(s.name);
        // Float exponents of a needle of sigma px are uncertain by u sigma / sqrt(dilation).
        const double needle = s.name == "needles of 300 px" || s.name == "huge" ? 3e-4 : 0;
        const Gap exact = gap<Lanes>(s, Exact32()), tight = gap<Lanes>(s, Tight());
        const Gap balanced = gap<Lanes>(s, Balanced()), fast = gap<Lanes>(s, Fast());
        CHECK(exact.largest < 5e-5 + needle);
        CHECK(balanced.largest < 1.0 / 255);
        CHECK(balanced.rms < 5e-4);
        CHECK(fast.largest < 12.0 / 255);
        CHECK(fast.rms < 3e-3);
        CHECK(gap<ScalarBackend<>>(s, Exact32()).largest < 5e-5 + needle);
        CHECK(gap<ScalarBackend<>>(s, Balanced()).largest < 1.0 / 255);
        if (s.name != "opaque wall") CHECK(tight.largest < 1e-3);  // where alpha_max gives 0.999
    }
}
