// SPDX-License-Identifier: Apache-2.0
// Lesson 7: forward mode. jvp() renders an image and its derivative in one direction of the inputs,
// here a sideways motion of the camera, at the cost of about two renders. Lanes work for float and
// double; splat/jvp.hpp has the kernels for lanes.
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
        look_at<double>({0, 0, 4}, {0, 0, 0}, {0, 1, 0}, 0.5, {size, size});
    const VecX<double> black = VecX<double>::Zero(3);
    const XsimdBackend backend;
    Exact64 accuracy;
    accuracy.stop = 0;                   // early stop and alpha threshold make the image jump,
    accuracy.alpha_min = 1e-30;          // which would disturb the central differences below
    const Rasterizer<Exact64> rasterizer{accuracy};

    Pinhole<double> sideways;            // tangent of each camera parameter
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
    std::printf("largest deviation from central differences: %.1e\n", error);
    return error < 1e-5 ? 0 : 1;
}
