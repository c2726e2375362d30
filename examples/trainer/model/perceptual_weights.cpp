// SPDX-License-Identifier: Apache-2.0
#include "model/perceptual_weights.hpp"

#include <rye/io/lpips_weights.hpp>

#include "model/types.hpp"

namespace rye::trainer {

void check_perceptual_weights(const std::filesystem::path& perceptual_weights) {
    if (!perceptual_weights.empty()) read_lpips_weights<float>(perceptual_weights);
}

PictureDistance lpips_of(const std::filesystem::path& perceptual_weights) {
    if (perceptual_weights.empty()) return {};
    const LpipsVgg<float> lpips{read_lpips_weights<float>(perceptual_weights)};
    return [lpips](const Image<float>& a, const Image<float>& b) {
        return static_cast<double>(lpips.value(train_backend(), a, b));
    };
}

} // namespace rye::trainer
