// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/gaussians.hpp: Gaussians in device memory, as they are driven, drawn and
/// differentiated there.
#pragma once

#include <rye/backend/cuda.hpp>
#include <rye/gaussian/gaussian_arrays.hpp>

namespace rye {

/// Gaussians in device memory.
template <class T>
using DeviceGaussians = detail::GaussianArrays<T>;

} // namespace rye
