// SPDX-License-Identifier: Apache-2.0
/// rye/interactive/frame_cache.hpp: incremental rendering of successive frames. An update compares
/// drivers, camera and background with the previous ones, by bits, and recomputes only what they
/// affect (interactive/drive_cache.hpp, interactive/redraw.hpp,
/// interactive/upsampler_cache.hpp):
///
///     changed             deformation      render                            super-resolution
///     nothing             none             none                              none
///     a gaze              influenced       the Gaussians it moved, and the   where these tiles are
///                                          tiles of their old and new places (or whole)
///     expression, pose    influenced       the same, or all if many moved    the same
///     background          none             blending                          whole
///     camera, dilation    highlights,      whole                             whole
///                         refraction
///
/// Every image equals that of drive(), Rasterizer::forward and upsampler_forward, bit for bit.
/// Memory: see bytes().
#pragma once

#include <concepts>
#include <functional>
#include <optional>

#include <rye/interactive/drive_cache.hpp>
#include <rye/interactive/upsampler_cache.hpp>
#include <rye/interactive/redraw.hpp>

namespace rye {

/// Driven Gaussians, their render and the upsampled image, of which a frame recomputes the changed
/// parts.
template <Backend B, AccuracyPolicy A, Real T, EffectSet E = PaperEffects>
    requires KeptFromFrameToFrame<E>
class FrameCache {
    static_assert(std::same_as<detail::UpsamplerOf<T, E>, Upsampler<T>>,
                  "FrameCache: an upsampler of one's own is not kept from frame to frame");

  public:
    /// Type of the avatars.
    using Avatar = TwoStream<T, E>;

    /// Avatar, configuration and roles must outlive the cache. Call reset() when the avatar's
    /// parameters have changed.
    FrameCache(const B& backend, const Avatar& avatar,
               std::reference_wrapper<const AvatarConfig> config,
               std::reference_wrapper<const LandmarkRoles> roles,
               const Rasterizer<A>& rasterizer = {})
        : avatar_(&avatar),
          drive_(backend, avatar, config, roles),
          redraw_(backend, rasterizer),
          upsampler_(backend) {}
    FrameCache(const B&, const Avatar&&, std::reference_wrapper<const AvatarConfig>,
               std::reference_wrapper<const LandmarkRoles>, const Rasterizer<A>& = {}) = delete;

    void reset() {
        drive_.reset();
        shown_.reset();
    }

    /// Renders with this dilation from now on [px^2].
    void set_dilation(double dilation) { redraw_.set_dilation(dilation); }

    /// Moves the Gaussians as the camera sees them, and renders nothing; the next update renders
    /// all.
    const Gaussians<T>& move(const Drivers<T, E>& drivers, const Pinhole<T>& camera) {
        shown_.reset();
        return drive_.update(seen_from(drivers, camera));
    }

    /// Updates and returns the render; `camera` is that of the render.
    const Raster<T, A::outputs>& update(const Drivers<T, E>& drivers, const Pinhole<T>& camera,
                                        const VecX<T>& background) {
        const bool whole = !shown_ || !redraw_.drawn() || !same_bits(camera, shown_->camera);
        const bool repaint = whole || !same_bits(background, shown_->background);
        shown_.reset();  // invalid until the update is complete
        const Gaussians<T>& g = drive_.update(seen_from(drivers, camera));
        const std::vector<Index>& changed = drive_.changed();
        if (whole || static_cast<Index>(changed.size()) > g.count() / whole_share) {
            redraw_.draw(g, camera, background);
            picture_ = Stale::whole;
            stale_ = Region(camera.width, camera.height);
        } else {
            redraw_.redraw(g, changed);
            stale_.add(redraw_.region());
            if (repaint) {
                redraw_.redraw_background(g, background);
                picture_ = Stale::whole;
            }
        }
        shown_ = Shown{camera, background};
        return redraw_.raster();
    }

    /// Returns the last update's render after super-resolution.
    const Image<T>& picture() {
        require(shown_.has_value(), "FrameCache", "picture() was called before update()");
        const Image<T>& render = redraw_.raster().feature;
        if (picture_ == Stale::whole)
            upsampler_.draw(avatar_->upsampler, render);
        else
            upsampler_.redraw(avatar_->upsampler, render, stale_);
        picture_ = Stale::region;
        stale_ = Region(render.width, render.height);
        return upsampler_.picture();
    }

    const DriveCache<B, T, E>& drive() const { return drive_; }
    const Redraw<B, A, T>& render() const { return redraw_; }
    const detail::UpsamplerCache<B, T>& upsampler() const { return upsampler_; }
    std::size_t bytes() const { return drive_.bytes() + redraw_.bytes() + upsampler_.bytes(); }

  private:
    /// Reciprocal of the share of moved Gaussians beyond which a full render is cheaper.
    static constexpr Index whole_share = 2;

    struct Shown {
        Pinhole<T> camera;
        VecX<T> background;
    };
    enum class Stale { whole, region };  ///< part of the picture that picture() must recompute

    static bool same_bits(const VecX<T>& a, const VecX<T>& b) { return rye::same_bits(a, b); }
    static bool same_bits(const Pinhole<T>& a, const Pinhole<T>& b) {
        const auto same = [](const T& x, const T& y) { return rye::same_bits(x, y); };
        return same(a.fx, b.fx) && same(a.fy, b.fy) && same(a.cx, b.cx) && same(a.cy, b.cy) &&
               a.width == b.width && a.height == b.height && same(a.near_depth, b.near_depth) &&
               rye::same_bits(a.camera_from_world.rotation, b.camera_from_world.rotation) &&
               rye::same_bits(a.camera_from_world.translation, b.camera_from_world.translation);
    }

    const Avatar* avatar_;
    DriveCache<B, T, E> drive_;
    Redraw<B, A, T> redraw_;
    detail::UpsamplerCache<B, T> upsampler_;
    std::optional<Shown> shown_;
    Stale picture_ = Stale::whole;
    Region stale_{0, 0};                  ///< dirty part for Stale::region
};

} // namespace rye
