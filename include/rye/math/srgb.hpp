// SPDX-License-Identifier: Apache-2.0
/// rye/math/srgb.hpp: sRGB's curve between stored values and linear light, both 0 to 1.
/// Source: IEC 61966-2-1.
#pragma once

#include <cmath>

namespace rye {

/// Returns the linear light of a stored value.
inline double linear_from_srgb(double s) {
    return s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4);
}
/// Returns the stored value of linear light.
inline double srgb_from_linear(double x) {
    return x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055;
}

} // namespace rye
