// SPDX-License-Identifier: Apache-2.0
/// rye/io/splat_quantize.hpp: common parts of the small splat formats (.splat, SPZ, GLB):
/// numbers as bytes, checks for numbers that cannot be stored, and the rotation between the axes of
/// a PLY (x right, y down, z forward for an upright subject) and those of SPZ and glTF (x right, y
/// up, z toward the viewer): half a turn about x. Clouds as in gaussian/cloud.hpp.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>

#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/io/ply.hpp>
#include <rye/math/rotation.hpp>

namespace rye::detail {

/// Returns the nearest whole number in 0..255.
template <Real T>
std::uint8_t nearest_byte(T x) {
    return static_cast<std::uint8_t>(std::lround(std::clamp(x, T(0), T(255))));
}

/// Signs of the 24 coefficients above band 0, degrees 1 to 4, under half a turn about x.
inline constexpr std::array<int, 24> sh_half_turn{-1, -1, 1, -1, 1,  1, -1, 1, -1, 1, -1, -1,
                                                  1,  -1, 1, -1, 1, -1, 1,  1, -1, 1, -1, 1};

/// Throws an Error, with the field and the Gaussian, unless every number is finite and every array
/// has the cloud's shape.
template <Real T>
void check_storable(const GaussianCloud<T>& cloud, const std::string& who) {
    GaussianCloud<T>::fields(
        [&](const std::string& name, const Columns<T>& a) {
            require(a.cols() == cloud.count(), who, name, " has ", a.cols(), " columns, expected ",
                    cloud.count());
            for (Index i = 0; i < a.cols(); ++i)
                for (Index k = 0; k < a.rows(); ++k)
                    if (!std::isfinite(a(k, i)))
                        throw Error(who + ": " + name + " of Gaussian " + std::to_string(i) +
                                    " is " + number_text(a(k, i)) + ", not finite");
        },
        cloud);
}

} // namespace rye::detail
