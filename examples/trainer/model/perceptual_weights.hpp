// SPDX-License-Identifier: Apache-2.0
/// model/perceptual_weights.hpp: the file of LPIPS's weights, and the distance by it.
#pragma once

#include <filesystem>
#include <functional>

#include <rye/core/columns.hpp>

namespace rye::trainer {

/// Throws an Error if the file of weights, if any, cannot be read.
void check_perceptual_weights(const std::filesystem::path& perceptual_weights);

/// Distance of two RGB pictures of one size.
using PictureDistance = std::function<double(const Image<float>&, const Image<float>&)>;
/// Returns LPIPS by the weights in a file; empty without a file.
PictureDistance lpips_of(const std::filesystem::path& perceptual_weights);

} // namespace rye::trainer
