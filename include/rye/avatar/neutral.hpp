// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/neutral.hpp: the parameters and drivers at which an effect changes nothing: an avatar
/// with the effect then equals one without it. tests/avatar/effects_test.cpp proves it for each.
#pragma once

#include <rye/avatar/two_stream.hpp>
#include <rye/rig/eyeball.hpp>

namespace rye {

namespace detail {

/// A network whose outputs are 0, whatever it reads.
template <class T, class A>
void silence(Mlp<T, A>& mlp) {
    mlp.weight.back().setZero();
    mlp.bias.back().setZero();
}

template <std::size_t eye, class T, EffectSet E>
void silence_skin(TwoStream<T, E>& avatar) {
    if constexpr (skin_follows<E, eye>) {
        silence(of_eye<eye>(avatar.face.networks.gaze_color));
        silence(of_eye<eye>(avatar.face.networks.gaze_deform));
    }
}

} // namespace detail

/// Makes effect X neutral; the avatar must have it.
template <Effect X, class T, EffectSet E>
    requires has_effect<E, X>
void make_neutral(TwoStream<T, E>& avatar, Drivers<T, E>& drivers) {
    const auto silence_field = [&](auto by) {
        detail::silence(by.color(avatar.face.networks));
        detail::silence(by.deform(avatar.face.networks));
        detail::silence(by.attribute(avatar.face));
    };
    if constexpr (std::same_as<X, Expression>) silence_field(ExpressionField{});
    if constexpr (std::same_as<X, PoseResidual>) silence_field(PoseField{});
    if constexpr (std::same_as<X, HeadPose>) {
        drivers.pose.setZero();
        drivers.scale = T(1);
    }
    for_eyes([&]<std::size_t eye>() {
        using Gaze = std::conditional_t<eye == 0, LeftGaze, RightGaze>;
        if constexpr (std::same_as<X, Gaze>)
            of_eye<eye>(drivers.gaze) = Vec3<T>(T(0), T(0), T(1));
        if constexpr (std::same_as<X, Pupil> && pupil_moves<E, eye>)
            of_eye<eye>(drivers.pupil) = T(1);
        if constexpr (std::same_as<X, Gaze> || std::same_as<X, Periocular>)
            detail::silence_skin<eye>(avatar);
    });
    if constexpr (has_effect<E, Kappa>) {
        Columns<T>& kappa = avatar.eyes.kappa;
        if (std::same_as<X, Kappa> || std::same_as<X, LeftGaze>) kappa.col(0).setZero();
        if (std::same_as<X, Kappa> || std::same_as<X, RightGaze>) kappa.col(1).setZero();
    }
    if constexpr (std::same_as<X, EyeOffset>) detail::silence(avatar.eyes.offset.mlp);
    if constexpr (std::same_as<X, CornealRefraction>) avatar.eyes.optics.index.setOnes();
    if constexpr (std::same_as<X, HeadShading>) avatar.shading.light.setZero();
    if constexpr (std::same_as<X, ViewColor>) {
        avatar.view_color.face.setZero();
        avatar.view_color.eyes.setZero();
    }
    if constexpr (std::same_as<X, LidShadow>)
        avatar.eyes.lid_shadow.row(0).setConstant(-Limits<real_t<T>>::infinity);
    if constexpr (std::same_as<X, Glint>) avatar.eyes.optics.light_intensity.setZero();
}

/// The same eyeball without its bulge.
inline void make_neutral(EyeballShape& shape) {
    shape.cornea_radius = shape.sclera_radius;
    shape.cornea_offset = 0;
}

} // namespace rye
