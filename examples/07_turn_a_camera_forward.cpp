// SPDX-License-Identifier: Apache-2.0
// Lesson 7: forward mode. jvp() draws a picture and, at the price of about two pictures, how it
// changes in one direction of its inputs: here, as the camera moves sideways. Lanes are for float
// and double alike; splat/jvp.hpp brings what lanes need.
#include <cmath>
#include <cstdio>

#include <rye/core/random.hpp>
#include <rye/splat/jvp.hpp>

using namespace rye;

int main() {
    constexpr int count = 200, size = 64;
    const Random random{1, 0};
    Gaussians<double> g(count, 3);
    std::uint64_t k = 0;
    for (Index i = 0; i < count; ++i) {
        for (Index j = 0; j < 3; ++j) g.mean(j, i) = 0.5 * random.normal(k++);
        g.rotation.col(i) << 1, 0, 0, 0;
        g.scale.col(i).setConstant(0.12);
        g.opacity(0, i) = 0.2 + 0.6 * random.uniform(k++);
        for (Index c = 0; c < 3; ++c) g.feature(c, i) = random.uniform(k++);
    }
    const Pinhole<double> camera =
        look_at<double>({0, 0, 4}, {0, 0, 0}, {0, 1, 0}, 0.5, size, size);
    const VecX<double> black = VecX<double>::Zero(3);
    const XsimdBackend backend;
    Exact64 accuracy;
    accuracy.stop = 0;                   // a stop, and an alpha too small to draw, are steps of the
    accuracy.alpha_min = 1e-30;          // picture, of which differences are taken below
    const Rasterizer<Exact64> rasterizer{accuracy};

    Pinhole<double> sideways;            // the derivative of each of the camera's numbers
    sideways.fx = sideways.fy = 0;
    sideways.camera_from_world.rotation.setZero();
    sideways.camera_from_world.translation << 1, 0, 0;  // per world unit
    const RasterTangents<double> direction{.gaussians = nullptr, .camera = &sideways};
    const auto moving = rasterizer.jvp(backend, g, direction, camera, black);

    const auto shifted = [&](double step) {
        Pinhole<double> c = camera;
        c.camera_from_world.translation[0] += step;
        return rasterizer.forward(backend, g, c, black).feature.pixels;
    };
    const double h = 1e-5;
    const Columns<double> difference = (shifted(h) - shifted(-h)) / (2 * h);
    const double error = (moving.feature - difference).cwiseAbs().maxCoeff();
    std::printf("largest change of a channel per world unit: %.2f\n",
                moving.feature.cwiseAbs().maxCoeff());
    std::printf("furthest from central differences: %.1e\n", error);
    return error < 1e-5 ? 0 : 1;
}
