// SPDX-License-Identifier: Apache-2.0
/// rye/interactive/player.hpp: successive pictures of a playable avatar, of which only the parts
/// that differ from the previous picture are computed (interactive/frame_cache.hpp). Pictures have
/// three channels in 0..1, sRGB as trained, at the size of the camera; they equal those of drive(),
/// Rasterizer::forward and upsampler_forward bit for bit, with the dilation that keeps Gaussians as
/// wide on the head as in training (avatar/drawn_size.hpp).
/// Memory: that of the frame cache.
#pragma once

#include <algorithm>
#include <array>
#include <string>

#include <rye/avatar/hold.hpp>
#include <rye/avatar/playable.hpp>
#include <rye/interactive/frame_cache.hpp>

namespace rye {

/// Work of the last picture.
struct PlayedWork {
    Index gaussians = 0; ///< moved
    Index networks = 0;  ///< evaluated
    Index tiles = 0;     ///< of the render, blended whole or in part
    Index pixels = 0;    ///< of the picture after super-resolution, recomputed
};

/// Player of a playable avatar, which must outlive it and not change.
template <Backend B, Real T = float, AccuracyPolicy A = FeaturesOnly<Balanced>>
class AvatarPlayer {
  public:
    AvatarPlayer(const B& backend, const PlayableAvatar<T>& playable)
        : playable_(&playable),
          size_(box_middle(playable.avatar.face.position), playable.neutral, playable.camera),
          cache_(backend, playable.avatar, playable.config, playable.roles) {}
    AvatarPlayer(const B&, const PlayableAvatar<T>&&) = delete; // it would not outlive the player

    /// Returns the picture, valid until the next call. Gazes are as PlayableAvatar's, `camera` is
    /// that of the picture, `background` the feature behind the head, C. Throws an Error for
    /// drivers, a camera or a background that do not suit the avatar (check_drivers, check_camera),
    /// and if the drivers lead to Gaussians that are not finite.
    const Image<T>& draw(const Drivers<T>& drivers, const Pinhole<T>& camera,
                         const VecX<T>& background) {
        const std::string who = "AvatarPlayer";
        check_drivers(who, playable_->config, drivers);
        check_camera(who, camera);
        require(background.size() == playable_->config.channels, who, "'background': got ",
                background.size(), " channels, expected ", playable_->config.channels);
        detail::require_all_finite(who, "background", background);
        take_size(drivers, camera);
        const int factor = 1 << playable_->avatar.upsampler.shape.doublings;
        cache_.update(with_pupils(drivers), render_camera(camera, factor),
                      background);
        check_drawn(who);
        const Image<T>& picture = cache_.picture();
        work_ = {static_cast<Index>(cache_.drive().changed().size()),
                 cache_.drive().work().networks, cache_.render().work().blended,
                 cache_.upsampler().pixels()};
        if (picture.width == camera.width && picture.height == camera.height) return picture;
        cropped_ = Image<T>(camera.width, camera.height, 3);
        for (int y = 0; y < camera.height; ++y)
            cropped_.pixels.middleCols(static_cast<Index>(y) * camera.width, camera.width) =
                picture.pixels.middleCols(static_cast<Index>(y) * picture.width, camera.width);
        return cropped_;
    }

    /// Returns the Gaussians by these drivers as the camera sees them, in the world, the face's
    /// first, for a program that draws them by itself; the next picture is drawn anew. Errors are
    /// those of draw().
    const Gaussians<T>& drive(const Drivers<T>& drivers, const Pinhole<T>& camera) {
        const std::string who = "AvatarPlayer";
        check_drivers(who, playable_->config, drivers);
        check_camera(who, camera);
        take_size(drivers, camera);
        cache_.move(with_pupils(drivers), camera);
        check_drawn(who);
        work_ = {static_cast<Index>(cache_.drive().changed().size()),
                 cache_.drive().work().networks, 0, 0};
        return gaussians();
    }

    /// Sets the radii of the left and the right pupil over those at rest (rig/pupil.hpp), from the
    /// next picture on. Throws as pupil_map.
    void set_pupils(const std::array<T, 2>& ratio) {
        for (std::size_t eye = 0; eye < 2; ++eye) {
            const Iris<T> iris = iris_of(playable_->avatar.eyes, static_cast<Index>(eye));
            static_cast<void>(pupil_map<T>(eye, iris, ratio[eye]));
        }
        pupil_ = ratio;
    }

    const PlayedWork& work() const { return work_; }
    /// Returns the dilation of the last picture or drive [px^2].
    double dilation() const { return dilation_; }
    /// Returns the Gaussians of the last picture or drive, in the world, the face's first.
    const Gaussians<T>& gaussians() const { return cache_.drive().gaussians(); }
    const PlayableAvatar<T>& playable() const { return *playable_; }
    /// Returns the size of all cached data [bytes].
    std::size_t bytes() const { return cache_.bytes(); }

  private:
    Drivers<T, TrainedEffects> with_pupils(const Drivers<T>& drivers) const {
        Drivers<T, TrainedEffects> all = restricted<TrainedEffects>(drivers);
        all.pupil = pupil_;
        return all;
    }
    void take_size(const Drivers<T>& drivers, const Pinhole<T>& camera) {
        dilation_ = size_.dilation(A{}.dilation, drivers, camera);
        cache_.set_dilation(dilation_);
    }
    /// Throws an Error if a drawn number is not finite: it draws nothing, or anything.
    void check_drawn(const std::string& who) {
        const Gaussians<T>& g = cache_.drive().gaussians();
        for (const Index i : cache_.drive().changed()) {
            const bool finite = g.mean.col(i).allFinite() && g.rotation.col(i).allFinite() &&
                                g.scale.col(i).allFinite() && g.opacity.col(i).allFinite() &&
                                g.feature.col(i).allFinite();
            if (finite) continue;
            cache_.reset();
            throw Error(who + ": Gaussian " + std::to_string(i) +
                        " is not finite; the drivers are far from those of training");
        }
    }

    const PlayableAvatar<T>* playable_;
    TrainedSize<T> size_;
    std::array<T, 2> pupil_{T(1), T(1)};
    double dilation_ = A{}.dilation;
    FrameCache<B, A, T, TrainedEffects> cache_;
    PlayedWork work_;
    Image<T> cropped_;
};

} // namespace rye
