// SPDX-License-Identifier: Apache-2.0
// The peak of a Gaussian along a ray, and blending in the order of these peaks.
#include <rye/splat/ray_peak.hpp>

#include <rye/splat/oracle_vjp.hpp>
#include <rye/splat/lanes.hpp>

#include <doctest/doctest.h>

#include "../support/scenes.hpp"

using namespace rye;
using namespace rye::test;

namespace {

struct ByPeak : Exact64 {
    static constexpr BlendOrder order = BlendOrder::by_peak;
};
struct ByPeakInFloat : Exact32 {
    static constexpr BlendOrder order = BlendOrder::by_peak;
};

/// Two upright sheets that cross in the middle of the image, red and blue.
template <class T>
Scenery<T> crossing_sheets() {
    Scenery<T> s{"crossing", Gaussians<T>(2, 3), Pinhole<T>(), VecX<T>::Zero(3)};
    for (Index i = 0; i < 2; ++i) {
        const double half = (i == 0 ? 0.5 : -0.5) * 0.9; // radians about y
        s.gaussians.mean.col(i).setZero();
        s.gaussians.rotation.col(i) << T(std::cos(half)), T(0), T(std::sin(half)), T(0);
        s.gaussians.scale.col(i) << T(0.5), T(0.5), T(1e-3);
        s.gaussians.opacity(0, i) = T(0.9);
        s.gaussians.feature.col(i) << T(i == 0 ? 1 : 0), T(0), T(i == 0 ? 0 : 1);
    }
    s.camera.fx = s.camera.fy = T(40);
    s.camera.cx = s.camera.cy = T(16);
    s.camera.width = s.camera.height = 32;
    s.camera.camera_from_world.translation = Vec3<T>(T(0), T(0), T(3));
    return s;
}

template <class T>
Gaussians<double> in_double(const Gaussians<T>& g) {
    Gaussians<double> d;
    convert_fields(d, g, [](T x) { return static_cast<double>(x); });
    return d;
}

template <class T>
double gap(const Raster<T>& r, const OracleImages& truth) {
    return (r.feature.pixels.template cast<double>() - truth.feature.pixels)
        .cwiseAbs()
        .maxCoeff();
}

} // namespace

TEST_CASE("ray_peak: the density is greatest there") {
    const auto s = random_scene<double>(40, 1, 71, 0.3);
    for (Index i = 0; i < 40; ++i) {
        const detail::RayPeak<double> p = detail::ray_peak(s.gaussians, s.camera, i);
        const detail::OracleSolid solid = detail::oracle_solid(s.gaussians, s.camera, i);
        for (const double px : {-20.0, 0.0, 13.5}) {
            const Vec3<double> d(px / s.camera.fx, 4 / s.camera.fy, 1);
            const double t = p.at(px, 4);
            const auto density = [&](double at) {
                return -Vec3<double>(solid.whiten * d * at - solid.mean).squaredNorm();
            };
            CHECK(density(t) > density(t * (1 + 1e-5)));
            CHECK(density(t) > density(t * (1 - 1e-5)));
            CHECK(std::abs(t - solid.meet(d).depth) < 1e-11 * std::abs(t));
        }
    }
}

TEST_CASE_TEMPLATE("ray_peak: flat, long and pointlike Gaussians", T, float, double) {
    const T tolerance = std::is_same_v<T, float> ? T(2e-6) : T(1e-14);
    Gaussians<T> g(1, 1);
    Pinhole<T> camera;
    camera.fx = camera.fy = T(50);
    g.mean.col(0) << T(0), T(0), T(4);
    const T c = std::cos(T(0.3)), s = std::sin(T(0.3)); // half of the angle about x
    g.rotation.col(0) << c, s, T(0), T(0);
    g.opacity(0, 0) = T(1);
    // A plane through the mean with normal (0, -sin .6, cos .6).
    g.scale.col(0) << T(1), T(2), T(0);
    const T y = T(10), n_y = -std::sin(T(0.6)), n_z = std::cos(T(0.6));
    const T plane = T(4) * n_z / (n_y * y / T(50) + n_z);
    CHECK(std::abs(detail::ray_peak(g, camera, 0).at(T(7), y) - plane) <= plane * 4 * tolerance);
    // No axis counts more than another: closest to the mean itself.
    g.scale.col(0).setZero();
    const T d2 = T(49) / T(2500) + T(100) / T(2500) + T(1);
    CHECK(std::abs(detail::ray_peak(g, camera, 0).at(T(7), y) - T(4) / d2) <= 16 * tolerance);
    // A ray within the plane of a flat Gaussian has no peak; the centre's depth is used.
    g.rotation.col(0) << T(1), T(0), T(0), T(0);
    g.mean.col(0) << T(0), T(0), T(4);
    g.scale.col(0) << T(0), T(1), T(1);
    CHECK(detail::ray_peak(g, camera, 0).at(T(0), y) == T(4));
}

TEST_CASE_TEMPLATE("order by peak: crossing sheets change places within the image", B,
                   ScalarBackend<>, XsimdBackend<>) {
    const auto s = crossing_sheets<double>();
    const auto order = depth_order(s.gaussians, s.camera);
    const auto truth = oracle(s.gaussians, s.camera, s.background, order,
                              {.order = BlendOrder::by_peak});
    const auto r = Rasterizer<ByPeak>{}.forward(B{}, s.gaussians, s.camera, s.background);
    CHECK(gap(r, truth) < 1e-11);
    const auto red_over_blue = [&](int x) {
        return r.feature.at(x, 16)[0] / r.feature.at(x, 16)[2];
    };
    CHECK(red_over_blue(21) > 1.5);
    CHECK(red_over_blue(10) < 1 / 1.5);
    const auto one = Rasterizer<Exact64>{}.forward(B{}, s.gaussians, s.camera, s.background);
    CHECK(gap(one, truth) > 0.3);                          // one order for all pixels is wrong
    CHECK(one.trace.peaks.empty());
}

TEST_CASE_TEMPLATE("order by peak: values and gradients are the oracle's", B, ScalarBackend<>,
                   XsimdBackend<>) {
    for (auto s : hard_scenes<double>(3)) {
        CAPTURE(s.name);
        const Rasterizer<ByPeak> rasterizer;
        const OracleModel model{.order = BlendOrder::by_peak};
        const auto order = depth_order(s.gaussians, s.camera);
        const auto r = rasterizer.forward(B{}, s.gaussians, s.camera, s.background);
        CHECK(gap(r, oracle(s.gaussians, s.camera, s.background, order, model)) < 1e-10);
        if (s.gaussians.count() == 0 || s.name == "opaque wall") continue; // 0 / 0 behind alpha 1
        const Columns<double> w = noise<double>(3, r.feature.pixels.cols(), 5);
        const auto g = rasterizer.vjp(B{}, s.gaussians, s.camera, s.background, r, w);
        const auto t = oracle_vjp({s.gaussians, s.camera, order, model}, s.background, {w});
        Gaussians<double>::fields(
            [](const std::string& name, const Columns<double>& a, const Columns<double>& b) {
                CAPTURE(name);
                CHECK((a - b).norm() <= 1e-8 * b.norm() + 1e-12);
            },
            g, t);
    }
}

TEST_CASE_TEMPLATE("order by peak: float keeps Exact32's promise", B, ScalarBackend<>,
                   XsimdBackend<>) {
    for (const std::uint64_t seed : {1U, 2U, 3U}) {
        const auto s = random_scene<float>(80, 3, seed);
        const auto g = in_double(s.gaussians);
        const auto truth = oracle(g, s.camera.cast<double>(), s.background.cast<double>(),
                                  depth_order(s.gaussians, s.camera),
                                  {.order = BlendOrder::by_peak});
        const auto r =
            Rasterizer<ByPeakInFloat>{}.forward(B{}, s.gaussians, s.camera, s.background);
        CHECK(gap(r, truth) < 5e-5);
    }
}
