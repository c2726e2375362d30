// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/face_stream.hpp: stage 2, the facial Gaussians: canonical attributes plus what the
/// drivers add to them, in the head frame. Positions in canonical units, +z out of the face.
/// Source: paper eq. (2)-(6); activations and scales as in GHA's generate().
#pragma once

#include <rye/avatar/face_networks.hpp>
#include <rye/avatar/field.hpp>
#include <rye/avatar/weights.hpp>
#include <rye/gaussian/gaussians.hpp>

namespace rye {

template <class T>
struct FaceStream {
    Columns<T> position;       ///< X_0, 3 x N
    Columns<T> feature;        ///< F_0 before tanh, F x N
    Columns<T> log_scale;      ///< 3 x N
    Columns<T> rotation;       ///< 4 x N, w x y z, any norm
    Columns<T> opacity_logit;  ///< 1 x N
    FaceNetworks<T> networks;
    Mlp<T> exp_attributes, pose_attributes;

    Columns<T> landmarks;  ///< fixed neutral landmarks, 3 x L

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        f("xyz", p.position...);
        f("feature", p.feature...);
        f("scales", p.log_scale...);
        f("rotation", p.rotation...);
        f("opacity", p.opacity_logit...);
        FaceNetworks<T>::fields(f, p.networks...);
        nested_fields<Mlp<T>>("exp_attributes_mlp", f, p.exp_attributes...);
        nested_fields<Mlp<T>>("pose_attributes_mlp", f, p.pose_attributes...);
    }
    template <class F, class... P>
    static void buffers(F&& f, P&&... p) {
        f("landmarks_3d_neutral", p.landmarks...);
    }
};

/// Intermediate results of one frame that the vjp reads.
template <class T>
struct FaceTrace {
    Columns<T> code;     ///< positional encoding of X_0
    Columns<T> feature;  ///< tanh(F_0)
    Weights<T> weights;
    WeightsTrace<T> nearest;
    FieldTrace<T> exp_color, pose_color, exp_deform, pose_deform, exp_attributes, pose_attributes;
    std::array<FieldTrace<T>, 2> gaze_color, gaze_deform;
    Columns<T> attributes;  ///< summed attribute steps, 8 x N: log-scale, quaternion, logit opacity
};

/// Scale, rotation and opacity of point i after its attribute steps.
template <class T>
void shape_point(const FaceStream<T>& face, const Columns<T>& attributes, Index i,
                 Gaussians<T>& g) {
    using std::exp;
    for (Index k = 0; k < 3; ++k) g.scale(k, i) = exp(face.log_scale(k, i) + attributes(k, i));
    for (Index k = 0; k < 4; ++k) g.rotation(k, i) = face.rotation(k, i) + attributes(3 + k, i);
    g.opacity(0, i) = sigmoid(face.opacity_logit(0, i) + attributes(7, i));
}

/// The driven face in the head frame (before head pose and scale).
template <Backend B, class T>
Gaussians<T> face_gaussians(const FaceStream<T>& face, const AvatarConfig& config,
                            const LandmarkRoles& roles, const FrameCode<T>& code,
                            FaceTrace<T>& trace) {
    using std::tanh;
    const Index n = face.position.cols();
    const FaceNetworks<T>& nets = face.networks;
    trace.code = positional_encoding(face.position, config.frequencies);
    trace.feature.resize(face.feature.rows(), n);
    for_chunks<typename B::threads>(n, 1024, [&](Index b, Index e, Index) {
        trace.feature.middleCols(b, e - b) =
            face.feature.middleCols(b, e - b).unaryExpr([](const T& v) { return T(tanh(v)); });
    });
    trace.weights = face_weights<B, T>(config, face.position, face.landmarks, roles, trace.nearest);
    const Weights<T>& w = trace.weights;
    const T one = T(1);

    Gaussians<T> g;
    g.feature = Columns<T>::Zero(config.channels, n);
    add_field<B>(nets.exp_color, Squash::none, one, trace.feature, w.exp, code.expression,
                 g.feature, trace.exp_color);
    add_field<B>(nets.pose_color, Squash::none, one, trace.feature, w.pose, code.pose, g.feature,
                 trace.pose_color);
    const T reach = T(config.deform_scale);
    g.mean = face.position;
    add_field<B>(nets.exp_deform, Squash::tanh, reach, trace.code, w.exp, code.expression, g.mean,
                 trace.exp_deform);
    add_field<B>(nets.pose_deform, Squash::tanh, reach, trace.code, w.pose, code.pose, g.mean,
                 trace.pose_deform);
    for (std::size_t eye = 0; eye < 2; ++eye) {
        add_field<B>(nets.gaze_color[eye], Squash::none, one, trace.feature, w.gaze[eye],
                     code.gaze[eye], g.feature, trace.gaze_color[eye]);
        add_field<B>(nets.gaze_deform[eye], Squash::tanh, reach, trace.code, w.gaze[eye],
                     code.gaze[eye], g.mean, trace.gaze_deform[eye]);
    }
    trace.attributes = Columns<T>::Zero(8, n);
    const T step = T(config.attribute_scale);
    add_field<B>(face.exp_attributes, Squash::none, step, trace.feature, w.exp, code.expression,
                 trace.attributes, trace.exp_attributes);
    add_field<B>(face.pose_attributes, Squash::none, step, trace.feature, w.pose, code.pose,
                 trace.attributes, trace.pose_attributes);

    g.scale.resize(3, n);
    g.rotation.resize(4, n);
    g.opacity.resize(1, n);
    for_chunks<typename B::threads>(n, 1024, [&](Index b, Index e, Index) {
        for (Index i = b; i < e; ++i) shape_point(face, trace.attributes, i, g);
    });
    return g;
}

/// Accumulates parameter gradients from head-frame cotangents `g`; `driven` is what
/// face_gaussians returned. The cotangent of the pose code is added to g_pose_code.
template <Backend B, class T>
void face_vjp(const FaceStream<T>& face, const AvatarConfig& config, const FrameCode<T>& code,
              const FaceTrace<T>& trace, const Gaussians<T>& driven, const Gaussians<T>& g,
              FaceStream<T>& grad, VecX<T>& g_pose_code) {
    const Index n = face.position.cols();
    const FaceNetworks<T>& nets = face.networks;
    FaceNetworks<T>& gnets = grad.networks;
    Columns<T> g_attributes(8, n);
    for_chunks<typename B::threads>(n, 1024, [&](Index b, Index e, Index) {
        for (Index i = b; i < e; ++i) {
            for (Index k = 0; k < 3; ++k) g_attributes(k, i) = g.scale(k, i) * driven.scale(k, i);
            for (Index k = 0; k < 4; ++k) g_attributes(3 + k, i) = g.rotation(k, i);
            const T a = driven.opacity(0, i);
            g_attributes(7, i) = g.opacity(0, i) * a * (T(1) - a);
        }
    });
    grad.log_scale += g_attributes.topRows(3);
    grad.rotation += g_attributes.middleRows(3, 4);
    grad.opacity_logit += g_attributes.bottomRows(1);

    Columns<T> g_feature = Columns<T>::Zero(face.feature.rows(), n);
    Columns<T> g_code = Columns<T>::Zero(trace.code.rows(), n);
    Weights<T> g_w(n);
    const Weights<T>& w = trace.weights;
    const T one = T(1), reach = T(config.deform_scale), step = T(config.attribute_scale);
    field_vjp<B>(nets.exp_color, Squash::none, one, w.exp, code.expression, trace.exp_color,
                 g.feature, {&gnets.exp_color, &g_feature, &g_w.exp});
    field_vjp<B>(nets.pose_color, Squash::none, one, w.pose, code.pose, trace.pose_color, g.feature,
                 {&gnets.pose_color, &g_feature, &g_w.pose, &g_pose_code});
    field_vjp<B>(nets.exp_deform, Squash::tanh, reach, w.exp, code.expression, trace.exp_deform,
                 g.mean, {&gnets.exp_deform, &g_code, &g_w.exp});
    field_vjp<B>(nets.pose_deform, Squash::tanh, reach, w.pose, code.pose, trace.pose_deform,
                 g.mean, {&gnets.pose_deform, &g_code, &g_w.pose, &g_pose_code});
    for (std::size_t eye = 0; eye < 2; ++eye) {
        field_vjp<B>(nets.gaze_color[eye], Squash::none, one, w.gaze[eye], code.gaze[eye],
                     trace.gaze_color[eye], g.feature,
                     {&gnets.gaze_color[eye], &g_feature, &g_w.gaze[eye]});
        field_vjp<B>(nets.gaze_deform[eye], Squash::tanh, reach, w.gaze[eye], code.gaze[eye],
                     trace.gaze_deform[eye], g.mean,
                     {&gnets.gaze_deform[eye], &g_code, &g_w.gaze[eye]});
    }
    field_vjp<B>(face.exp_attributes, Squash::none, step, w.exp, code.expression,
                 trace.exp_attributes, g_attributes, {&grad.exp_attributes, &g_feature, &g_w.exp});
    field_vjp<B>(face.pose_attributes, Squash::none, step, w.pose, code.pose,
                 trace.pose_attributes, g_attributes,
                 {&grad.pose_attributes, &g_feature, &g_w.pose, &g_pose_code});

    grad.position += g.mean;
    grad.position += positional_encoding_vjp(trace.code, g_code, config.frequencies);
    face_weights_vjp<T>(config, face.position, face.landmarks, trace.nearest, g_w, grad.position,
                        nullptr);
    grad.feature += g_feature.cwiseProduct(trace.feature.unaryExpr([](const T& v) {
        return T((T(1) - v) * (T(1) + v));
    }));
}

} // namespace rye
