// SPDX-License-Identifier: Apache-2.0
// Lesson 6: fifty Gaussians fit an image. The trained parameters (logarithms of scales, logits of
// opacities) use the type of the Gaussians, so fields() and Adam apply unchanged. A picture on disk
// is to_float(PngFiles{}.read(path, 3)), of rye/io/png.hpp.
#include <cmath>
#include <cstdio>

#include <rye/core/random.hpp>
#include <rye/nn/adam.hpp>
#include <rye/splat/rasterizer.hpp>

using namespace rye;

namespace {

Gaussians<float> activated(const Gaussians<float>& raw) {
    Gaussians<float> g = raw;
    g.scale = raw.scale.array().exp().matrix();
    g.opacity = raw.opacity.unaryExpr([](float x) { return sigmoid(x); });
    return g;
}

} // namespace

int main() {
    using B = ScalarBackend<>;
    const int edge = 48;
    Image<float> picture(edge, edge, 3);                            // the target: an iris
    for (int y = 0; y < edge; ++y)
        for (int x = 0; x < edge; ++x) {
            const float r = std::hypot(float(x) + 0.5f - 24.0f, float(y) + 0.5f - 24.0f);
            if (r > 20) picture.at(x, y) << 0.9f, 0.9f, 0.88f;
            else if (r > 8) picture.at(x, y) << 0.3f, 0.45f, 0.6f;
            else picture.at(x, y) << 0.02f, 0.02f, 0.02f;
        }

    const Index n = 50;
    const Random random{.seed = 5};
    Gaussians<float> raw(n, 3);
    for (Index i = 0; i < n; ++i) {
        const auto k = static_cast<std::uint64_t>(2 * i);
        raw.mean.col(i) << static_cast<float>(2 * random.uniform(k) - 1),
            static_cast<float>(2 * random.uniform(k + 1) - 1), 0.01f * static_cast<float>(i);
        raw.rotation.col(i) << 1, 0, 0, 0;
    }
    raw.scale.setConstant(std::log(0.15f));
    raw.opacity.setConstant(0.0f);                                  // the logit of 1/2
    raw.feature.setConstant(0.5f);

    const auto camera = look_at<float>({0, 0, 4}, {0, 0, 0}, {0, 1, 0}, 0.5f, {edge, edge});
    const VecX<float> grey = VecX<float>::Constant(3, 0.5f);
    const Rasterizer<> rasterizer;
    Adam<Gaussians<float>> adam(raw);
    double psnr = 0;
    for (int step = 0; step <= 300; ++step) {
        const Gaussians<float> g = activated(raw);
        const Raster<float> raster = rasterizer.forward(B{}, g, camera, grey);
        const Columns<float> error = raster.feature.pixels - picture.pixels;
        psnr = -10 * std::log10(static_cast<double>(error.squaredNorm()) / double(error.size()));
        if (step % 100 == 0) std::printf("step %3d: %.2f dB\n", step, psnr);

        Gaussians<float> gradient = rasterizer.vjp(B{}, g, camera, grey, raster, error);
        gradient.mean.row(2).setZero();                             // no two exchange their depths
        gradient.scale.array() *= g.scale.array();                  // d exp(x) = exp(x) dx
        gradient.opacity.array() *= g.opacity.array() * (1 - g.opacity.array());
        adam_step(B{}, raw, gradient, adam, [](const std::string&) { return 0.02; });
    }
    return psnr > 22 ? 0 : 1;
}
