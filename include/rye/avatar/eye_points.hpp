// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_points.hpp: the steps by which a frame drives eyeball Gaussians: their features,
/// sizes, places and turns, and back. Functions of a point run on the host (backend/each.hpp) and
/// on a device (backend/cuda/each.hpp). drive() takes all steps, interactive/drive_cache.hpp those
/// that a change calls for.
/// Frame: points relative to the eyeball's centre in canonical units, iris toward +z.
#pragma once

#include <rye/avatar/eye_pupils.hpp>
#include <rye/gaussian/attributes.hpp>
#include <rye/gaussian/gaussian_arrays.hpp>
#include <rye/rig/eye_transform.hpp>
#include <rye/rig/gaze_mechanisms.hpp>

namespace rye {

/// Inputs of a frame's eyes.
template <class T, EffectSet E>
struct EyeFrame {
    const AvatarConfig& config;
    const OpticalDrivers<T, E>& optical;
    const FrameCode<T, E>& code;
};

namespace detail {

/// Calls f(inputs) with the frame's inputs of the eyes' appearance, computed only if used.
template <class T, EffectSet E, class F>
void with_eye_inputs(const EyeStream<T, E>& eyes, const OpticalDrivers<T, E>& optical,
                     const FrameCode<T, E>& code, F&& f) {
    VecX<T> expression, pose;
    Columns<T> gaze;
    if constexpr (EyeAppearanceOf<E>::reads_inputs) {
        if constexpr (has_effect<E, ReadsExpression>) expression = code.expression;
        if constexpr (has_effect<E, ReadsHeadPose>) pose = optical.drivers.pose;
        gaze = Vec3<T>(T(0), T(0), T(1)).replicate(1, 2);
        for_eyes([&]<std::size_t eye>() {
            if constexpr (eye_turns<E, eye>)
                gaze.col(static_cast<Index>(eye)) = of_eye<eye>(optical.drivers.gaze);
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

/// True if a mechanism other than explicit rotation turns the eyes.
template <EffectSet E>
inline constexpr bool own_turn = !std::same_as<GazeMechanismOf<E>, ExplicitRotation>;
/// True if something trained follows from an eye's turn: kappa, or a mechanism's parameters.
template <EffectSet E, int eye>
inline constexpr bool turn_is_trained = eye_turns<E, std::size_t(eye)> &&
                                        (own_turn<E> ? !std::same_as<GazeMechanismOf<E>, FixedEye>
                                                     : has_effect<E, Kappa>);

/// Trained attributes of eyeball Gaussians.
template <class T>
struct EyeArrays {
    T* log_scale;     ///< 3 x P
    T* rotation;      ///< 4 x P
    T* opacity_logit; ///< 1 x P

    template <class U>
        requires(std::same_as<U, const T> && !std::is_const_v<T>)
    operator EyeArrays<U>() const { return {log_scale, rotation, opacity_logit}; }
    /// Returns those from a point on.
    EyeArrays from(Index first) const {
        return {log_scale + 3 * first, rotation + 4 * first, opacity_logit + first};
    }
};

} // namespace detail

/// Returns the views of the eyes' arrays.
template <class T, EffectSet E>
detail::EyeArrays<const T> arrays_of(const EyeStream<T, E>& eyes) {
    return {eyes.log_scale.data(), eyes.rotation.data(), eyes.opacity_logit.data()};
}
/// The same, to be written.
template <class T, EffectSet E>
detail::EyeArrays<T> arrays_of(EyeStream<T, E>& eyes) {
    return {eyes.log_scale.data(), eyes.rotation.data(), eyes.opacity_logit.data()};
}

namespace detail {

/// Returns where the transform of an avatar with a head pose lies; null for one without.
template <class T>
const HeadTransform<T>* head_address() {
    return nullptr;
}
/// The same, of an avatar with one.
template <class T>
const HeadTransform<T>* head_address(const HeadTransform<T>& head) {
    return &head;
}

/// Sets scale [world units] and opacity of Gaussian i of the eyes. `head`: the transform of an
/// avatar with a head pose.
template <class T, EffectSet E>
struct SizeEyePoint {
    static constexpr const char* name = "eyes, sizes";
    EyeArrays<const T> raw;
    GaussianArrays<T> to;
    const HeadTransform<T>* head;

    RYE_HD void operator()(Index i) const {
        for (Index k = 0; k < 3; ++k) {
            const T scale = drawn_scale(raw.log_scale[3 * i + k]);
            to.scale.data[3 * i + k] = has_effect<E, HeadPose> ? T(scale * head->scale) : scale;
        }
        to.opacity.data[i] = drawn_opacity(raw.opacity_logit[i]);
    }
};

/// Sets mean and rotation of Gaussian i of an eye, in the world. Arrays begin at its first point.
template <class T>
struct PlaceEyePoint {
    static constexpr const char* name = "eyes, places";
    EyeArrays<const T> raw;
    const T* position; ///< in the eyeball's frame, as its pupil moves them, 3 x P
    GaussianArrays<T> to;
    const EyeTransform<T>* eye;

    RYE_HD void operator()(Index i) const {
        put_column<3>(eye->apply(column3(position, i)), to.mean.data, i);
        put_column<4>(quat_product<T>(eye->quaternion, column4(raw.rotation, i)), to.rotation.data,
                      i);
    }
};

/// Sets all of Gaussian i but its feature.
template <class T, EffectSet E>
struct DriveEyePoint {
    static constexpr const char* name = "eyes";
    PlaceEyePoint<T> place;
    const HeadTransform<T>* head;

    RYE_HD void operator()(Index i) const {
        place(i);
        SizeEyePoint<T, E>{place.raw, place.to, head}(i);
    }
};

/// Places of what an eye's points are summed for: the head's transform, the eye's turn (a matrix
/// and a quaternion), its centre; as far as something trained follows.
template <EffectSet E, int eye>
struct EyeSums {
    static constexpr bool turn = turn_is_trained<E, eye>;
    static constexpr int head_at = 0;
    static constexpr int turn_at = has_effect<E, HeadPose> ? head_sums : 0;
    static constexpr int centre_at = turn_at + (turn ? turn_sums : 0);
    static constexpr int count = centre_at + (has_effect<E, EyeOffset> ? 3 : 0);
    static constexpr int room = 32; ///< numbers that an eye's sums are apart
};

/// Adds the gradients of point i of an eye, and sums; takes the cotangents of means to the head's
/// frame, in place. Arrays begin at that eye's first point.
template <class T, EffectSet E, int eye>
struct EyePointVjp {
    using Number = T;
    using Places = EyeSums<E, eye>;
    static constexpr const char* name = "eyes, reverse";
    static constexpr int sums = Places::count;
    EyeArrays<const T> raw;
    EyeArrays<T> gradient;
    const T* position;             ///< as seen, in the eyeball's frame, 3 x P
    GaussianArrays<const T> world; ///< driven
    GaussianArrays<T> g;           ///< cotangents
    const HeadTransform<T>* head;  ///< of an avatar with a head pose
    const Quat<T>* turn;           ///< rest (+z) to gaze, of an eye that turns

    template <class Sums>
    RYE_HD void operator()(Index i, [[maybe_unused]] Sums& sum) const {
        MovedPoint<T> own{column3(g.mean.data, i), column4(g.rotation.data, i)};
        if constexpr (has_effect<E, HeadPose>) {
            HeadTransformGradient<T> part;
            part.add(*head, {column3(world.mean.data, i), column4(world.rotation.data, i)}, own);
            add_head_sums(part, sum, Places::head_at);
            put_column<3>(own.mean, g.mean.data, i);
        }
        // Scales in the world are proportional to the head's, so it cancels here.
        for (Index k = 0; k < 3; ++k)
            gradient.log_scale[3 * i + k] +=
                drawn_scale_vjp<T>(world.scale.data[3 * i + k], g.scale.data[3 * i + k]);
        const T a = world.opacity.data[i];
        gradient.opacity_logit[i] += drawn_opacity_vjp<T>(a, T(1) - a, g.opacity.data[i]);
        if constexpr (eye_turns<E, std::size_t(eye)>)
            add_column<4>(quat_product_vjp_right<T>(*turn, own.rotation), gradient.rotation, i);
        else
            add_column<4>(own.rotation, gradient.rotation, i);
        if constexpr (Places::turn) {
            TurnCotangent<T> part;
            part.add({column3(position, i), column4(raw.rotation, i)}, own);
            add_turn_sums(part, sum, Places::turn_at);
        }
        if constexpr (has_effect<E, EyeOffset>)
            for (int k = 0; k < 3; ++k) sum[std::size_t(Places::centre_at + k)] += own.mean[k];
    }
};

/// An eyeball (0: the subject's left) with its centre there [unit], turned to its gaze, an optical
/// axis, if it turns, and carried by the head, the HeadTransform of an avatar that has one.
template <std::size_t eye, class T, EffectSet E, class... Head>
EyeTransform<T> placed_eye(const EyeStream<T, E>& eyes, const Vec3<T>& centre,
                           [[maybe_unused]] const OpticalDrivers<T, E>& optical,
                           const Head&... head) {
    EyeTransform<T> placed = eye_at<T>(centre);
    if constexpr (eye_turns<E, eye>)
        turn_eye_by(eyes, eye, of_eye<eye>(optical.drivers.gaze), placed);
    (carry_eye<T>(placed, {{head.rotation, head.translation}, head.scale}), ...);
    return placed;
}

/// True if the part that makes the eyes' features can write one eye's alone.
template <EffectSet E>
inline constexpr bool eyes_apart = EyeByEye<EyeAppearanceOf<E>>;

} // namespace detail

/// Writes the features of some eyes, in the columns of `g` from `begin` on; of both unless
/// eyes_apart.
template <class T, EffectSet E, Backend B>
void eye_features(const B& backend, const EyeStream<T, E>& eyes,
                  const std::type_identity_t<EyeFrame<T, E>>& frame,
                  const std::array<bool, 2>& which, Index begin, Gaussians<T>& g) {
    using Appearance = EyeAppearanceOf<E>;
    using Mechanism = GazeMechanismOf<E>;
    detail::with_eye_inputs(eyes, frame.optical, frame.code, [&](const EyeInputs<T>& inputs) {
        ColumnsSpan<T> feature(g.feature.middleCols(begin, eyes.position.cols()));
        if (which[0] && which[1]) {
            Appearance::features(backend, eyes.appearance(), inputs, feature);
        } else if constexpr (detail::eyes_apart<E>) {
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
                        eyes.mechanism(), eye,
                        detail::checked_gaze(of_eye<eye>(frame.optical.drivers.gaze)),
                        ColumnsSpan<T>(
                            g.feature.middleCols(begin + eyes.first_point(e), eyes.points_of(e))));
        });
}

} // namespace rye
