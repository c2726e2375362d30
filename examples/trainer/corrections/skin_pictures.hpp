// SPDX-License-Identifier: Apache-2.0
/// corrections/skin_pictures.hpp: blurred grey pictures of heads, and their values at points.
#pragma once

#include <optional>
#include <vector>

#include "data/capture.hpp"

namespace rye::trainer {

/// Value of a picture at a place.
struct SkinValue {
    Vec2<double> at;    ///< full-size pixels
    Vec2<double> slope; ///< derivative by these
    double grey;        ///< 0 to 1
};

/// Pictures of some frames by some cameras.
class SkinPictures {
  public:
    /// frames, cameras: indices in the capture. Reads all their pictures; those above `largest`
    /// pixels are made smaller.
    SkinPictures(const Capture& capture, const std::vector<int>& frames,
                 const std::vector<std::size_t>& cameras, int largest);

    /// Returns the same pictures with sides of about so many pixels, each a mean of some.
    SkinPictures coarser(int side) const;

    /// Returns true if the capture has this picture, by the order of the constructor's.
    bool has(std::size_t frame, std::size_t camera) const {
        return !pictures_[frame * cameras_ + camera].grey.empty();
    }
    /// Returns the value at a pixel of the full size; nothing outside the head and at its rim.
    std::optional<SkinValue> value(std::size_t frame, std::size_t camera,
                                   const Vec2<double>& at) const;
    /// Returns the size of a pixel of the full size in these pictures.
    double scale() const { return scale_; }

  private:
    SkinPictures(std::size_t cameras, double scale) : cameras_(cameras), scale_(scale) {}

    struct Picture {
        int width = 0, height = 0;
        std::vector<float> grey; ///< blurred; negative outside the head
    };
    std::size_t cameras_;
    double scale_;
    std::vector<Picture> pictures_; ///< frames x cameras
};

/// Smallest cosine of the angle from a point's outward direction to a camera that sees it.
inline constexpr double frontal_skin = 0.6;

} // namespace rye::trainer
