// SPDX-License-Identifier: Apache-2.0
/// rye/gaussian/activate.hpp: clouds of stored numbers to those that are drawn (attributes.hpp),
/// with colour from spherical harmonics; and back.
#pragma once

#include <algorithm>
#include <limits>

#include <rye/gaussian/attributes.hpp>
#include <rye/gaussian/sh_color.hpp>

namespace rye {

/// A cloud as seen from `eye`, with three channels of colour, of its harmonics' bands up to `most`.
template <int most = 4, class T>
Gaussians<T> activate(const GaussianCloud<T>& cloud, const Vec3<T>& eye) {
    Gaussians<T> g;
    g.mean = cloud.mean;
    g.rotation = cloud.rotation;
    g.scale = cloud.log_scale.unaryExpr([](const T& x) { return drawn_scale(x); });
    g.opacity = cloud.logit_opacity.unaryExpr([](const T& x) { return drawn_opacity(x); });
    g.feature = sh_colors<most>(cloud, eye);
    return g;
}

/// Gradient of the cloud for that of activate's result `drawn`.
template <int most = 4, class T>
GaussianCloud<T> activate_vjp(const GaussianCloud<T>& cloud, const Vec3<T>& eye,
                              const Gaussians<T>& drawn, const Gaussians<T>& g) {
    GaussianCloud<T> r(cloud.count(), cloud.degree());
    r.mean = g.mean;
    r.rotation = g.rotation;
    r.log_scale = g.scale.cwiseProduct(drawn.scale);
    for (Index i = 0; i < cloud.count(); ++i) {
        const T& o = drawn.opacity(0, i);
        r.logit_opacity(0, i) =
            drawn_opacity_vjp(o, sigmoid(T(-cloud.logit_opacity(0, i))), g.opacity(0, i));
    }
    sh_colors_vjp<most>(cloud, eye, g.feature, r);
    return r;
}

/// The cloud of degree 0 that draws as `g` does, from its first three channels. Opacities and
/// scales are held within what their logarithms can store.
template <Real T>
GaussianCloud<T> deactivate(const Gaussians<T>& g) {
    require(g.channels() >= 3, "deactivate",
            "got " + std::to_string(g.channels()) + " channels, expected 3 of colour or more");
    GaussianCloud<T> r(g.count(), 0);
    r.mean = g.mean;
    r.rotation = g.rotation;
    r.log_scale = g.scale.unaryExpr(
        [](const T& s) { return std::log(std::max(s, std::numeric_limits<T>::min())); });
    r.logit_opacity = g.opacity.unaryExpr([](const T& o) {
        constexpr T u = std::numeric_limits<T>::epsilon() / 2;
        return logit(std::clamp(o, u, T(1) - u));
    });
    r.sh_constant = (g.feature.topRows(3).array() - T(0.5)) / static_cast<T>(sh_factor(0));
    return r;
}

} // namespace rye
