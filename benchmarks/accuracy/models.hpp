// SPDX-License-Identifier: Apache-2.0
/// benchmarks/accuracy/models.hpp: images by plain loops over every Gaussian at every pixel: forms
/// that rye does not use (the conic, the naive determinant) in float, and the physical model: the
/// peak of each Gaussian along the ray, in its own order at every pixel.
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
    const Lens<float> lens(s.camera, 0.3, 0.3);
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

enum class Order { by_depth, by_peak };

/// Every `stride`-th pixel of the physical image: alpha = o exp(-d^2 / 2), d the least whitened
/// distance of the ray to the mean, in front of the camera.
inline Columns<double> ray_image(const Scenery& s, Order rule, int stride) {
    const Gaussians<float>& g = s.gaussians;
    const Pinhole<double> camera = s.camera.cast<double>();
    struct One {
        Index i;
        Mat3<double> whiten;
        Vec3<double> mean;
        double z;
    };
    std::vector<One> all;
    for (Index i = 0; i < g.count(); ++i) {
        const Vec3<double> mean = camera.camera_from_world.apply(g.mean.col(i).cast<double>());
        if (!(mean[2] > camera.near_depth)) continue;
        const Mat3<double> r =
            camera.camera_from_world.rotation *
            quat_matrix(quat_normalized(Quat<double>(g.rotation.col(i).cast<double>())));
        const Vec3<double> scale = g.scale.col(i).cast<double>().cwiseMax(1e-9);
        all.push_back({i, scale.cwiseInverse().asDiagonal() * r.transpose(), mean, mean[2]});
    }
    const int w = (camera.width + stride - 1) / stride, h = (camera.height + stride - 1) / stride;
    Columns<double> out(3, Index(w) * h);
    struct Hit {
        double t, alpha;
        Index i;
    };
    std::vector<Hit> hits;
    for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; ++x) {
            const Vec3<double> d((x * stride + 0.5 - camera.cx) / camera.fx,
                                 (y * stride + 0.5 - camera.cy) / camera.fy, 1);
            hits.clear();
            for (const One& o : all) {
                const Vec3<double> dd = o.whiten * d, m = o.whiten * o.mean;
                const double t = dot(m, dd) / dot(dd, dd); // depth of the peak, as z of d is 1
                if (!(t > 0)) continue;
                const Vec3<double> miss = cross(m, dd);
                const double d2 = dot(miss, miss) / dot(dd, dd);
                if (d2 < 80)
                    hits.push_back({rule == Order::by_depth ? o.z : t,
                                    double(g.opacity(0, o.i)) * std::exp(-0.5 * d2), o.i});
            }
            std::stable_sort(hits.begin(), hits.end(),
                             [](const Hit& a, const Hit& b) { return a.t < b.t; });
            double t = 1;
            Vec3<double> sum(0, 0, 0);
            for (const Hit& k : hits) {
                sum += t * k.alpha * g.feature.col(k.i).cast<double>();
                t *= 1 - k.alpha;
            }
            out.col(Index(y) * w + x) = sum + t * s.background.cast<double>();
        }
    return out;
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
