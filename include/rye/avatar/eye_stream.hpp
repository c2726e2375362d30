// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_stream.hpp: stage 2, the eyeball Gaussians. Their positions are the template's,
/// moved by one rigid transform an eye (eye offset, gaze, kappa, head pose) and never optimised
/// freely; colour, rotation, scale and opacity are.
/// Frame: points relative to the eyeball's centre in canonical units, iris toward +z.
/// Source: paper eq. (9)-(10); composition as in docs/deviations.md.
#pragma once

#include <rye/avatar/eye_kappa.hpp>
#include <rye/avatar/eye_offset.hpp>
#include <rye/avatar/eye_optics.hpp>
#include <rye/avatar/frame_cotangent.hpp>
#include <rye/avatar/head_pose.hpp>
#include <rye/core/fields.hpp>
#include <rye/gaussian/gaussians.hpp>
#include <rye/rig/eye_transform.hpp>

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
    [[no_unique_address]] Slot<E, EyeOffset, EyeOffsetNetwork<T, NetworksOf<E>>> offset;
    [[no_unique_address]] Slot<E, Kappa, Columns<T>> kappa;  ///< (pitch, yaw) [rad] an eye, 2 x 2
    [[no_unique_address]] EyeOptics<T, E> optics;

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
            EyeOffsetNetwork<T, NetworksOf<E>>::fields(f, p.offset...);
        if constexpr (has_effect<E, Kappa>) f("kappa", p.kappa...);
        EyeOptics<T, E>::fields(f, p.optics...);
    }
    template <class F, class... P>
    static void buffers(F&& f, P&&... p) {
        f("xyz", p.position...);
        f("centre", p.centre...);
        f("spacing", p.spacing...);
        EyeOptics<T, E>::buffers(f, p.optics...);
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

/// The drivers with the optical axes in the place of the gazes: the same ones without Kappa.
template <class T, EffectSet E>
decltype(auto) optical_drivers(const EyeStream<T, E>& eyes, const Drivers<T, E>& drivers) {
    if constexpr (has_effect<E, Kappa>) {
        Drivers<T, E> d = drivers;
        for_eyes([&]<std::size_t eye>() {
            if constexpr (eye_turns<E, eye>)
                of_eye<eye>(d.gaze) = apply_kappa<T>(of_eye<eye>(drivers.gaze),
                                                     kappa_of(eyes.kappa, eye));
        });
        return d;
    } else {
        return (drivers);
    }
}

/// What the vjp needs of a frame's eyeballs.
template <class T, EffectSet E = PaperEffects>
struct EyeTrace {
    [[no_unique_address]] Slot<E, EyeOffset, EyeOffsetTrace<T>> offset;
    [[no_unique_address]] GazeSlot<E, Quat<T>> turn;  ///< rest (+z) to gaze, no torsion
    [[no_unique_address]] Slot<E, SeesCornea, OpticsTrace<T>> optics;
};

/// What a frame's eyes are driven by.
template <class T, EffectSet E>
struct EyeFrame {
    const AvatarConfig& config;
    const Drivers<T, E>& drivers;
    const FrameCode<T, E>& code;
};

/// f with what the eyes' appearance may read of a frame; prepared only where it is read.
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
    with_eye_inputs(eyes, drivers, frame.code, [&](const EyeInputs<T>& inputs) {
        EyeAppearanceOf<E>::features(backend, eyes.appearance(), inputs,
                                     ColumnsSpan<T>(g.feature.middleCols(begin, all)));
    });
    set_eye_scales(eyes, g, begin, head.scale...);
    g.opacity.middleCols(begin, all) =
        eyes.opacity_logit.unaryExpr([](const T& v) { return sigmoid(v); });
    for_eyes([&]<std::size_t eye>() {
        constexpr Index e = static_cast<Index>(eye);
        EyeTransform<T> placed = eye_at<T>(centre.col(e));
        if constexpr (eye_turns<E, eye>) {
            turn_eye_by(eyes, eye, of_eye<eye>(drivers.gaze), placed);
            if constexpr (GazeMechanismOf<E>::changes_features)
                GazeMechanismOf<E>::features(
                    eyes.mechanism(), eye, checked_gaze(of_eye<eye>(drivers.gaze)),
                    ColumnsSpan<T>(
                        g.feature.middleCols(begin + eyes.first_point(e), eyes.points_of(e))));
        }
        (carry_eye<T>(placed, {{head.rotation, head.translation}, head.scale}), ...);
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
