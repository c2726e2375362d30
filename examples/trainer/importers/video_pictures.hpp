// SPDX-License-Identifier: Apache-2.0
/// importers/video_pictures.hpp: pictures and masks of a capture from those of a video: one square
/// part of all pictures that has the head of each, scaled.
#pragma once

#include <vector>

#include "data/picture.hpp"
#include "importers/import_folder.hpp"
#include "importers/video_head.hpp"

namespace rye::trainer {

/// A square of the pictures of a video, which may reach beyond them.
struct VideoSquare {
    double left = 0, top = 0, side = 0; ///< [px]
    int size = 0;                       ///< of the pictures that are made of it [px]
};

/// Which points of a picture [px] show what is below the neck, in the plane of the head's middle:
/// 3 cm below the chin, which is given in the world [dm].
class BelowNeck {
  public:
    BelowNeck(const Rigid<double>& world_from_head, const Vec3<double>& chin,
              const Pinhole<double>& camera);
    bool operator()(double u, double v) const;

  private:
    Rigid<double> from_head_;
    Pinhole<double> camera_;
    double height_ = 0, depth_ = 0;
};

/// Returns the square around all heads, for pictures of at most `size` pixels, never enlarged.
VideoSquare square_of(const Tracks& tracks, const std::vector<int>& pictures, int size);

/// Returns picture, mask, eye mask and what is visible of a head. The mask ends below the chin, where
/// the neck turns otherwise than the head; what is below is not visible.
ImportView view_of(const Tracks& tracks, const VideoHead& head, const VideoPose& pose,
                   const VideoSquare& square);

} // namespace rye::trainer
