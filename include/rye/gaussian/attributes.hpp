// SPDX-License-Identifier: Apache-2.0
/// rye/gaussian/attributes.hpp: activation of stored numbers: scale = exp, opacity = sigmoid. The
/// quaternion is normalised where it is used.
#pragma once

#include <cmath>

#include <rye/math/scalar.hpp>

namespace rye {

/// Returns the scale of a stored logarithm.
template <Scalar T>
RYE_HD T drawn_scale(const T& log_scale) {
    using std::exp;
    return exp(log_scale);
}

namespace detail {

/// Returns the cotangent of the log scale, from the scale.
template <Scalar T>
RYE_HD T drawn_scale_vjp(const T& scale, const T& g) {
    return g * scale;
}

} // namespace detail

/// Returns the opacity of a stored logit.
template <Scalar T>
RYE_HD T drawn_opacity(const T& logit) {
    return sigmoid(logit);
}

namespace detail {

/// Returns the cotangent of the logit, from the opacity and its complement 1 - opacity:
/// sigmoid(-logit) where the logit is available, which stays accurate near an opacity of 1.
template <Scalar T>
RYE_HD T drawn_opacity_vjp(const T& opacity, const T& rest, const T& g) {
    return g * opacity * rest;
}

} // namespace detail

} // namespace rye
