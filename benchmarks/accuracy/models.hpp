// SPDX-License-Identifier: Apache-2.0
/// benchmarks/accuracy/models.hpp: images by plain loops over every Gaussian at every pixel, in
/// forms that rye does not use (the conic, the naive determinant) in float; subsampled images.
#pragma once

#include <algorithm>
#include <numeric>

#include <rye/gaussian/project.hpp>
#include <rye/splat/oracle.hpp>

#include "scenes.hpp"

namespace rye::bench {

enum class Form { factor, conic };

/// Blends all Gaussians in float, without cut-offs; the conic is inverted from a c - b^2.
inline Columns<double> blend_in_float(const Scenery& s, Form form) {
    const Gaussians<float>& g = s.gaussians;
    const Projector<float> lens(s.camera, 0.3, 0.3);
    const auto order = depth_order(g, s.camera);
    struct One {
        Index i;
        ScreenGaussian<float> screen;
        Sym2<float> conic;
    };
    std::vector<One> all;
    for (const std::uint32_t i : order) {
        const Shape<float> shape{g.mean.col(i), g.rotation.col(i), g.scale.col(i)};
        const auto screen = project(shape, lens);
        const Sym2<float>& c = screen.covariance;
        const float inverse = 1 / c.determinant();
        if (screen.drawable)
            all.push_back({i, screen, {c.yy * inverse, -c.xy * inverse, c.xx * inverse}});
    }
    Columns<double> out(3, Index(s.camera.width) * s.camera.height);
    for (int y = 0; y < s.camera.height; ++y)
        for (int x = 0; x < s.camera.width; ++x) {
            float t = 1;
            Vec3<float> sum(0, 0, 0);
            const float px = static_cast<float>(x) + 0.5F - s.camera.cx;
            const float py = static_cast<float>(y) + 0.5F - s.camera.cy;
            for (const One& o : all) {
                const float dx = px - o.screen.centre[0], dy = py - o.screen.centre[1];
                const float power =
                    -0.5F * (form == Form::factor ? o.screen.precision.quadratic(dx, dy)
                                                  : o.conic.quadratic(Vec2<float>(dx, dy)));
                if (!(power <= 0) || power < -25) continue;
                const float alpha = std::min(1.0F, g.opacity(0, o.i) * std::exp(power));
                sum += t * alpha * g.feature.col(o.i);
                t *= 1 - alpha;
            }
            for (Index c = 0; c < 3; ++c)
                out(c, Index(y) * s.camera.width + x) = double(sum[c] + t * s.background[c]);
        }
    return out;
}

/// The camera of every `stride`-th pixel of every `stride`-th row.
inline Pinhole<double> every_pixel(const Pinhole<double>& camera, int stride) {
    Pinhole<double> c = camera;
    c.fx /= stride, c.fy /= stride;
    c.cx = (camera.cx - 0.5) / stride + 0.5, c.cy = (camera.cy - 0.5) / stride + 0.5;
    c.width = (camera.width + stride - 1) / stride;
    c.height = (camera.height + stride - 1) / stride;
    return c;
}

/// The same pixels of an image.
inline Columns<double> strided(const Columns<double>& a, int width, int stride) {
    const int height = static_cast<int>(a.cols()) / width;
    const int w = (width + stride - 1) / stride, h = (height + stride - 1) / stride;
    Columns<double> out(a.rows(), Index(w) * h);
    for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; ++x)
            out.col(Index(y) * w + x) = a.col(Index(y * stride) * width + x * stride);
    return out;
}

} // namespace rye::bench
