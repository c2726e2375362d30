// SPDX-License-Identifier: Apache-2.0
// Forward mode of the rasterizer: lanes against duals, against the reverse mode by <J v, w> =
// <v, J^T w>, and against central differences, for directions in the Gaussians and the camera.
#include <rye/splat/jvp.hpp>

#include <doctest/doctest.h>

#include "../support/directions.hpp"

using namespace rye;
using namespace rye::test;

namespace {

template <class T>
double difference(const Columns<T>& a, const Columns<T>& b) {
    if (a.size() == 0) return 0;
    return double((a - b).cwiseAbs().maxCoeff()) / (1e-3 + double(b.cwiseAbs().maxCoeff()));
}

/// The largest relative difference of lanes' images and tangents from those of duals.
template <class A, class T>
double lanes_gap(const Scenery<T>& s, const A& accuracy, std::uint64_t seed) {
    const Gaussians<T> v = direction(s, seed);
    const Pinhole<T> camera = camera_direction<T>(seed);
    const RasterTangents<T> along{&v, &camera};
    const Rasterizer<A> rasterizer{accuracy};
    const auto plain =
        rasterizer.jvp(ScalarBackend{}, s.gaussians, along, s.camera, s.background);
    const auto lanes = rasterizer.jvp(XsimdBackend{}, s.gaussians, along, s.camera, s.background);
    double worst = 0;
    const auto compare = [&](const Columns<T>& a, const Columns<T>& b) {
        REQUIRE(a.rows() == b.rows());
        REQUIRE(a.cols() == b.cols());
        worst = std::max(worst, difference(a, b));
    };
    compare(lanes.value.feature.pixels, plain.value.feature.pixels);
    compare(lanes.value.alpha.pixels, plain.value.alpha.pixels);
    compare(lanes.feature, plain.feature);
    compare(lanes.alpha, plain.alpha);
    if constexpr (A::outputs.depth) {
        compare(lanes.value.depth.pixels, plain.value.depth.pixels);
        compare(lanes.depth, plain.depth);
    }
    return worst;
}

} // namespace

TEST_CASE("jvp: lanes equal duals for any number of channels, rules and outputs") {
    for (const Index channels : {1, 2, 3, 4, 5, 8, 17}) {
        CAPTURE(channels);
        const auto s = random_scene<double>(80, channels, std::uint64_t(channels));
        CHECK(lanes_gap(s, Exact64(), 1) < 1e-10);
        CHECK(lanes_gap(s, Balanced(), 2) < 1e-10);
        CHECK(lanes_gap(s, Compatible3dgs(), 3) < 1e-10);
        CHECK(lanes_gap(s, Compatible3dgsFloor(), 4) < 1e-10);
        CHECK(lanes_gap(s, FeaturesOnly<Balanced>(), 5) < 1e-10);
        CHECK(lanes_gap(random_scene<float>(80, channels, 9), Exact32(), 6) < 2e-3);
    }
}

TEST_CASE("jvp: the value is that of forward, and what is null does not move") {
    const auto s = random_scene<float>(200, 3, 4);
    const Rasterizer rasterizer;
    const XsimdBackend backend;
    const auto r = rasterizer.jvp(backend, s.gaussians, RasterTangents<float>{}, s.camera,
                                  s.background);
    const auto whole = rasterizer.forward(backend, s.gaussians, s.camera, s.background);
    CHECK(r.value.feature.pixels == whole.feature.pixels);
    CHECK(r.value.alpha.pixels == whole.alpha.pixels);
    CHECK(r.value.depth.pixels == whole.depth.pixels);
    CHECK(r.feature.isZero(0));
    CHECK(r.alpha.isZero(0));
    CHECK(r.depth.isZero(0));
}

TEST_CASE("jvp: <J v, w> = <v, J^T w> in double") {
    for (std::uint64_t seed = 0; seed < 4; ++seed) {
        const auto s = random_scene<double>(300, 3, seed);
        const XsimdBackend backend;
        const Rasterizer<Balanced> rasterizer{Balanced(Exact64())};
        const Gaussians<double> v = direction(s, seed + 10);
        const Index pixels = Index(s.camera.width) * s.camera.height;
        const Columns<double> wf = noise<double>(3, pixels, seed + 1),
                              wa = noise<double>(1, pixels, seed + 2),
                              wd = noise<double>(1, pixels, seed + 3);
        const auto r = rasterizer.jvp(backend, s.gaussians, RasterTangents<double>{&v, nullptr},
                                      s.camera, s.background);
        const auto raster = rasterizer.forward(backend, s.gaussians, s.camera, s.background);
        const auto g =
            rasterizer.vjp(backend, s.gaussians, s.camera, s.background, raster, wf, &wa, &wd);
        const double forward = r.feature.cwiseProduct(wf).sum() + r.alpha.cwiseProduct(wa).sum() +
                               r.depth.cwiseProduct(wd).sum();
        double reverse = 0, scale = 0;
        Gaussians<double>::fields([&](const std::string&, const auto& a, const auto& d) {
            reverse += a.cwiseProduct(d).sum();
            scale += a.cwiseProduct(d).cwiseAbs().sum();
        }, g, v);
        CHECK(std::abs(forward - reverse) <= 1e-12 * scale);
    }
}

TEST_CASE_TEMPLATE("jvp: <J v, 1> = <v, J^T 1> of a needle of (1e6, 1e-6, 1e-6) in double (A19)", B,
                   ScalarBackend<Serial>, XsimdBackend<>) {
    auto s = random_scene<double>(1, 3, 3);
    s.gaussians.opacity.setConstant(0.7);
    const Rasterizer<Exact64> rasterizer;
    double worst = 0;
    int drawn = 0;
    for (std::uint64_t turn = 0; turn < 20; ++turn) {
        for (Index k = 0; k < 4; ++k)
            s.gaussians.rotation(k, 0) = Random{turn, 8}.normal(static_cast<std::uint64_t>(k));
        s.gaussians.scale.col(0) = Vec3<double>(1e6, 1e-6, 1e-6);
        const Gaussians<double> v = direction(s, turn);
        const RasterTangents<double> along{&v, nullptr};
        const auto r = rasterizer.forward(B{}, s.gaussians, s.camera, s.background);
        const auto j = rasterizer.jvp(B{}, s.gaussians, along, s.camera, s.background);
        const Columns<double> one = Columns<double>::Ones(3, j.feature.cols());
        const Gaussians<double> g =
            rasterizer.vjp(B{}, s.gaussians, s.camera, s.background, r, one);
        double reverse = 0, scale = 0;
        Gaussians<double>::fields(
            [&](const std::string&, const Columns<double>& a, const Columns<double>& b) {
                reverse += a.cwiseProduct(b).sum();
                scale += a.cwiseProduct(b).cwiseAbs().sum();
            },
            g, v);
        if (scale > 0) ++drawn;
        worst = std::max(worst, std::abs(j.feature.sum() - reverse) / (scale + 1e-300));
    }
    CHECK(drawn >= 10);
    CHECK(worst < 1e-12);
}

TEST_CASE("jvp: equals central differences, along the Gaussians and along the camera") {
    // A pixel's set of Gaussians must not change between the two sides: no cut, no stop.
    auto s = random_scene<double>(40, 3, 3, 0.3);
    Exact64 accuracy;
    accuracy.alpha_min = 1e-300;
    accuracy.stop = 0;
    const Rasterizer<Exact64> rasterizer{accuracy};
    const XsimdBackend backend;
    const double h = 1e-6;
    const auto moved = [&](double step, const Gaussians<double>* v, const Pinhole<double>* dc) {
        Gaussians<double> g = s.gaussians;
        Pinhole<double> c = s.camera;
        if (v != nullptr)
            Gaussians<double>::fields(
                [&](const std::string&, auto& a, const auto& d) { a += step * d; }, g, *v);
        if (dc != nullptr) {
            c.fx += step * dc->fx, c.fy += step * dc->fy;
            c.cx += step * dc->cx, c.cy += step * dc->cy;
            c.camera_from_world.rotation += step * dc->camera_from_world.rotation;
            c.camera_from_world.translation += step * dc->camera_from_world.translation;
        }
        return rasterizer.forward(backend, g, c, s.background);
    };
    const Gaussians<double> v = direction(s, 7);
    const Pinhole<double> dc = camera_direction<double>(8);
    for (const auto& [g, c] :
         {std::pair<const Gaussians<double>*, const Pinhole<double>*>(&v, nullptr),
          {nullptr, &dc},
          {&v, &dc}}) {
        const auto r = rasterizer.jvp(backend, s.gaussians, RasterTangents<double>{g, c}, s.camera,
                                      s.background);
        const auto above = moved(h, g, c), below = moved(-h, g, c);
        const auto check = [&](const Columns<double>& a, const Columns<double>& up,
                               const Columns<double>& down) {
            const Columns<double> slope = (up - down) / (2 * h);
            CHECK((a - slope).cwiseAbs().maxCoeff() <= 1e-6 * (1 + slope.cwiseAbs().maxCoeff()));
        };
        check(r.feature, above.feature.pixels, below.feature.pixels);
        check(r.alpha, above.alpha.pixels, below.alpha.pixels);
        check(r.depth, above.depth.pixels, below.depth.pixels);
    }
}

TEST_CASE("jvp: bits do not depend on threads; a tangent of another shape is an error") {
    const auto s = random_scene<float>(500, 3, 6);
    const Gaussians<float> v = direction(s, 7);
    const RasterTangents<float> along{&v, nullptr};
    const Rasterizer rasterizer;
    const auto one =
        rasterizer.jvp(XsimdBackend{Serial{}}, s.gaussians, along, s.camera, s.background);
    const auto two = rasterizer.jvp(XsimdBackend{}, s.gaussians, along, s.camera, s.background);
    CHECK(one.feature == two.feature);
    const Gaussians<float> fewer(3, 3);
    CHECK_THROWS_WITH_AS(rasterizer.jvp(XsimdBackend{}, s.gaussians,
                                        RasterTangents<float>{&fewer, nullptr}, s.camera,
                                        s.background),
                         "rasterizer: tangent of mean is 3 x 3, mean is 3 x 500", Error);
}
