// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_stream.hpp: stage 2, the eyeball Gaussians. Their positions are the template's,
/// moved by one rigid transform an eye (eye offset, gaze, kappa, head pose) and never optimised
/// freely; colour, rotation, scale and opacity are.
/// Frame: points relative to the eyeball's centre in canonical units, iris toward +z.
/// Source: paper eq. (9)-(10); composition as in docs/deviations.md.
#pragma once

#include <tuple>

#include <rye/avatar/eye_lids.hpp>
#include <rye/avatar/head_pose.hpp>

namespace rye {

/// Intermediate results of a frame's eyeballs for their vjp.
template <class T, EffectSet E = PaperEffects>
struct EyeTrace {
    [[no_unique_address]] detail::Slot<E, EyeOffset, EyeOffsetTrace<T>> offset;
    [[no_unique_address]] detail::GazeSlot<E, Quat<T>> turn; ///< rest (+z) to gaze, no torsion
    [[no_unique_address]] detail::Slot<E, SeesCornea, detail::OpticsTrace<T, E>> optics;
    [[no_unique_address]] detail::Slot<E, Pupil, detail::FramePupils<T>> pupils;
    [[no_unique_address]] detail::Slot<E, LidShadow, detail::FrameLids<T>> lids;
};

namespace detail {

/// Destination of driven eyeballs: P columns of a cloud from `begin` on.
template <class T, EffectSet E>
struct EyesInCloud {
    EyeTrace<T, E>& trace;
    Gaussians<T>& gaussians;
    Index begin;
};

} // namespace detail

/// Writes the eyeballs, in the world. The drivers' gazes are optical axes; `head` is the
/// HeadTransform of an avatar that has one. The lids' points are in the trace (take_lid_points).
template <class T, EffectSet E, Backend B, class... Head>
    requires (sizeof...(Head) == (has_effect<E, HeadPose> ? 1 : 0))
void eye_gaussians(const B& backend, const EyeStream<T, E>& eyes,
                   const std::type_identity_t<EyeFrame<T, E>>& frame,
                   const std::type_identity_t<detail::EyesInCloud<T, E>>& to, const Head&... head) {
    [[maybe_unused]] EyeTrace<T, E>& trace = to.trace;
    Gaussians<T>& g = to.gaussians;
    const Index begin = to.begin;
    Columns<T> centre = eyes.centre;
    if constexpr (has_effect<E, EyeOffset>)
        centre += eye_offset<T>(backend, eyes.offset, frame.config, frame.code, trace.offset);
    eye_features(backend, eyes, frame, {true, true}, begin, g);
    detail::set_pupils(backend, eyes, frame.optical.drivers, trace.pupils);
    const T* const moved = detail::moved_points(eyes, trace.pupils).data();
    for_eyes([&]<std::size_t eye>() {
        constexpr Index e = static_cast<Index>(eye);
        const EyeTransform<T> placed =
            detail::placed_eye<eye>(eyes, Vec3<T>(centre.col(e)), frame.optical, head...);
        if constexpr (eye_turns<E, eye>) {
            of_eye<eye>(trace.turn) = placed.quaternion;
            ((of_eye<eye>(trace.turn) =
                  quat_product<T>(quat_conjugate<T>(head.quaternion), placed.quaternion)),
             ...);
        }
        const Index first = eyes.first_point(e), n = eyes.points_of(e);
        const T* points = moved + 3 * first;
        if constexpr (has_effect<E, SeesCornea>)
            points = detail::look_into_eye(backend, eyes.optics,
                                           {eye, frame.optical.drivers.camera, placed, points, n},
                                           trace.optics, g.feature.rows(),
                                           g.feature.data() + g.feature.rows() * (begin + first));
        detail::shade_eye<eye>(backend, eyes, Vec3<T>(centre.col(e)), frame.optical, moved,
                               trace.lids, g, begin);
        for_each(backend, n,
                 detail::DriveEyePoint<T, E>{
                     {arrays_of(eyes).from(first), points,
                      detail::columns_from(arrays_of(g), {begin + first, n}), &placed},
                     detail::head_address<T>(head...)});
        detail::stretch_eye(backend, eyes, e, trace.pupils, g.scale.data() + 3 * (begin + first));
    });
}

namespace detail {

/// Accumulates the gradients of appearance and gaze mechanism from the features' cotangent, C x P.
/// Returns the cotangents of the optical axes, which the frame's gazes are, and of the head pose,
/// as far as features depend on them.
template <class T, EffectSet E, Backend B>
EyeInputsCotangent<T> eye_features_vjp(const B& backend, const EyeStream<T, E>& eyes,
                                       const std::type_identity_t<EyeFrame<T, E>>& frame,
                                       const std::type_identity_t<ColumnsView<T>>& g,
                                       EyeStream<T, E>& grad) {
    using Appearance = EyeAppearanceOf<E>;
    EyeInputsCotangent<T> g_inputs;
    with_eye_inputs(eyes, frame.optical, frame.code, [&](const EyeInputs<T>& inputs) {
        if constexpr (GazeMechanismOf<E>::changes_features) {
            Columns<T> before(g.rows(), g.cols()), g_before = g;
            Appearance::features(backend, eyes.appearance(), inputs, ColumnsSpan<T>(before));
            for_eyes([&]<std::size_t eye>() {
                if constexpr (eye_turns<E, eye>) {
                    constexpr Index e = static_cast<Index>(eye);
                    const Index first = eyes.first_point(e), n = eyes.points_of(e);
                    g_inputs.gaze[eye] = GazeMechanismOf<E>::features_vjp(
                        eyes.mechanism(), eye,
                        checked_gaze(of_eye<eye>(frame.optical.drivers.gaze)),
                        ColumnsView<T>(before.middleCols(first, n)),
                        ColumnsSpan<T>(g_before.middleCols(first, n)), grad.mechanism());
                }
            });
            const EyeInputsCotangent<T> more = eye_appearance_vjp<Appearance>(
                backend, eyes.appearance(), inputs, ColumnsView<T>(g_before), grad.appearance());
            for (std::size_t eye = 0; eye < 2; ++eye) g_inputs.gaze[eye] += more.gaze[eye];
            g_inputs.pose = more.pose;
        } else {
            g_inputs = eye_appearance_vjp<Appearance>(backend, eyes.appearance(), inputs, g,
                                                      grad.appearance());
        }
    });
    return g_inputs;
}

/// Cotangents of a cloud in the world, whose eyes' columns eye_points_vjp consumes, and the
/// gradients that it adds to.
template <class T, EffectSet E>
struct PointGradients {
    Gaussians<T>& gaussians;
    EyeStream<T, E>& eyes;
};

} // namespace detail

/// Driven eyes, as far as their vjp reads them.
template <class T, EffectSet E>
struct DrivenEyes {
    const AvatarConfig& config;
    const Drivers<T, E>& drivers; ///< tracked
    const FrameCode<T, E>& code;
    const EyeTrace<T, E>& trace;
    const Gaussians<T>& world; ///< the cloud that eye_gaussians wrote to
    Index begin;
};

namespace detail {

/// Sums over each eye's points: EyeSums.
template <class T, EffectSet E>
using SumsOfEyes = std::tuple<SumsOf<EyePointVjp<T, E, 0>>, SumsOf<EyePointVjp<T, E, 1>>>;

} // namespace detail

/// Accumulates the gradients of sizes, rotations and opacities from the cotangents of the eyes'
/// columns of `g` in the world; takes those of means to the head's frame, in place. Returns the
/// points' sums.
template <class T, EffectSet E, Backend B, class... Head>
    requires (sizeof...(Head) == (has_effect<E, HeadPose> ? 1 : 0))
detail::SumsOfEyes<T, E> eye_points_vjp(
    const B& backend, const EyeStream<T, E>& eyes,
    const std::type_identity_t<DrivenEyes<T, E>>& driven,
    const std::type_identity_t<detail::PointGradients<T, E>>& to, const Head&... head) {
    detail::SumsOfEyes<T, E> sums;
    for_eyes([&]<std::size_t eye>() {
        constexpr Index e = static_cast<Index>(eye);
        const Index first = eyes.first_point(e), n = eyes.points_of(e);
        const detail::ColumnRange columns{driven.begin + first, n};
        const T* points = detail::moved_points(eyes, driven.trace.pupils).data() + 3 * first;
        if constexpr (has_effect<E, SeesCornea>)
            points = driven.trace.optics.seen_points(eyes.optics, eye, points);
        const Quat<T>* turn = nullptr;
        if constexpr (eye_turns<E, eye>) turn = &of_eye<eye>(driven.trace.turn);
        std::get<eye>(sums) =
            detail::sum_each(backend, n,
                             detail::EyePointVjp<T, E, int(eye)>{
                                 arrays_of(eyes).from(first), arrays_of(to.eyes).from(first),
                                 points, detail::columns_from(arrays_of(driven.world), columns),
                                 detail::columns_from(arrays_of(to.gaussians), columns),
                                 detail::head_address<T>(head...), turn});
    });
    return sums;
}

namespace detail {

/// Cotangents of the eyeballs, whose means are in the head's frame, and what eye_vjp adds to.
/// frame.gaze holds the cotangents of the gaze codes before, frame.optics and frame.lids what the
/// vjps of highlights and of shadows gave.
template <class T, EffectSet E>
struct EyeGradients {
    const Gaussians<T>& gaussians;
    const SumsOfEyes<T, E>& sums; ///< of eye_points_vjp
    EyeStream<T, E>& eyes;
    FrameCotangent<T, E>& frame;
};

} // namespace detail

/// Accumulates the gradients of what is common to an eye's points: appearance, mechanism, kappa and
/// offset.
template <class T, EffectSet E, Backend B>
void eye_vjp(const B& backend, const EyeStream<T, E>& eyes,
             const std::type_identity_t<DrivenEyes<T, E>>& driven,
             const std::type_identity_t<detail::EyeGradients<T, E>>& gradients) {
    [[maybe_unused]] const AvatarConfig& config = driven.config;
    const OpticalDrivers<T, E> optical = optical_drivers(eyes, driven.drivers);
    [[maybe_unused]] const EyeTrace<T, E>& trace = driven.trace;
    EyeStream<T, E>& grad = gradients.eyes;
    [[maybe_unused]] detail::FrameCotangent<T, E>& g_frame = gradients.frame;
    const detail::EyeInputsCotangent<T> g_inputs = detail::eye_features_vjp(
        backend, eyes, {config, optical, driven.code},
        gradients.gaussians.feature.middleCols(driven.begin, eyes.position.cols()), grad);
    if constexpr (detail::eyes_read_pose<E>) g_frame.eye_pose += g_inputs.pose;
    for_eyes([&]<std::size_t eye>() {
        using Sums = detail::EyeSums<E, int(eye)>;
        if constexpr (eye_turns<E, eye> && (has_effect<E, Kappa> || detail::own_turn<E>)) {
            detail::TurnCotangent<T> g_turn;
            if constexpr (Sums::turn)
                detail::take_turn_sums(std::get<eye>(gradients.sums).begin() + Sums::turn_at,
                                       g_turn);
            if constexpr (has_effect<E, SeesCornea>) g_turn.rotation += g_frame.optics.turn[eye];
            if constexpr (has_effect<E, LidShadow>)
                if (eyes.has_lid_shadow()) g_turn.rotation += g_frame.lids.turn[eye];
            Vec3<T> g_optical = g_inputs.gaze[eye];
            if constexpr (detail::own_turn<E>) {
                g_optical += GazeMechanismOf<E>::turn_vjp(
                    eyes.mechanism(), eye, detail::checked_gaze(of_eye<eye>(optical.drivers.gaze)),
                    detail::turn_cotangent_of(of_eye<eye>(trace.turn), g_turn.rotation,
                                              g_turn.quaternion),
                    grad.mechanism());
            }
            if constexpr (has_effect<E, Kappa>)
                if (eyes.kappa.size() > 0)
                    grad.kappa.col(static_cast<Index>(eye)) += kappa_vjp<detail::EncodingOf<E>, T>(
                        config, of_eye<eye>(driven.drivers.gaze), detail::kappa_of(eyes.kappa, eye),
                        {detail::own_turn<E> ? detail::TurnCotangent<T>{} : g_turn, g_optical,
                         detail::gaze_code_cotangent<eye>(g_frame)});
        }
    });
    if constexpr (has_effect<E, EyeOffset>) {
        Columns<T> g_offset(3, 2);
        for_eyes([&]<std::size_t eye>() {
            for (Index k = 0; k < 3; ++k)
                g_offset(k, static_cast<Index>(eye)) = std::get<eye>(
                    gradients.sums)[std::size_t(detail::EyeSums<E, int(eye)>::centre_at + k)];
        });
        if constexpr (has_effect<E, SeesCornea>) g_offset += g_frame.optics.centre;
        if constexpr (has_effect<E, LidShadow>)
            if (eyes.has_lid_shadow()) g_offset += g_frame.lids.centre;
        eye_offset_vjp<T>(backend, eyes.offset, {config, trace.offset}, g_offset,
                          {grad.offset, g_frame.pose});
    }
}

} // namespace rye
