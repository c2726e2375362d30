// SPDX-License-Identifier: Apache-2.0
// Lesson 2: rendering and its gradient. forward() renders; vjp() takes the gradient of a loss with
// respect to the image and returns that with respect to every parameter of the Gaussians.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>

#include <rye/splat/rasterizer.hpp>

using namespace rye;

int main() {
    Gaussians<double> g(1, 3);                                      // one Gaussian, three channels
    g.mean << 0.1, -0.05, 0;                                        // [world units]
    g.rotation << 0.9, 0.1, 0.3, 0.2;                               // (w, x, y, z), any length
    g.scale << 0.3, 0.1, 0.15;                                      // [world units]
    g.opacity << 0.8;
    g.feature << 1.0, 0.5, 0.1;

    const Pinhole<double> camera = look_at<double>({0, 0, 4}, {0, 0, 0}, {0, 1, 0}, 0.5, {32, 32});
    const VecX<double> black = VecX<double>::Zero(3);
    const Rasterizer<> rasterizer;
    const Raster<double> raster = rasterizer.forward(ScalarBackend<>{}, g, camera, black);

    for (int y = 0; y < 32; y += 2) {                               // the image as text
        for (int x = 0; x < 32; ++x) {
            const double alpha = raster.alpha.at(x, y)[0];
            std::putchar(" .:-=+*#%@"[std::min(9, static_cast<int>(10 * alpha))]);
        }
        std::putchar('\n');
    }

    // The loss is half the sum of squares, so its gradient with respect to the image is the image.
    const auto loss = [&](const Gaussians<double>& x) {
        return 0.5 *
               rasterizer.forward(ScalarBackend<>{}, x, camera, black).feature.pixels.squaredNorm();
    };
    const Gaussians<double> gradient =
        rasterizer.vjp(ScalarBackend<>{}, g, camera, black, raster, raster.feature.pixels);

    // Compare each of the 14 derivatives with a central difference.
    double worst = 0;
    Gaussians<double> moved = g;
    Gaussians<double>::fields(
        [&](const std::string& name, Columns<double>& a, const Columns<double>& d) {
            for (Index i = 0; i < a.size(); ++i) {
                const double step = 1e-6, value = a(i);
                a(i) = value + step;
                const double above = loss(moved);
                a(i) = value - step;
                const double below = loss(moved);
                a(i) = value;
                const double difference = (above - below) / (2 * step);
                std::printf("%-9s [%td]  vjp %12.6f  difference %12.6f\n", name.c_str(), i, d(i),
                            difference);
                worst = std::max(worst, std::abs(d(i) - difference) / (1 + std::abs(d(i))));
            }
        },
        moved, gradient);
    std::printf("largest relative difference %.1e\n", worst);
    return worst < 1e-4 ? 0 : 1;
}
