// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/drivers.hpp: what a frame is driven by, and its codes as the networks read them; of
/// both only what the effects read.
/// Frames: x_world = S R(pose[0:3]) x_head + pose[3:6] (GHA's convention); gaze is a unit vector in
/// the head frame, +z out of the face; eye 0 is the subject's left.
#pragma once

#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include <rye/avatar/config.hpp>
#include <rye/core/columns.hpp>
#include <rye/core/error.hpp>
#include <rye/nn/encoding.hpp>
#include <rye/rig/effect_slots.hpp>
#include <rye/rig/gaze.hpp>

namespace rye {

/// Present where an effect reads the expression.
using ReadsExpression = detail::ReaderOf<Reads::expression>;
/// Present where an effect reads the head pose.
using ReadsHeadPose = detail::ReaderOf<Reads::head_pose>;
/// Present where an effect reads the camera's position.
using ReadsCamera = detail::ReaderOf<Reads::camera>;

namespace detail {

/// 1 for each eye of an EachEye; an empty slot if V is absent.
template <class V>
V ones() {
    V r{};
    for_eyes([&]<std::size_t eye>() {
        if constexpr (requires { r.left; } ? eye == 0 : requires { r.right; } ? eye == 1
                                                                              : !is_absent<V>)
            of_eye<eye>(r) = std::remove_reference_t<decltype(of_eye<eye>(r))>(1);
    });
    return r;
}

/// A point that nobody has set, where V is one.
template <class V>
V unset_point() {
    if constexpr (is_absent<V>)
        return V{};
    else
        return V::Constant(typename V::Scalar(std::numeric_limits<double>::quiet_NaN()));
}

} // namespace detail

namespace detail {

/// Throws an Error unless the camera, which something is seen from, is somewhere.
template <class T>
void require_camera(const Vec3<T>& camera, const char* who = "eye_optics") {
    using std::isfinite;
    require(isfinite(camera[0]) && isfinite(camera[1]) && isfinite(camera[2]), who,
            "got drivers without a camera, expected its centre in the world");
}

} // namespace detail

/// Drivers of a frame of an avatar with the effects E; a driver that no effect reads is absent.
template <class T, EffectSet E = PaperEffects>
struct Drivers {
    /// Blendshape coefficients.
    [[no_unique_address]] detail::Slot<E, ReadsExpression, VecX<T>> expression;
    /// Axis-angle [rad], translation [world unit].
    [[no_unique_address]] detail::Slot<E, ReadsHeadPose, Vec<T, 6>> pose;
    /// S, world units per canonical unit.
    [[no_unique_address]] detail::Slot<E, HeadPose, T> scale =
        detail::initial_slot<detail::Slot<E, HeadPose, T>>(1);
    /// Tracked gazes, left and right, head frame: visual axes for an avatar with a kappa, else
    /// optical ones.
    [[no_unique_address]] detail::GazeSlot<E, Vec3<T>> gaze;
    /// Radii of the pupils over those at rest, left and right: least_pupil to most_pupil.
    [[no_unique_address]] detail::PupilSlot<E, T> pupil =
        detail::ones<detail::PupilSlot<E, T>>();
    /// The camera's centre, world.
    [[no_unique_address]] detail::Slot<E, ReadsCamera, Vec3<T>> camera =
        detail::unset_point<detail::Slot<E, ReadsCamera, Vec3<T>>>();

    template <class U>
    Drivers<U, E> cast() const {
        Drivers<U, E> r;
        if constexpr (has_effect<E, ReadsExpression>)
            r.expression = expression.template cast<U>();
        if constexpr (has_effect<E, ReadsHeadPose>) r.pose = pose.template cast<U>();
        if constexpr (has_effect<E, HeadPose>) r.scale = U(scale);
        if constexpr (has_effect<E, ReadsCamera>) r.camera = camera.template cast<U>();
        for_eyes([&]<std::size_t eye>() {
            if constexpr (eye_turns<E, eye>)
                of_eye<eye>(r.gaze) = of_eye<eye>(gaze).template cast<U>();
            if constexpr (pupil_moves<E, eye>) of_eye<eye>(r.pupil) = U(of_eye<eye>(pupil));
        });
        return r;
    }
};

/// Returns the drivers with the camera's centre, if an effect reads it.
template <class T, EffectSet E, class Camera>
Drivers<T, E> seen_from(Drivers<T, E> drivers, [[maybe_unused]] const Camera& camera) {
    if constexpr (has_effect<E, ReadsCamera>)
        drivers.camera = camera.centre().template cast<T>();
    return drivers;
}

/// Drivers whose gazes are optical axes, which eyeballs turn to and networks and features read.
/// optical_drivers (avatar/eye_parameters.hpp) makes them of tracked ones by an avatar's kappa; the
/// constructor takes gazes as they are for optical axes.
template <class T, EffectSet E = PaperEffects>
struct OpticalDrivers {
    Drivers<T, E> drivers;

    explicit OpticalDrivers(Drivers<T, E> d) : drivers(std::move(d)) {}
};

/// A face at rest: no expression, no head pose, eyes ahead.
template <class T, EffectSet E = PaperEffects>
Drivers<T, E> neutral_drivers(const AvatarConfig& config) {
    Drivers<T, E> d;
    if constexpr (has_effect<E, ReadsExpression>) d.expression = VecX<T>::Zero(config.expression);
    if constexpr (has_effect<E, ReadsHeadPose>) d.pose.setZero();
    for_eyes([&]<std::size_t eye>() {
        if constexpr (eye_turns<E, eye>) of_eye<eye>(d.gaze) = Vec3<T>(T(0), T(0), T(1));
    });
    return d;
}

/// Effects whose networks read the head pose's code.
using ReadsPoseCode = AnyOf<PoseResidual, EyeOffset>;

/// The frame inputs of the networks.
template <class T, EffectSet E = PaperEffects>
struct FrameCode {
    [[no_unique_address]] detail::Slot<E, ReadsExpression, VecX<T>> expression; ///< raw
    [[no_unique_address]] detail::Slot<E, ReadsPoseCode, VecX<T>>
        pose; ///< encoded, 54 with 4 octaves
    [[no_unique_address]] detail::SkinSlot<E, VecX<T>>
        gaze; ///< encoded (pitch, yaw), 18 an eye with 4
};

/// Returns the codes of a frame.
template <class T, EffectSet E>
FrameCode<T, E> frame_code(const AvatarConfig& config, const OpticalDrivers<T, E>& optical) {
    const Drivers<T, E>& drivers = optical.drivers;
    FrameCode<T, E> code;
    if constexpr (has_effect<E, ReadsExpression>) code.expression = drivers.expression;
    if constexpr (has_effect<E, ReadsPoseCode>)
        code.pose = detail::EncodingOf<E>::encode(drivers.pose, config.pose_frequencies);
    for_eyes([&]<std::size_t eye>() {
        if constexpr (detail::skin_follows<E, eye>) {
            const Vec2<T> angles = pitch_yaw(of_eye<eye>(drivers.gaze));
            of_eye<eye>(code.gaze) = detail::EncodingOf<E>::encode(angles, config.gaze_frequencies);
        }
    });
    return code;
}

} // namespace rye
