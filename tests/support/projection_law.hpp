// SPDX-License-Identifier: Apache-2.0
/// tests/support/projection_law.hpp: the dot-product test of a projection, for pinholes and lenses
/// with distortion.
#pragma once

#include <rye/autodiff/dual.hpp>
#include <rye/core/random.hpp>
#include <rye/gaussian/project.hpp>

namespace rye::test {

struct Draws {
    Random random;
    std::uint64_t k = 0;
    double normal() { return random.normal(k++); }
    double uniform() { return random.uniform(k++); }
};

/// Means lie `spread` about the origin.
inline Shape<double> random_shape(Draws& d, double spread = 1) {
    Shape<double> s;
    for (int i = 0; i < 3; ++i) s.mean[i] = spread * d.normal();
    for (int i = 0; i < 4; ++i) s.rotation[i] = d.normal() * 3;
    for (int i = 0; i < 3; ++i) s.scale[i] = std::exp(d.normal() - 2);
    return s;
}

/// Relative gap of the dot-product test, with a cotangent without symmetry; 0 if the Gaussian is
/// not drawable.
template <Antialias how = Antialias::dilate, Distortion Bent>
double gap(const Shape<double>& s, const Pinhole<double, Bent>& camera, double margin, Draws& d) {
    using D = Dual<double, 1>;
    const Projector lens(camera, margin, 0.3);
    Shape<D> moved;
    Shape<double> v = random_shape(d);
    const auto lift = [](auto& to, const auto& x, const auto& t) {
        for (int i = 0; i < x.size(); ++i) {
            to[i] = D(x[i]);
            to[i].d[0] = t[i];
        }
    };
    v.scale = v.scale.cwiseProduct(s.scale).eval();
    lift(moved.mean, s.mean, v.mean);
    lift(moved.rotation, s.rotation, v.rotation);
    lift(moved.scale, s.scale, v.scale);
    const auto p = project<how>(s, lens);
    if (!p.drawable) return 0;
    const auto q = project<how>(moved, Projector(camera.template cast<D>(), margin, 0.3));

    // A few pixels around the Gaussian give the moments that a render would.
    ScreenCotangent<double> c{Vec2<double>(d.normal(), d.normal()), {0, 0, 0}, d.normal()};
    double forward = c.centre[0] * q.centre[0].d[0] + c.centre[1] * q.centre[1].d[0] +
                     c.depth * q.depth.d[0];
    for (int k = 0; k < 5; ++k) {
        // w = (a, b) in the whitened frame; the pixel at p.centre + L^-1 w is fixed.
        const double a = d.normal(), b = d.normal(), g = d.normal();
        const double dx = a / p.precision.k1;
        const double dy = b / p.precision.k2 + p.precision.m * dx;
        c.moment.xx += g * a * a;
        c.moment.xy += g * a * b;
        c.moment.yy += g * b * b;
        forward += g * -0.5 * q.precision.quadratic(D(dx), D(dy)).d[0];
    }
    double alpha = 0;
    if constexpr (how == Antialias::mip) {
        alpha = d.normal();
        forward += alpha * q.share.d[0] / q.share.value;
    }
    const Shape<double> r = project_vjp<how>(s, lens, c, alpha);
    double reverse = 0, scale = 0;
    const auto pair = [&](const auto& x, const auto& y) {
        for (int i = 0; i < x.size(); ++i) {
            reverse += x[i] * y[i];
            scale += std::abs(x[i] * y[i]);
        }
    };
    pair(r.mean, v.mean);
    pair(r.rotation, v.rotation);
    pair(r.scale, v.scale);
    return std::abs(forward - reverse) / scale;
}

} // namespace rye::test
