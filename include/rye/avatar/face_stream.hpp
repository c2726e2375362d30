// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/face_stream.hpp: stage 2, the facial Gaussians: canonical attributes plus what the
/// drivers add to them, in the head frame. Positions in canonical units, +z out of the face.
/// Source: paper eq. (2)-(6); activations and scales as in GHA's generate().
#pragma once

#include <rye/avatar/activation.hpp>
#include <rye/avatar/face_networks.hpp>
#include <rye/avatar/field.hpp>
#include <rye/avatar/frame_cotangent.hpp>
#include <rye/avatar/weights.hpp>
#include <rye/gaussian/gaussians.hpp>

namespace rye {

/// Trained parameters of the face: N Gaussians at rest in the head frame, and the networks that
/// drive them.
template <class T, EffectSet E = PaperEffects>
struct FaceStream : detail::AttributeFields<detail::NetworkOf<T, E>, E> {
    Columns<T> position;       ///< X_0, 3 x N
    [[no_unique_address]] detail::Slot<E, FaceDrivers, Columns<T>>
        feature;               ///< F_0 before tanh, F x N
    Columns<T> log_scale;      ///< 3 x N
    Columns<T> rotation;       ///< 4 x N, w x y z, any norm
    Columns<T> opacity_logit;  ///< 1 x N
    [[no_unique_address]] FaceNetworks<T, E> networks;

    /// The colour from effects that were left out, C x N, if there were any (avatar/hold.hpp).
    [[no_unique_address]] detail::RestSlot<E, Columns<T>> rest_color;

    /// Fixed neutral landmarks, 3 x L.
    [[no_unique_address]] detail::Slot<E, FaceDrivers, Columns<T>, 1> landmarks;
    /// Positions at which the networks see the Gaussians, 3 x N, if effects that were left out
    /// moved `position` away from there; else empty.
    [[no_unique_address]] detail::RestSlot<E, Columns<T>, 1> anchor;

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        f("xyz", p.position...);
        if constexpr (has_effect<E, FaceDrivers>) f("feature", p.feature...);
        f("scales", p.log_scale...);
        f("rotation", p.rotation...);
        f("opacity", p.opacity_logit...);
        FaceNetworks<T, E>::fields(f, p.networks...);
        if constexpr (has_effect<E, Expression>)
            detail::nested_fields<detail::NetworkOf<T, E>>("exp_attributes_mlp", f,
                                                           p.exp_attributes...);
        if constexpr (has_effect<E, PoseResidual>)
            detail::nested_fields<detail::NetworkOf<T, E>>("pose_attributes_mlp", f,
                                                           p.pose_attributes...);
        if constexpr (face_rests<E>) f("rest_color", p.rest_color...);
    }
    template <class F, class... P>
    static void buffers(F&& f, P&&... p) {
        if constexpr (has_effect<E, FaceDrivers>) f("landmarks_3d_neutral", p.landmarks...);
        if constexpr (face_rests<E>) f("anchor", p.anchor...);
    }
    /// X_0 as the networks see it.
    const Columns<T>& seen() const {
        if constexpr (face_rests<E>)
            if (anchor.size() > 0) return anchor;
        return position;
    }
};

/// Intermediate results of one frame that the vjp reads.
template <class T, EffectSet E = PaperEffects>
struct FaceTrace : detail::FaceFields<FieldTrace<T>, E>, detail::AttributeFields<FieldTrace<T>, E> {
    /// Positional encoding of X_0, and tanh(F_0).
    [[no_unique_address]] detail::Slot<E, FaceDrivers, Columns<T>> code;
    [[no_unique_address]] detail::Slot<E, FaceDrivers, Columns<T>, 1> feature;
    [[no_unique_address]] Weights<T, E> weights;
    [[no_unique_address]] WeightsTrace<T, E> nearest;
    /// Summed attribute steps, 8 x N: log-scale, quaternion, logit opacity.
    [[no_unique_address]] detail::Slot<E, ReadsFaceRamp, Columns<T>, 3> attributes;
    /// Scales in the head frame, 3 x N; without a head pose those of the cloud.
    [[no_unique_address]] detail::Slot<E, HeadPose, Columns<T>> scale;
};

namespace detail {

/// The attributes of the face at rest, as stored.
template <class T, EffectSet E>
RawAttributes<T> raw_attributes(const FaceStream<T, E>& face) {
    return {face.log_scale, face.rotation, face.opacity_logit};
}

/// Scales of the driven face in the head frame: in the trace, or without a head pose in the cloud.
template <class T, EffectSet E, class Trace, class Cloud>
auto& head_scale(Trace& trace, Cloud& g) {
    if constexpr (has_effect<E, HeadPose>)
        return trace.scale;
    else
        return g.scale;
}

/// Inputs of a frame's face.
template <class T, EffectSet E>
struct FaceFrame {
    const AvatarConfig& config;
    const LandmarkRoles& roles;
    const FrameCode<T, E>& code;
};

} // namespace detail

/// Writes the driven face, in the head frame, into the first N columns of `g`; its scales go to
/// head_scale(trace, g).
template <class T, EffectSet E, Backend B>
void face_gaussians(const B& backend, const FaceStream<T, E>& face,
                    const std::type_identity_t<detail::FaceFrame<T, E>>& frame,
                    FaceTrace<T, E>& trace, Gaussians<T>& g) {
    const AvatarConfig& config = frame.config;
    [[maybe_unused]] const FrameCode<T, E>& code = frame.code;
    const Index n = face.position.cols();
    [[maybe_unused]] const T one = T(1), reach = T(config.deform_scale),
                             step = T(config.attribute_scale);
    const FaceNetworks<T, E>& nets = face.networks;
    const Weights<T, E>& w = trace.weights;
    if constexpr (has_effect<E, FaceDrivers>) {
        encode_points<detail::EncodingOf<E>>(backend, face.seen(), config.frequencies, trace.code);
        detail::tanh_into(backend, face.feature, trace.feature);
        trace.weights = face_weights<T>(backend, {config, face.seen(), face.landmarks}, frame.roles,
                                        trace.nearest);
    }

    if constexpr (has_effect<E, ReadsFaceRamp>) trace.attributes.resize(8, n);
    for_chunks(backend.threads, n, 512, [&](Index b, Index e, Index) {
        const Index k = e - b;
        if constexpr (face_rests<E>)
            g.feature.middleCols(b, k) = face.rest_color.middleCols(b, k);
        else
            g.feature.middleCols(b, k).setZero();
        g.mean.middleCols(b, k) = face.position.middleCols(b, k);
        if constexpr (has_effect<E, ReadsFaceRamp>) trace.attributes.middleCols(b, k).setZero();
    });
    for_face_fields<E>([&](auto by) {
        add_field(backend, Field{by.color(nets), Squash::none, one},
                  {trace.feature, by.influence(w), by.code(code)}, g.feature, by.color(trace));
    });
    for_face_fields<E>([&](auto by) {
        add_field(backend, Field{by.deform(nets), Squash::tanh, reach},
                  {trace.code, by.influence(w), by.code(code)}, g.mean, by.deform(trace));
    });
    for_attribute_fields<E>([&](auto by) {
        add_field(backend, Field{by.attribute(face), Squash::none, step},
                  {trace.feature, by.influence(w), by.code(code)}, trace.attributes,
                  by.attribute(trace));
    });

    if constexpr (has_effect<E, HeadPose>) trace.scale.resize(3, n);
    const detail::DrawnAttributes<T> drawn{detail::head_scale<T, E>(trace, g), g.rotation,
                                           g.opacity};
    if constexpr (has_effect<E, ReadsFaceRamp>)
        detail::activate_into(backend, detail::raw_attributes(face), drawn, trace.attributes);
    else
        detail::activate_into(backend, detail::raw_attributes(face), drawn);
}

namespace detail {

/// A driven face, as far as its vjp reads it: scales and opacities as face_gaussians wrote them.
template <class T, EffectSet E>
struct DrivenFace {
    const AvatarConfig& config;
    const FrameCode<T, E>& code;
    const FaceTrace<T, E>& trace;
    const Columns<T>& scale;
    const Columns<T>& opacity;
};

/// Destinations of face_vjp.
template <class T, EffectSet E>
struct FaceGradients {
    FaceStream<T, E>& face;
    FrameCotangent<T, E>& frame;
};

} // namespace detail

/// Accumulates the gradients of parameters and codes from head-frame cotangents, the first N
/// columns of `g`.
template <class T, EffectSet E, Backend B>
void face_vjp(const B& backend, const FaceStream<T, E>& face,
              const std::type_identity_t<detail::DrivenFace<T, E>>& driven, const Gaussians<T>& g,
              const std::type_identity_t<detail::FaceGradients<T, E>>& gradients) {
    [[maybe_unused]] const AvatarConfig& config = driven.config;
    [[maybe_unused]] const FrameCode<T, E>& code = driven.code;
    [[maybe_unused]] const FaceTrace<T, E>& trace = driven.trace;
    FaceStream<T, E>& grad = gradients.face;
    [[maybe_unused]] detail::FrameCotangent<T, E>& g_frame = gradients.frame;
    const Index n = face.position.cols();
    const Columns<T> g_attributes = activate_vjp(backend, driven.scale, driven.opacity, n, g);
    for_chunks(backend.threads, n, 512, [&](Index b, Index e, Index) {
        const Index k = e - b;
        grad.log_scale.middleCols(b, k) += g_attributes.template middleRows<3>(0).middleCols(b, k);
        grad.rotation.middleCols(b, k) += g_attributes.template middleRows<4>(3).middleCols(b, k);
        grad.opacity_logit.middleCols(b, k) += g_attributes.bottomRows(1).middleCols(b, k);
        grad.position.middleCols(b, k) += g.mean.middleCols(b, k);
    });
    if constexpr (face_rests<E>) grad.rest_color += g.feature.leftCols(n);
    if constexpr (has_effect<E, FaceDrivers>) {
        const FaceNetworks<T, E>& nets = face.networks;
        FaceNetworks<T, E>& gnets = grad.networks;
        Columns<T> g_feature(face.feature.rows(), n), g_code(trace.code.rows(), n);
        for_chunks(backend.threads, n, 256, [&](Index b, Index e, Index) {
            g_feature.middleCols(b, e - b).setZero();
            g_code.middleCols(b, e - b).setZero();
        });
        Weights<T, E> g_w(n);
        const Weights<T, E>& w = trace.weights;
        const T one = T(1), reach = T(config.deform_scale), step = T(config.attribute_scale);
        for_face_fields<E>([&](auto by) {
            field_vjp(backend, Field{by.color(nets), Squash::none, one},
                      {by.influence(w), by.code(code), by.color(trace)}, g.feature,
                      {&by.color(gnets), &g_feature, &by.influence(g_w), g_frame.of(by)});
        });
        for_face_fields<E>([&](auto by) {
            field_vjp(backend, Field{by.deform(nets), Squash::tanh, reach},
                      {by.influence(w), by.code(code), by.deform(trace)}, g.mean,
                      {&by.deform(gnets), &g_code, &by.influence(g_w), g_frame.of(by)});
        });
        for_attribute_fields<E>([&](auto by) {
            field_vjp(backend, Field{by.attribute(face), Squash::none, step},
                      {by.influence(w), by.code(code), by.attribute(trace)}, g_attributes,
                      {&by.attribute(grad), &g_feature, &by.influence(g_w), g_frame.of(by)});
        });
        if (&face.seen() == &face.position) {  // an anchor is fixed
            encode_points_vjp<detail::EncodingOf<E>>(backend, trace.code, g_code,
                                                     config.frequencies, grad.position);
            face_weights_vjp<T>(backend, {config, face.position, face.landmarks}, trace.nearest,
                                g_w, {grad.position, nullptr});
        }
        for_chunks(backend.threads, g_feature.size(), 8192, [&](Index b, Index e, Index) {
            T* const to = grad.feature.data() + b;
            detail::transform_array<B>(
                e - b, to,
                [](const auto& sum, const auto& gv, const auto& v) {
                    using V = std::remove_cvref_t<decltype(v)>;
                    return sum + gv * ((V(1) - v) * (V(1) + v));
                },
                to, g_feature.data() + b, trace.feature.data() + b);
        });
    }
}

} // namespace rye
