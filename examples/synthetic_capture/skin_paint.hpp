// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/skin_paint.hpp: the colour of skin, brows, lips and hair as a 3D texture.
/// Defined on the neutral head, in its frame and units (head_model.hpp), relative to the 68
/// landmarks, so that it applies to any head in that frame. Colours are linear RGB.
#pragma once

#include <array>
#include <cstdint>

#include "synthetic_capture/head_model.hpp"

namespace rye::trainer {

/// A subject's colours, from a seed.
struct Palette {
    Vec3<double> skin, lips, hair, brow;
    EyeLook eyes;
    double freckles = 0; ///< 0 none, 1 many
    double brow_width = 1;
};
Palette palette(std::uint64_t seed);

/// 1 where hair covers the scalp of a head of the mean size, 0 on skin.
double hair_cover(const Vec3<double>& p, double softness);

class SkinPaint {
  public:
    /// landmarks: of the neutral head with open eyes.
    SkinPaint(const std::array<Vec3<double>, 68>& landmarks, const Palette& palette,
              std::uint64_t seed);

    /// Linear RGB, then gloss in [0, 1], of the point p of the neutral skin.
    Vec4<double> operator()(const Vec3<double>& p) const;

  private:
    std::array<Vec3<double>, 68> landmarks_;
    Palette palette_;
    std::uint64_t seed_;
    Points moles_;
};

/// Renders the albedo texture of a model whose faces, uv and landmarks are set; `neutral` are its
/// vertices with open eyes. Texels outside all faces take the colour of their neighbours.
Image<float> painted(const HeadModel& model, const Points& neutral, const SkinPaint& paint,
                     int width, int height);

/// Bilinear look-up: uv in [0, 1], v downwards.
inline Vec4<double> sampled(const Image<float>& image, const Vec2<double>& uv) {
    const double x = std::clamp(uv.x() * image.width - 0.5, 0.0, image.width - 1.001);
    const double y = std::clamp(uv.y() * image.height - 0.5, 0.0, image.height - 1.001);
    const int i = static_cast<int>(x), j = static_cast<int>(y);
    const auto a = static_cast<float>(x - i), b = static_cast<float>(y - j);
    const auto texel = [&](int k, int l) -> Vec4<float> {
        return Eigen::Map<const Vec4<float>>(image.pixels.data() +
                                             4 * (static_cast<Index>(l) * image.width + k));
    };
    const Vec4<float> top = (1 - a) * texel(i, j) + a * texel(i + 1, j);
    const Vec4<float> low = (1 - a) * texel(i, j + 1) + a * texel(i + 1, j + 1);
    return ((1 - b) * top + b * low).cast<double>();
}

} // namespace rye::trainer
