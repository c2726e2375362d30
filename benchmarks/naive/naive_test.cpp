// SPDX-License-Identifier: Apache-2.0
// Correctness of the yardstick: the naive rasterizer's image is the oracle's up to skipped
// contributions, and its gradients are those of rye's reference in double.
#include <doctest/doctest.h>

#include <rye/splat/oracle.hpp>
#include <rye/splat/rasterizer.hpp>

#include "../scenes/head_scene.hpp"
#include "adapter.hpp"

using namespace rye;
using namespace rye::bench;

namespace {

Gaussians<double> in_double(const Gaussians<float>& g) {
    Gaussians<double> d;
    convert_fields(d, g, [](float x) { return double(x); });
    return d;
}

double relative(const std::vector<float>& a, const Columns<double>& b) {
    const Columns<double> x =
        Eigen::Map<const Columns<float>>(a.data(), b.rows(), b.cols()).cast<double>();
    return (x - b).norm() / b.norm();
}

} // namespace

TEST_CASE("naive: image and gradients are the reference's") {
    for (const int channels : {3, 32}) {
        const HeadScene s = head_scene(2000, channels, 128);
        const naive::Cloud cloud = naive_cloud(s.gaussians);
        const naive::Camera camera = naive_camera(s.camera);
        naive::Rasterizer rasterizer;
        std::vector<float> image;
        rasterizer.forward(cloud, camera, channels, image);
        naive::Cloud g;
        rasterizer.backward(cloud, camera, channels,
                            {s.cotangent.data(), s.cotangent.data() + s.cotangent.size()}, g);

        const Gaussians<double> exact = in_double(s.gaussians);
        const Pinhole<double> lens = s.camera.cast<double>();
        const VecX<double> black = VecX<double>::Zero(channels);
        const OracleImages truth =
            oracle(exact, lens, black, depth_order(s.gaussians, s.camera));
        const Columns<float> drawn =
            Eigen::Map<const Columns<float>>(image.data(), channels, s.cotangent.cols());
        CHECK((drawn.cast<double>() - truth.feature.pixels).cwiseAbs().maxCoeff() < 0.02);

        const Rasterizer<HeadRules> reference;
        const auto raster = reference.forward(ScalarBackend<>{}, exact, lens, black);
        const Gaussians<double> d = reference.vjp(ScalarBackend<>{}, exact, lens, black, raster,
                                                  Columns<double>(s.cotangent.cast<double>()));
        CHECK(relative(image, raster.feature.pixels) < 1e-5);
        CHECK(relative(g.mean, d.mean) < 1e-3);
        CHECK(relative(g.scale, d.scale) < 1e-3);
        CHECK(relative(g.rotation, d.rotation) < 1e-3);
        CHECK(relative(g.opacity, d.opacity) < 1e-3);
        CHECK(relative(g.colour, d.feature) < 1e-3);
    }
}
