// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_points.hpp: the steps by which a frame drives eyeball Gaussians: their features,
/// sizes, places and turns. drive() takes all of them, interactive/drive_cache.hpp those that a
/// change calls for.
/// Frame: points relative to the eyeball's centre in canonical units, iris toward +z.
#pragma once

#include <rye/avatar/eye_parameters.hpp>
#include <rye/gaussian/gaussians.hpp>
#include <rye/rig/eye_transform.hpp>

namespace rye {

/// What a frame's eyes are driven by.
template <class T, EffectSet E>
struct EyeFrame {
    const AvatarConfig& config;
    const Drivers<T, E>& drivers;
    const FrameCode<T, E>& code;
};

/// Calls f(inputs) with the frame's inputs of the eyes' appearance, computed only if used.
template <class T, EffectSet E, class F>
void with_eye_inputs(const EyeStream<T, E>& eyes, const Drivers<T, E>& optical,
                     const FrameCode<T, E>& code, F&& f) {
    VecX<T> expression, pose;
    Columns<T> gaze;
    if constexpr (EyeAppearanceOf<E>::reads_inputs) {
        if constexpr (has_effect<E, ReadsExpression>) expression = code.expression;
        if constexpr (has_effect<E, ReadsHeadPose>) pose = optical.pose;
        gaze = Vec3<T>(T(0), T(0), T(1)).replicate(1, 2);
        for_eyes([&]<std::size_t eye>() {
            if constexpr (eye_turns<E, eye>)
                gaze.col(static_cast<Index>(eye)) = of_eye<eye>(optical.gaze);
        });
    }
    f(EyeInputs<T>{eyes.position, eyes.points_of(0), expression, gaze, pose});
}

/// Turns an eye to its gaze by the mechanism. Throws if the gaze is not finite or has no direction.
template <class T, EffectSet E>
void turn_eye_by(const EyeStream<T, E>& eyes, std::size_t eye, const Vec3<T>& gaze,
                 EyeTransform<T>& placed) {
    if constexpr (std::same_as<GazeMechanismOf<E>, ExplicitRotation>) {
        turn_eye<T>(placed, gaze);
    } else {
        const Vec3<T> unit = checked_gaze(gaze);
        placed.quaternion = GazeMechanismOf<E>::turn(eyes.mechanism(), eye, unit);
        placed.rotation = quat_matrix(placed.quaternion);
        placed.beyond_range = beyond_gaze_range(unit);
    }
}

/// Sets the scales of both eyeballs' Gaussians in the world, whose units the head's scale gives, if
/// any, in the columns of `g` from `begin` on.
template <class T, EffectSet E, class... Scale>
void set_eye_scales(const EyeStream<T, E>& eyes, Gaussians<T>& g, Index begin,
                    const Scale&... head_scale) {
    const auto exponential = [](const T& v) {
        using std::exp;
        return T(exp(v));
    };
    g.scale.middleCols(begin, eyes.log_scale.cols()) =
        (eyes.log_scale.unaryExpr(exponential) * ... * head_scale);
}

/// Means and rotations of one eyeball's Gaussians, in the columns of `g` from `begin` on.
template <class T, EffectSet E>
void place_eye(const EyeStream<T, E>& eyes, Index eye, const EyeTransform<T>& placed, Index begin,
               Gaussians<T>& g) {
    const Index first = eyes.first_point(eye), n = eyes.points_of(eye);
    const Columns<T> points = eyes.position.middleCols(first, n);
    const Columns<T> rotations = eyes.rotation.middleCols(first, n);
    g.mean.middleCols(begin, n) = eye_points<T>(placed, points);
    g.rotation.middleCols(begin, n) = eye_rotations<T>(placed, rotations);
}

/// An eyeball (0: the subject's left) with its centre there [unit], turned to its gaze, an optical
/// axis, if it turns, and carried by the head, the HeadTransform of an avatar that has one.
template <std::size_t eye, class T, EffectSet E, class... Head>
EyeTransform<T> placed_eye(const EyeStream<T, E>& eyes, const Vec3<T>& centre,
                           [[maybe_unused]] const Drivers<T, E>& optical, const Head&... head) {
    EyeTransform<T> placed = eye_at<T>(centre);
    if constexpr (eye_turns<E, eye>) turn_eye_by(eyes, eye, of_eye<eye>(optical.gaze), placed);
    (carry_eye<T>(placed, {{head.rotation, head.translation}, head.scale}), ...);
    return placed;
}

/// Whether features of the eyes are made by a part that writes each eye's alone.
template <EffectSet E>
inline constexpr bool eyes_apart = EyeByEye<EyeAppearanceOf<E>>;

/// Writes the features of some eyes, in the columns of `g` from `begin` on; of both unless
/// eyes_apart.
template <class T, EffectSet E, Backend B>
void eye_features(const B& backend, const EyeStream<T, E>& eyes,
                  const std::type_identity_t<EyeFrame<T, E>>& frame,
                  const std::array<bool, 2>& which, Index begin, Gaussians<T>& g) {
    using Appearance = EyeAppearanceOf<E>;
    using Mechanism = GazeMechanismOf<E>;
    with_eye_inputs(eyes, frame.drivers, frame.code, [&](const EyeInputs<T>& inputs) {
        ColumnsSpan<T> feature(g.feature.middleCols(begin, eyes.position.cols()));
        if (which[0] && which[1]) {
            Appearance::features(backend, eyes.appearance(), inputs, feature);
        } else if constexpr (eyes_apart<E>) {
            for (std::size_t eye = 0; eye < 2; ++eye)
                if (which[eye])
                    Appearance::eye_features(backend, eyes.appearance(), inputs, eye, feature);
        }
    });
    if constexpr (Mechanism::changes_features)
        for_eyes([&]<std::size_t eye>() {
            constexpr Index e = static_cast<Index>(eye);
            if constexpr (eye_turns<E, eye>)
                if (which[eye])
                    Mechanism::features(
                        eyes.mechanism(), eye, checked_gaze(of_eye<eye>(frame.drivers.gaze)),
                        ColumnsSpan<T>(g.feature.middleCols(begin + eyes.first_point(e),
                                                            eyes.points_of(e))));
        });
}

} // namespace rye
