// SPDX-License-Identifier: Apache-2.0
/// corrections/skin_positions.hpp: where cameras show the skin, by comparing their pictures of the same
/// frames at the points of the labels: the picture of a camera whose numbers are wrong is displaced
/// everywhere in nearly the same way. Source: Lucas and Kanade, 1981, with a similarity of the
/// picture, which is what a camera does that turns and zooms, and a gain.
#pragma once

#include <vector>

#include "corrections/camera_fit.hpp"
#include "corrections/skin_pictures.hpp"
#include "data/capture.hpp"

namespace rye::trainer {

/// Pictures of some frames by some cameras, for comparisons at points of the skin.
class SkinPositions {
  public:
    /// frames, cameras: indices in the capture; head: its centre in the head's frame. Reads all their
    /// pictures; those above `largest` pixels are made smaller, in which skin is found that is
    /// further off.
    SkinPositions(const Capture& capture, const std::vector<int>& frames,
                  const std::vector<std::size_t>& cameras, const Vec3<double>& head,
                  int largest = 512);

    /// Returns where the cameras, as many and in the order of the constructor's, show some landmarks
    /// of the frames; nothing for a camera that shares too little with at least two others, or has
    /// fewer than six frames. The points have the indices of landmarks().
    std::vector<SeenPoint> seen(const std::vector<Pinhole<double>>& cameras) const;
    /// Returns how much the grey values of each camera's skin differ from those of the others, by a
    /// gain: robust root mean squares; 0 for a camera that shares none.
    std::vector<double> differences(const std::vector<Pinhole<double>>& cameras) const;
    /// Returns these landmarks of all frames, 3 x n, world.
    const Columns<double>& landmarks() const { return landmarks_; }

  private:
    /// A point's grey value in a camera.
    struct Sample {
        std::size_t camera, point;
        Vec2<double> at, slope; ///< full-size pixels, and the derivative by these
        double grey;
    };
    std::vector<Sample> samples(const std::vector<Pinhole<double>>& cameras) const;

    SkinPictures pictures_;
    std::vector<Columns<double>> points_, outwards_; ///< 3 x P of each frame, world
    Columns<double> landmarks_;
    Vec2<double> middle_;             ///< of a picture [px]
};

} // namespace rye::trainer
