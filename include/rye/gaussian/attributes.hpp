// SPDX-License-Identifier: Apache-2.0
/// rye/gaussian/attributes.hpp: stored numbers to drawn ones, number by number: scale = exp,
/// opacity = sigmoid. The quaternion is normalised where it is used.
#pragma once

#include <cmath>

#include <rye/math/scalar.hpp>

namespace rye {

template <Scalar T>
RYE_HD T drawn_scale(const T& log_scale) {
    using std::exp;
    return exp(log_scale);
}
/// Cotangent of the logarithm, from the scale.
template <Scalar T>
RYE_HD T drawn_scale_vjp(const T& scale, const T& g) {
    return g * scale;
}

template <Scalar T>
RYE_HD T drawn_opacity(const T& logit) {
    return sigmoid(logit);
}
/// Cotangent of the logit, from the opacity and 1 less it: sigmoid(-logit) where that is known,
/// which keeps its digits near an opacity of 1.
template <Scalar T>
RYE_HD T drawn_opacity_vjp(const T& opacity, const T& rest, const T& g) {
    return g * opacity * rest;
}

} // namespace rye
