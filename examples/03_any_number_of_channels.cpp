// SPDX-License-Identifier: Apache-2.0
// Lesson 3: features. A Gaussian has any number of channels; one pass renders all of them, opacity
// and depth. With one-hot features the image shows which Gaussian is visible where.
#include <algorithm>
#include <cstdio>

#include <rye/core/random.hpp>
#include <rye/splat/rasterizer.hpp>

using namespace rye;

int main() {
    const Index n = 8;
    const Random random{.seed = 3};
    Gaussians<float> g(n, n + 3);                                   // 8 labels, then a colour
    for (Index i = 0; i < n; ++i) {
        const auto number = [&](int k) {
            return static_cast<float>(random.uniform(static_cast<std::uint64_t>(16 * i + k)));
        };
        g.mean.col(i) << number(0) - 0.5f, number(1) - 0.5f, number(2) - 0.5f;
        g.rotation.col(i) << 1, number(3), number(4), number(5);
        g.scale.col(i).setConstant(0.1f + 0.1f * number(6));
        g.opacity(0, i) = 0.9f;
        g.feature.col(i).setZero();
        g.feature(i, i) = 1;                                        // the label of Gaussian i
        g.feature.col(i).tail(3) << number(7), number(8), number(9);
    }

    const Pinhole<float> camera = look_at<float>({0, 0, 4}, {0, 0, 0}, {0, 1, 0}, 0.4f, {48, 48});
    const VecX<float> nothing = VecX<float>::Zero(n + 3);
    const Raster<float> raster = Rasterizer<>{}.forward(ScalarBackend<>{}, g, camera, nothing);

    for (int y = 0; y < 48; y += 2) {                               // the strongest label
        for (int x = 0; x < 48; ++x) {
            Index who = 0;
            const float most = raster.feature.at(x, y).head(n).maxCoeff(&who);
            std::putchar(most > 0.1f ? static_cast<char>('0' + who) : '.');
        }
        std::putchar('\n');
    }

    // The labels are the blending weights. So they sum to the opacity, and weight the Gaussians'
    // colours to the rendered one: rendering commutes with every linear map of features.
    const Columns<float> weights = raster.feature.pixels.topRows(n);
    const float opacity_error =
        (weights.colwise().sum() - raster.alpha.pixels).cwiseAbs().maxCoeff();
    const Columns<float> mixed = g.feature.bottomRows(3) * weights;
    const float colour_error =
        (mixed - raster.feature.pixels.bottomRows(3)).cwiseAbs().maxCoeff();
    std::printf("labels sum to alpha within %.1e, and blend to the colour within %.1e\n",
                static_cast<double>(opacity_error), static_cast<double>(colour_error));

    Index solid = 0;
    raster.alpha.pixels.row(0).maxCoeff(&solid);
    const float depth = raster.depth.pixels(0, solid) / raster.alpha.pixels(0, solid);
    std::printf("the most opaque pixel is %.2f in front of the camera\n",
                static_cast<double>(depth));
    return std::max(opacity_error, colour_error) < 1e-5f && depth > 3 && depth < 5 ? 0 : 1;
}
