// SPDX-License-Identifier: Apache-2.0
// The timed scene has the same bytes here as where the checksums were recorded.
#include <doctest/doctest.h>

#include <cmath>
#include <string>

#include <rye/splat/jvp.hpp>

#include "head_scene.hpp"

using namespace rye;
using namespace rye::bench;

TEST_CASE("scenes: the head's bytes are those of the recorded sums") {
    CHECK(checksum(head_scene(20000, 3, 8).gaussians) == 0x4d567e16cfe08301ULL);
    CHECK(checksum(head_scene(20000, 32, 8).gaussians) == 0x95a950f2202bb6d8ULL);
    CHECK(checksum(head_scene(100000, 3, 8).gaussians) == 0xa1f8bbf8ccb45769ULL);
    CHECK(checksum(head_scene(100000, 32, 8).gaussians) == 0xbb142166c27e51d9ULL);
}

TEST_CASE("scenes: a channel does not depend on how many there are") {
    const HeadScene few = head_scene(100, 3, 16), many = head_scene(100, 32, 16);
    CHECK(few.gaussians.feature == many.gaussians.feature.topRows(3));
    CHECK(few.cotangent == many.cotangent.topRows(3));
}

namespace {

/// The head in double, with a direction in its Gaussians.
struct MovingHead {
    Gaussians<double> gaussians, direction;
    Pinhole<double> camera;
    VecX<double> background;
    Columns<double> cotangent;

    explicit MovingHead(const HeadScene& s)
        : camera(s.camera.cast<double>()),
          background(s.background.cast<double>()),
          cotangent(s.cotangent.cast<double>()) {
        std::uint64_t stream = 0;
        Gaussians<double>::fields(
            [&](const std::string&, auto& to, auto& along, const auto& from) {
                to = from.template cast<double>();
                along.resize(to.rows(), to.cols());
                const Random random{7, stream++};
                for (Index i = 0; i < along.size(); ++i)
                    along(i) = random.normal(static_cast<std::uint64_t>(i));
            },
            gaussians, direction, s.gaussians);
        direction.scale = direction.scale.cwiseProduct(gaussians.scale);
        direction.mean *= 0.01;
    }
    Gaussians<double> at(double h) const {
        Gaussians<double> g = gaussians;
        Gaussians<double>::fields(
            [&](const std::string&, auto& x, const auto& v) { x += h * v; }, g, direction);
        return g;
    }
};

} // namespace

TEST_CASE("scenes: forward mode of the head is the transpose of its reverse mode, in lanes") {
    const XsimdBackend backend;
    for (const int channels : {3, 32}) {
        const MovingHead s(head_scene(20000, channels, 64));
        const Rasterizer<Balanced> rasterizer;
        const RasterTangents<double> tangents{&s.direction, nullptr};
        const auto r =
            rasterizer.jvp(backend, s.gaussians, tangents, s.camera, s.background);
        const auto raster = rasterizer.forward(backend, s.gaussians, s.camera, s.background);
        const Gaussians<double> g = rasterizer.vjp(backend, s.gaussians, s.camera, s.background,
                                                   raster, s.cotangent);
        const double forward = r.feature.cwiseProduct(s.cotangent).sum();
        double reverse = 0, size = 0;
        Gaussians<double>::fields(
            [&](const std::string&, const auto& a, const auto& v) {
                reverse += a.cwiseProduct(v).sum();
                size += a.cwiseProduct(v).cwiseAbs().sum();
            },
            g, s.direction);
        CHECK(size > 1);
        CHECK(std::abs(forward - reverse) <= 1e-12 * size);
    }
}

TEST_CASE("scenes: forward mode of the head agrees with central differences of Exact64, in lanes") {
    const XsimdBackend backend;
    const MovingHead s(head_scene(20000, 3, 64));
    const Rasterizer<Exact64> rasterizer;
    const RasterTangents<double> tangents{&s.direction, nullptr};
    const auto r = rasterizer.jvp(backend, s.gaussians, tangents, s.camera, s.background);
    const double h = 1e-6;
    const auto above = rasterizer.forward(backend, s.at(h), s.camera, s.background);
    const auto below = rasterizer.forward(backend, s.at(-h), s.camera, s.background);
    const Columns<double> slope = (above.feature.pixels - below.feature.pixels) / (2 * h);
    CHECK((slope - r.feature).norm() <= 1e-6 * slope.norm());
}
