// SPDX-License-Identifier: Apache-2.0
/// data/flaw_pictures.hpp: errors in pictures, masks and eye masks, in the order in which a camera
/// makes them: blur, vignetting and gains in linear light, then noise of the stored values.
/// Pixels are sRGB of 8 bits; linear light follows from them by sRGB's curve (IEC 61966-2-1).
#pragma once

#include <rye/core/columns.hpp>

#include "data/flaw_draws.hpp"
#include "data/picture.hpp"

namespace rye::trainer {

/// Errors of a camera's pictures.
struct LightFlaws {
    Vec3<double> gains = Vec3<double>::Ones(); ///< factors of the channels' linear light
    double falloff = 0;                        ///< - log of the corners' factor
    double blur = 0;                           ///< standard deviation of the kernel [px]
    double noise = 0;                          ///< standard deviation [of 255]
};

/// Draws gain, white balance and vignetting of the camera of this index; blur and noise are sizes.
LightFlaws light_flaws(const FlawDraws& draws, const FlawSizes& sizes, std::size_t camera,
                       FlawSums& sums);

/// Picture with its masks, which are for one over black; null for a photograph.
struct FlawedPicture {
    const Image8* picture = nullptr; ///< 3 channels
    const Image8* mask = nullptr;    ///< mask by which it was cut out
    const Image8* cut = nullptr;     ///< mask by which it is cut out again, if smaller
};

/// Returns the picture with the errors; `noise` draws each number of it. A picture over black
/// changes within its mask alone.
Image8 flawed_picture(const FlawedPicture& p, const LightFlaws& flaws, const Random& noise,
                      FlawSums& sums);

/// Returns the mask blurred by a standard deviation [px].
Image8 softened(const Image8& mask, double size, FlawSums& sums);

/// Returns the mask displaced by a smooth random field, whose coordinates have a standard deviation
/// of `size` [px] and are correlated over about 4 * size + 4 pixels.
Image8 displaced(const Image8& mask, double size, const Random& random, FlawSums& sums);

/// Returns the eye mask with the labels of pixels up to `distance` [px] away from an eyeball.
Image8 dilated(const Image8& eyes, double distance, FlawSums& sums);

} // namespace rye::trainer
