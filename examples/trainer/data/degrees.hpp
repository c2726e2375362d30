// SPDX-License-Identifier: Apache-2.0
/// data/degrees.hpp: angles in degrees, for what people read and write.
#pragma once

#include <numbers>

namespace rye::trainer {

inline constexpr double degree = std::numbers::pi / 180;  ///< [rad]
inline constexpr double degrees = 180 / std::numbers::pi; ///< in a radian

} // namespace rye::trainer
