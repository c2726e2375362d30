// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_stream.hpp: stage 2, the eyeball Gaussians. Their positions are the template's,
/// moved by one rigid transform an eye (eye offset, gaze, kappa, head pose) and never optimised
/// freely; colour, rotation, scale and opacity are.
/// Frame: points relative to the eyeball's centre in canonical units, iris toward +z.
/// Source: paper eq. (9)-(10); composition as in docs/deviations.md.
#pragma once

#include <rye/avatar/eye_points.hpp>
#include <rye/avatar/frame_cotangent.hpp>
#include <rye/avatar/head_pose.hpp>

namespace rye {

/// What the vjp needs of a frame's eyeballs.
template <class T, EffectSet E = PaperEffects>
struct EyeTrace {
    [[no_unique_address]] Slot<E, EyeOffset, EyeOffsetTrace<T>> offset;
    [[no_unique_address]] GazeSlot<E, Quat<T>> turn;  ///< rest (+z) to gaze, no torsion
    [[no_unique_address]] Slot<E, SeesCornea, OpticsTrace<T>> optics;
};

/// Where driven eyeballs go: P columns of a cloud from `begin` on.
template <class T, EffectSet E>
struct EyesInCloud {
    EyeTrace<T, E>& trace;
    Gaussians<T>& gaussians;
    Index begin;
};

/// Writes the eyeballs, in the world. The drivers' gazes are optical axes; `head` is the
/// HeadTransform of an avatar that has one.
template <class T, EffectSet E, Backend B, class... Head>
    requires (sizeof...(Head) == (has_effect<E, HeadPose> ? 1 : 0))
void eye_gaussians(const B& backend, const EyeStream<T, E>& eyes,
                   const std::type_identity_t<EyeFrame<T, E>>& frame,
                   const std::type_identity_t<EyesInCloud<T, E>>& to, const Head&... head) {
    const Drivers<T, E>& drivers = frame.drivers;
    [[maybe_unused]] EyeTrace<T, E>& trace = to.trace;
    Gaussians<T>& g = to.gaussians;
    const Index begin = to.begin;
    Columns<T> centre = eyes.centre;
    if constexpr (has_effect<E, EyeOffset>)
        centre += eye_offset<T>(backend, eyes.offset, frame.config, frame.code, trace.offset);
    const Index all = eyes.position.cols();
    eye_features(backend, eyes, frame, {true, true}, begin, g);
    set_eye_scales(eyes, g, begin, head.scale...);
    g.opacity.middleCols(begin, all) =
        eyes.opacity_logit.unaryExpr([](const T& v) { return sigmoid(v); });
    for_eyes([&]<std::size_t eye>() {
        constexpr Index e = static_cast<Index>(eye);
        const EyeTransform<T> placed =
            placed_eye<eye>(eyes, Vec3<T>(centre.col(e)), drivers, head...);
        if constexpr (eye_turns<E, eye>) {
            of_eye<eye>(trace.turn) = placed.quaternion;
            ((of_eye<eye>(trace.turn) =
                  quat_product<T>(quat_conjugate<T>(head.quaternion), placed.quaternion)),
             ...);
        }
        const Index first = eyes.first_point(e);
        if constexpr (has_effect<E, SeesCornea>) {
            const Index n = eyes.points_of(e);
            const Columns<T> points = eyes.position.middleCols(first, n);
            look_into_eye(backend, eyes.optics,
                          {eye, drivers.camera, placed, points, begin + first}, trace.optics,
                          g.feature);
            g.mean.middleCols(begin + first, n) = eye_points<T>(placed, trace.optics.seen[eye]);
            const Columns<T> rotations = eyes.rotation.middleCols(first, n);
            g.rotation.middleCols(begin + first, n) = eye_rotations<T>(placed, rotations);
        } else {
            place_eye(eyes, e, placed, begin + first, g);
        }
    });
}

/// Accumulates the gradients of appearance and gaze mechanism from the features' cotangent, C x P.
/// Returns the cotangents of the optical axes, which the frame's gazes are, and of the head pose,
/// as far as features depend on them.
template <class T, EffectSet E, Backend B>
EyeInputsCotangent<T> eye_features_vjp(const B& backend, const EyeStream<T, E>& eyes,
                                       const std::type_identity_t<EyeFrame<T, E>>& frame,
                                       const std::type_identity_t<ColumnsView<T>>& g,
                                       EyeStream<T, E>& grad) {
    using Appearance = EyeAppearanceOf<E>;
    const Drivers<T, E>& optical = frame.drivers;
    EyeInputsCotangent<T> g_inputs;
    with_eye_inputs(eyes, optical, frame.code, [&](const EyeInputs<T>& inputs) {
        if constexpr (GazeMechanismOf<E>::changes_features) {
            Columns<T> before(g.rows(), g.cols()), g_before = g;
            Appearance::features(backend, eyes.appearance(), inputs, ColumnsSpan<T>(before));
            for_eyes([&]<std::size_t eye>() {
                if constexpr (eye_turns<E, eye>) {
                    constexpr Index e = static_cast<Index>(eye);
                    const Index first = eyes.first_point(e), n = eyes.points_of(e);
                    g_inputs.gaze[eye] = GazeMechanismOf<E>::features_vjp(
                        eyes.mechanism(), eye, checked_gaze(of_eye<eye>(optical.gaze)),
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

/// Driven eyes, as far as their vjp reads them.
template <class T, EffectSet E>
struct DrivenEyes {
    EyeFrame<T, E> frame; ///< gazes as they came
    const EyeTrace<T, E>& trace;
    const Gaussians<T>& world; ///< the cloud that eye_gaussians wrote to
    Index begin;
};

/// Cotangents of the head-frame eyeballs, which to_world_vjp gives, and what eye_vjp adds to.
/// frame.gaze holds the cotangents of the gaze codes before, frame.optics what eye_optics_vjp gave.
template <class T, EffectSet E>
struct EyeGradients {
    const Gaussians<T>& gaussians;
    EyeStream<T, E>& eyes;
    FrameCotangent<T, E>& frame;
};

/// Accumulates parameter gradients.
template <class T, EffectSet E, Backend B, class... Head>
    requires (sizeof...(Head) == (has_effect<E, HeadPose> ? 1 : 0))
void eye_vjp(const B& backend, const EyeStream<T, E>& eyes,
             const std::type_identity_t<DrivenEyes<T, E>>& driven,
             const std::type_identity_t<EyeGradients<T, E>>& gradients, const Head&... head) {
    [[maybe_unused]] const AvatarConfig& config = driven.frame.config;
    const Drivers<T, E>& drivers = driven.frame.drivers;
    [[maybe_unused]] const EyeTrace<T, E>& trace = driven.trace;
    const Gaussians<T>&world = driven.world, &g = gradients.gaussians;
    const Index begin = driven.begin;
    EyeStream<T, E>& grad = gradients.eyes;
    [[maybe_unused]] FrameCotangent<T, E>& g_frame = gradients.frame;
    const Index all = eyes.position.cols();
    const auto of_eyes = [&](const Columns<T>& a) { return a.middleCols(begin, all); };
    const EyeInputsCotangent<T> g_inputs =
        eye_features_vjp(backend, eyes, {config, optical_drivers(eyes, drivers), driven.frame.code},
                         of_eyes(g.feature), grad);
    if constexpr (eyes_read_pose<E>) g_frame.eye_pose += g_inputs.pose;
    if constexpr (has_effect<E, HeadPose>)
        grad.log_scale += of_eyes(g.scale).cwiseProduct(of_eyes(world.scale)) / (head.scale, ...);
    else
        grad.log_scale += of_eyes(g.scale).cwiseProduct(of_eyes(world.scale));
    grad.opacity_logit += of_eyes(g.opacity).cwiseProduct(
        of_eyes(world.opacity).unaryExpr([](const T& a) { return T(a * (T(1) - a)); }));
    for_eyes([&]<std::size_t eye>() {
        constexpr Index e = static_cast<Index>(eye);
        const Index first = eyes.first_point(e), end = first + eyes.points_of(e);
        for (Index i = first; i < end; ++i) {
            if constexpr (eye_turns<E, eye>)
                grad.rotation.col(i) +=
                    quat_product_vjp_right<T>(of_eye<eye>(trace.turn), g.rotation.col(begin + i));
            else
                grad.rotation.col(i) += g.rotation.col(begin + i);
        }
    });
    constexpr bool own_turn = !std::same_as<GazeMechanismOf<E>, ExplicitRotation>;
    if constexpr (has_effect<E, Kappa> || own_turn)
        for_eyes([&]<std::size_t eye>() {
            constexpr Index e = static_cast<Index>(eye);
            if constexpr (eye_turns<E, eye>) {
                if constexpr (!own_turn)
                    if (eyes.kappa.size() == 0) return; // no parameter turns the eye
                const Index first = eyes.first_point(e), n = eyes.points_of(e);
                const auto turned = [&](const Columns<T>& points) {
                    return turn_cotangent<T>(points, eyes.rotation.middleCols(first, n),
                                             g.mean.middleCols(begin + first, n),
                                             g.rotation.middleCols(begin + first, n));
                };
                TurnCotangent<T> g_turn;
                if constexpr (has_effect<E, SeesCornea>) {
                    g_turn = turned(trace.optics.seen[eye]);
                    g_turn.rotation += g_frame.optics.turn[eye];
                } else {
                    g_turn = turned(eyes.position.middleCols(first, n));
                }
                Vec3<T> g_optical = g_inputs.gaze[eye];
                if constexpr (own_turn) {
                    const Drivers<T, E>& optical = optical_drivers(eyes, drivers);
                    g_optical += GazeMechanismOf<E>::turn_vjp(
                        eyes.mechanism(), eye, checked_gaze(of_eye<eye>(optical.gaze)),
                        turn_cotangent_of(of_eye<eye>(trace.turn), g_turn.rotation,
                                          g_turn.quaternion),
                        grad.mechanism());
                }
                if constexpr (has_effect<E, Kappa>)
                    if (eyes.kappa.size() > 0)
                        grad.kappa.col(e) += kappa_vjp<EncodingOf<E>, T>(
                            config, of_eye<eye>(drivers.gaze), kappa_of(eyes.kappa, eye),
                            {own_turn ? TurnCotangent<T>{} : g_turn, g_optical,
                             gaze_code_cotangent<eye>(g_frame)});
            }
        });
    if constexpr (has_effect<E, EyeOffset>) {
        Columns<T> g_offset = Columns<T>::Zero(3, 2);
        for (Index e = 0; e < 2; ++e) {
            const Index first = eyes.first_point(e), end = first + eyes.points_of(e);
            for (Index i = first; i < end; ++i) g_offset.col(e) += g.mean.col(begin + i);
        }
        if constexpr (has_effect<E, SeesCornea>) g_offset += g_frame.optics.centre;
        eye_offset_vjp<T>(backend, eyes.offset, {config, trace.offset}, g_offset,
                          {grad.offset, g_frame.pose});
    }
}

} // namespace rye
