// SPDX-License-Identifier: Apache-2.0
/// rye/interactive/kept_highlights.hpp: the highlights of an avatar's eyes, the shadows of the lids
/// and the refraction of the irises, which change with the lids and with the camera: the colours
/// before them are kept, so that another view evaluates no network.
#pragma once

#include <array>

#include <rye/avatar/eye_stream.hpp>

namespace rye::detail {

/// Colours of both eyes before highlights and shadows, and their points as refracted. Empty, and
/// nothing is done, for an avatar without lights, refraction and shadows of lids.
template <class T, EffectSet E>
class KeptHighlights {
  public:
    /// Returns true if the eyes have lights.
    static bool shine(const EyeStream<T, E>& eyes) {
        if constexpr (has_effect<E, Glint>) return eyes.optics.lights() > 0;
        return false;
    }
    /// Returns true if the eyes have lights or shadows.
    static bool any(const EyeStream<T, E>& eyes) { return shine(eyes) || eyes.has_lid_shadow(); }

    /// Follows the driven face, means in the head's frame and positions at rest, and the eyes'
    /// centres, 3 x 2; returns the eyes whose lid differs from the last call's, by bits.
    std::array<bool, 2> follow([[maybe_unused]] const EyeStream<T, E>& eyes,
                               [[maybe_unused]] const Columns<T>& mean,
                               [[maybe_unused]] const Columns<T>& rest,
                               [[maybe_unused]] const Columns<T>& centre,
                               [[maybe_unused]] const OpticalDrivers<T, E>& optical) {
        std::array<bool, 2> differs{};
        if constexpr (has_effect<E, LidShadow>)
            if (eyes.has_lid_shadow()) {
                const std::array<LidOfEye<T>, 2> last = lids_.eye;
                take_lid_points(eyes, mean, rest, lids_);
                for_eyes([&]<std::size_t eye>() {
                    place_lid<eye>(eyes, Vec3<T>(centre.col(static_cast<Index>(eye))), optical,
                                   lids_);
                    differs[eye] = !same_lid(last[eye], lids_.eye[eye]);
                });
            }
        return differs;
    }

    /// Returns an eye's points as the camera sees them; `points`: as its pupil moves them. Valid
    /// until the next call for that eye.
    template <Backend B>
    const T* see([[maybe_unused]] const B& backend, [[maybe_unused]] const EyeStream<T, E>& eyes,
                 [[maybe_unused]] std::size_t eye, [[maybe_unused]] const Drivers<T, E>& drivers,
                 [[maybe_unused]] const EyeTransform<T>& placed, const T* points) {
        if constexpr (has_effect<E, CornealRefraction>)
            if (eyes.optics.refracts()) {
                require_camera(drivers.camera);
                check_optics(eyes.optics);
                const Index n = eyes.points_of(static_cast<Index>(eye));
                seen_[eye].resize(3, n);
                const ViewedEye<T> viewed{eye, drivers.camera, placed, points, n};
                see_points(backend, eyes.optics, viewed, seen_[eye].data());
                return seen_[eye].data();
            }
        return points;
    }

    /// Adds an eye's highlights and shadow to its columns of `feature`, of which `begin` is the
    /// first of both eyes'. `points`: that eye's. `fresh`: the columns have been written since;
    /// else they begin with what they were then.
    template <Backend B>
    void add([[maybe_unused]] const B& backend, const EyeStream<T, E>& eyes, std::size_t eye,
             [[maybe_unused]] const Drivers<T, E>& drivers,
             [[maybe_unused]] const EyeTransform<T>& placed, [[maybe_unused]] const T* points,
             bool fresh, Columns<T>& feature, Index begin) {
        if (!any(eyes)) return;
        const Index e = static_cast<Index>(eye), first = eyes.first_point(e), n = eyes.points_of(e);
        plain_.resize(feature.rows(), eyes.position.cols());
        auto own = feature.middleCols(begin + first, n);
        if (fresh)
            plain_.middleCols(first, n) = own;
        else
            own = plain_.middleCols(first, n);
        if constexpr (has_effect<E, Glint>)
            if (shine(eyes)) {
                require_camera(drivers.camera);
                check_optics(eyes.optics);
                const ViewedEye<T> viewed{eye, drivers.camera, placed, points, n};
                const T* seen = points;
                if constexpr (has_effect<E, CornealRefraction>)
                    if (eyes.optics.refracts()) seen = seen_[eye].data();
                add_highlights(backend, eyes.optics, viewed, see_lights(eyes.optics, viewed), seen,
                               feature.rows(), own.data());
            }
        if constexpr (has_effect<E, LidShadow>)
            if (eyes.has_lid_shadow())
                for_each(backend, n,
                         ShadeEyePoint<T>{points, &lids_.eye[eye], feature.rows(), own.data(),
                                          nullptr});
    }
    /// Returns how many numbers are kept.
    Index size() const {
        if constexpr (has_effect<E, CornealRefraction>)
            return plain_.size() + seen_[0].size() + seen_[1].size();
        return plain_.size();
    }

  private:
    Columns<T> plain_; ///< C x P
    /// Each eye's points, its own frame, 3 x P.
    [[no_unique_address]] Slot<E, CornealRefraction, std::array<Columns<T>, 2>, 1> seen_;
    [[no_unique_address]] Slot<E, LidShadow, FrameLids<T>> lids_;
};

} // namespace rye::detail
