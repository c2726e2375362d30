// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_parameters.hpp: trained parameters of the eyeball Gaussians, bounds of their
/// sizes, and the optical axes that they turn to.
/// Frame: points relative to the eyeball's centre in canonical units, iris toward +z.
#pragma once

#include <rye/avatar/eye_kappa.hpp>
#include <rye/avatar/eye_offset.hpp>
#include <rye/avatar/eye_optics.hpp>
#include <rye/core/fields.hpp>

namespace rye {

/// Parameters of the eyes' parts; those of the default ones: `feature`, C x P.
template <class T, EffectSet E>
using EyeAppearanceParameters = typename EyeAppearanceOf<E>::template Parameters<T>;
/// Parameters of the gaze mechanism of E.
template <class T, EffectSet E>
using GazeMechanismParameters = typename GazeMechanismOf<E>::template Parameters<T>;

/// Sizes of the eye appearance of an avatar with so many eye points.
template <EffectSet E>
AppearanceSizes appearance_sizes(const AvatarConfig& config, Index points) {
    return {config.channels, points, has_effect<E, ReadsExpression> ? config.expression : 0,
            has_effect<E, ReadsHeadPose> ? 6 : 0};
}

/// Trained parameters of the eyeballs' P Gaussians, the left eye's first. Eyeball frame
/// (rig/eyeball.hpp).
template <class T, EffectSet E = PaperEffects>
struct EyeStream : EyeAppearanceParameters<T, E>, GazeMechanismParameters<T, E> {
    Columns<T> log_scale;      ///< 3 x P
    Columns<T> rotation;       ///< 4 x P, w x y z, in the frame of the eyeball
    Columns<T> opacity_logit;  ///< 1 x P
    [[no_unique_address]] detail::Slot<E, EyeOffset, EyeOffsetNetwork<T, detail::NetworksOf<E>>>
        offset;
    /// (pitch, yaw) [rad] an eye, 2 x 2; or empty: gazes are optical axes.
    [[no_unique_address]] detail::Slot<E, Kappa, Columns<T>> kappa;
    [[no_unique_address]] EyeOptics<T, E> optics;
    /// Numbers of the upper lids' shadows (rig/lid_shadow.hpp), an eye a column, 3 x 2; or empty:
    /// there are none.
    [[no_unique_address]] detail::Slot<E, LidShadow, Columns<T>> lid_shadow;
    /// Fixed: places on the lids' lines at rest, as many for each eye, the left's first, 3 x 2K; or
    /// empty: the column of the face's Gaussian that carries each, its x, its y (head frame).
    [[no_unique_address]] detail::Slot<E, LidShadow, Columns<T>, 1> lid_line;

    Columns<T> position;  ///< fixed: template points about their centre, 3 x P
    Columns<T> centre;    ///< fixed: neutral centres, canonical, 3 x 2
    Columns<T> spacing;   ///< fixed: distance between neighbours of the template, 1 x P
    Index left_points = -1;  ///< how many of P are the left eye's; negative: half of them

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        EyeAppearanceParameters<T, E>::fields(f, p.appearance()...);
        GazeMechanismParameters<T, E>::fields(f, p.mechanism()...);
        f("scales", p.log_scale...);
        f("rotation", p.rotation...);
        f("opacity", p.opacity_logit...);
        if constexpr (has_effect<E, EyeOffset>)
            EyeOffsetNetwork<T, detail::NetworksOf<E>>::fields(f, p.offset...);
        if constexpr (has_effect<E, Kappa>)
            if (((p.kappa.size() > 0) || ...)) f("kappa", p.kappa...);
        EyeOptics<T, E>::fields(f, p.optics...);
        if constexpr (has_effect<E, LidShadow>)
            if (((p.lid_line.size() > 0) || ...)) f("lid_shadow", p.lid_shadow...);
    }
    template <class F, class... P>
    static void buffers(F&& f, P&&... p) {
        f("xyz", p.position...);
        f("centre", p.centre...);
        f("spacing", p.spacing...);
        EyeOptics<T, E>::buffers(f, p.optics...);
        if constexpr (has_effect<E, LidShadow>)
            if (((p.lid_line.size() > 0) || ...)) f("lid_line", p.lid_line...);
    }
    /// Returns true if the upper lids cast a shadow.
    bool has_lid_shadow() const {
        if constexpr (has_effect<E, LidShadow>) return lid_line.size() > 0;
        return false;
    }
    const EyeAppearanceParameters<T, E>& appearance() const { return *this; }
    EyeAppearanceParameters<T, E>& appearance() { return *this; }
    const GazeMechanismParameters<T, E>& mechanism() const { return *this; }
    GazeMechanismParameters<T, E>& mechanism() { return *this; }

    /// Columns of an eye: its first one, and how many.
    Index first_point(Index eye) const { return eye == 0 ? 0 : points_of(0); }
    Index points_of(Index eye) const {
        const Index left = left_points < 0 ? position.cols() / 2 : left_points;
        return eye == 0 ? left : position.cols() - left;
    }
};

namespace detail {

/// The largest logarithms of scales that bound_scales leaves, 3 x P.
template <Real T, EffectSet E>
Columns<T> scale_bounds(const EyeStream<T, E>& eyes, std::type_identity_t<T> factor,
                        std::type_identity_t<T> thickness) {
    Columns<T> most(3, eyes.log_scale.cols());
    for (Index i = 0; i < most.cols(); ++i) {
        const T wide = std::log(factor * eyes.spacing(0, i));
        most.col(i) << wide, wide, wide + std::log(thickness);
    }
    return most;
}

/// Takes scales back to at most `factor` times the template's spacing, and `thickness` of that
/// along the normal, so that the eyeball keeps its shape: larger Gaussians would reach over its rim
/// and paint lids, thicker ones stand out from its surface.
template <Real T, EffectSet E>
void bound_scales(EyeStream<T, E>& eyes, std::type_identity_t<T> factor,
                  std::type_identity_t<T> thickness) {
    eyes.log_scale = eyes.log_scale.cwiseMin(scale_bounds(eyes, factor, thickness));
}

} // namespace detail

/// Returns the drivers with optical axes, by the avatar's kappa; without one their gazes are these.
template <class T, EffectSet E>
OpticalDrivers<T, E> optical_drivers([[maybe_unused]] const EyeStream<T, E>& eyes,
                                     const Drivers<T, E>& drivers) {
    OpticalDrivers<T, E> optical(drivers);
    if constexpr (has_effect<E, Kappa>)
        if (eyes.kappa.size() > 0)
            for_eyes([&]<std::size_t eye>() {
                if constexpr (eye_turns<E, eye>)
                    of_eye<eye>(optical.drivers.gaze) = apply_kappa<T>(
                        of_eye<eye>(drivers.gaze), detail::kappa_of(eyes.kappa, eye));
            });
    return optical;
}

} // namespace rye
