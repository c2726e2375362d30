// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/gaussians.hpp: Gaussians in device memory, as they are driven, drawn and
/// differentiated there.
#pragma once

#include <concepts>
#include <type_traits>

#include <rye/backend/cuda.hpp>

namespace rye {

/// Gaussians in device memory, of as many numbers a column as Gaussians<T> has.
template <class T>
struct DeviceGaussians {
    DeviceColumns<T> mean, rotation, scale, opacity, feature;

    RYE_HD Index count() const { return mean.cols; }
    RYE_HD Index channels() const { return feature.rows; }
    template <class U>
        requires(std::same_as<U, const T> && !std::is_const_v<T>)
    operator DeviceGaussians<U>() const { return {mean, rotation, scale, opacity, feature}; }
};

} // namespace rye
