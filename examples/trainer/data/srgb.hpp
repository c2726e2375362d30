// SPDX-License-Identifier: Apache-2.0
/// data/srgb.hpp: sRGB's curve (IEC 61966-2-1) between stored values and linear light, both 0 to 1.
#pragma once

#include <cmath>

namespace rye::trainer {

inline double linear(double s) {
    return s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4);
}
inline double srgb(double x) {
    return x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055;
}

} // namespace rye::trainer
