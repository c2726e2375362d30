// SPDX-License-Identifier: Apache-2.0
/// rye/gaussian/activate.hpp: activation of a stored cloud to Gaussians that can be rendered
/// (attributes.hpp), with colour from spherical harmonics; its vjp and its inverse.
#pragma once

#include <algorithm>
#include <limits>

#include <rye/gaussian/attributes.hpp>
#include <rye/gaussian/sh_color.hpp>

namespace rye {

/// Returns the activated cloud as seen from `eye`, three colour channels, harmonics of degree <=
/// `most`.
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

/// Returns the gradient of the cloud, given that of the result `drawn` of activate.
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
            detail::drawn_opacity_vjp(o, sigmoid(T(-cloud.logit_opacity(0, i))), g.opacity(0, i));
    }
    sh_colors_vjp<most>(cloud, eye, g.feature, r);
    return r;
}

/// Returns the cloud of degree 0 that renders as `g`, from its first three channels. Opacities and
/// scales are clamped to the range of their logit and logarithm.
template <Real T>
GaussianCloud<T> deactivate(const Gaussians<T>& g) {
    require(g.channels() >= 3, "deactivate", "got ", g.channels(),
            " channels, expected at least 3 of colour");
    GaussianCloud<T> r(g.count(), 0);
    r.mean = g.mean;
    r.rotation = g.rotation;
    r.log_scale = g.scale.unaryExpr(
        [](const T& s) { return std::log(std::max(s, std::numeric_limits<T>::min())); });
    r.logit_opacity = g.opacity.unaryExpr([](const T& o) {
        constexpr T u = std::numeric_limits<T>::epsilon() / 2;
        return logit(std::clamp(o, u, T(1) - u));
    });
    r.sh_constant = (g.feature.topRows(3).array() - T(0.5)) / static_cast<T>(detail::sh_factor(0));
    return r;
}

} // namespace rye
