// SPDX-License-Identifier: Apache-2.0
/// rye/train/landmark_losses.hpp: the terms of stage 1 that need no surface and no picture: where
/// landmarks and eyeball centres go, and that landmarks lie on the surface.
/// Canonical units. Source: paper eq. (12), L_def, L_lmk and L_eye.
#pragma once

#include <rye/avatar/eye_stream.hpp>
#include <rye/avatar/guidance_mesh.hpp>
#include <rye/loss/mesh_terms.hpp>
#include <rye/train/samples.hpp>
#include <rye/train/settings.hpp>

namespace rye {

/// The terms of the first stage's objective, weighted.
template <class T>
struct MeshLosses {
    T rgb = T(0), silhouette = T(0), deform = T(0), offset = T(0), landmark = T(0);
    T laplacian = T(0), eye_offset = T(0);
    T total = T(0);      ///< weighted
    Index vertices = 0;  ///< of the surface; 0: no surface, image losses left out
};

/// The deformation of the neutral landmarks by expression (and by gaze where asked), for L_def.
template <class T, EffectSet E = PaperEffects>
struct LandmarkTrace {
    [[no_unique_address]] FrameCode<T, E> frame;
    GeometryTrace<T> geometry;  ///< at the landmarks: signed distance and offset
    Columns<T> shifted;         ///< after the lattice offset
    Columns<T> code;
    Columns<T> ones;            ///< influence 1 everywhere
    [[no_unique_address]] Weights<T, E> weights;
    [[no_unique_address]] WeightsTrace<T, E> nearest;
    [[no_unique_address]] Slot<E, Expression, FieldTrace<T>> exp;
    [[no_unique_address]] SkinSlot<E, FieldTrace<T>> gaze;
    Columns<T> deformed;
    [[no_unique_address]] Slot<E, EyeOffset, EyeOffsetTrace<T>> eye_offset;
    Columns<T> g_deformed, g_sdf;  ///< weighted cotangents
    [[no_unique_address]] Slot<E, EyeOffset, Columns<T>, 1> g_eye_offset;
};

/// What the landmarks of a stage are compared by. `landmarks_follow_gaze` deforms those of L_def by
/// the gaze fields too, weighted by lambda_gaze; GHA, which has none, deforms them by expression
/// alone.
struct LandmarkStage {
    const AvatarConfig& config;
    const LandmarkRoles& roles;
    bool landmarks_follow_gaze;
};
/// The same with the weights of the terms.
struct WeightedLandmarks : LandmarkStage {
    const MeshLossConfig& weights;
};

/// Sets deform, landmark and eye_offset of the losses.
template <class T, EffectSet E, Backend B>
MeshLosses<T> landmark_losses(const B& backend, const GuidanceMesh<T, E>& mesh,
                              const WeightedLandmarks& stage, const MeshSample<T, E>& sample,
                              LandmarkTrace<T, E>& m) {
    using std::tanh;
    const AvatarConfig& config = stage.config;
    const MeshLossConfig& weights = stage.weights;
    const FrameCode<T, E>& code = m.frame = frame_code(config, sample.drivers);
    MeshLosses<T> l;
    geometry_at(backend, mesh, config, mesh.landmarks, m.geometry);
    const T reach = T(config.vertex_offset), gain = T(config.deform_scale);
    m.shifted = mesh.landmarks + m.geometry.output.middleRows(1, 3).unaryExpr(
                                     [&](const T& o) { return T(reach * tanh(o)); });
    m.code = EncodingOf<E>::encode(m.shifted, config.frequencies);
    m.ones = Columns<T>::Ones(1, m.shifted.cols());
    m.deformed = m.shifted;
    if constexpr (has_effect<E, Expression>)
        add_field(backend, Field{mesh.networks.exp_deform, Squash::tanh, gain},
                  {m.code, m.ones, code.expression}, m.deformed, m.exp);
    if (stage.landmarks_follow_gaze && has_effect<E, Periocular>) {
        m.weights =
            face_weights<T>(backend, {config, m.shifted, mesh.landmarks}, stage.roles, m.nearest);
        for_eyes([&]<std::size_t eye>() {
            if constexpr (skin_follows<E, eye>)
                add_field(backend,
                          Field{of_eye<eye>(mesh.networks.gaze_deform), Squash::tanh, gain},
                          {m.code, of_eye<eye>(m.weights.gaze), of_eye<eye>(code.gaze)}, m.deformed,
                          of_eye<eye>(m.gaze));
        });
    }
    const LossTerm<T> def = deformation_term<T>(m.deformed, sample.landmarks);
    l.deform = def.value;
    m.g_deformed = T(weights.deform) * def.gradient;
    const Columns<T> sdf = m.geometry.output.topRows(1);
    const LossTerm<T> lmk = landmark_term<T>(sdf);
    l.landmark = lmk.value;
    m.g_sdf = T(weights.landmark) * lmk.gradient;

    if constexpr (has_effect<E, EyeOffset>) {
        const Columns<T> moved =
            eye_offset<T>(backend, mesh.eye_offset, config, code, m.eye_offset);
        const LossTerm<T> eye = eye_offset_term<T>(moved, sample.eye_displacement);
        l.eye_offset = eye.value;
        m.g_eye_offset = T(weights.eye_offset) * eye.gradient;
    }
    return l;
}

/// Adds the gradient to `grad`.
template <class T, EffectSet E, Backend B>
void landmark_losses_vjp(const B& backend, const GuidanceMesh<T, E>& mesh,
                         const LandmarkStage& stage, const LandmarkTrace<T, E>& m,
                         GuidanceMesh<T, E>& grad) {
    using std::tanh;
    const AvatarConfig& config = stage.config;
    [[maybe_unused]] const FrameCode<T, E>& code = m.frame;
    const T reach = T(config.vertex_offset), gain = T(config.deform_scale);
    Columns<T> g_code = Columns<T>::Zero(m.code.rows(), m.code.cols());
    Columns<T> g_shifted = m.g_deformed;
    if constexpr (has_effect<E, Expression>)
        field_vjp(backend, Field{mesh.networks.exp_deform, Squash::tanh, gain},
                  {m.ones, code.expression, m.exp}, m.g_deformed,
                  {&grad.networks.exp_deform, &g_code});
    if (stage.landmarks_follow_gaze && has_effect<E, Periocular>) {
        Weights<T, E> g_w(m.shifted.cols());
        for_eyes([&]<std::size_t eye>() {
            if constexpr (skin_follows<E, eye>)
                field_vjp(
                    backend, Field{of_eye<eye>(mesh.networks.gaze_deform), Squash::tanh, gain},
                    {of_eye<eye>(m.weights.gaze), of_eye<eye>(code.gaze), of_eye<eye>(m.gaze)},
                    m.g_deformed,
                    {&of_eye<eye>(grad.networks.gaze_deform), &g_code, &of_eye<eye>(g_w.gaze)});
        });
        face_weights_vjp<T>(backend, {config, m.shifted, mesh.landmarks}, m.nearest, g_w,
                            {g_shifted, &grad.landmarks});
    }
    g_shifted += EncodingOf<E>::vjp(m.code, g_code, config.frequencies);
    Columns<T> g_output = Columns<T>::Zero(m.geometry.output.rows(), m.geometry.output.cols());
    g_output.topRows(1) = m.g_sdf;
    g_output.middleRows(1, 3) =
        g_shifted.cwiseProduct(m.geometry.output.middleRows(1, 3).unaryExpr([&](const T& o) {
            const T h = tanh(o);
            return T(reach * (T(1) - h) * (T(1) + h));
        }));
    grad.landmarks += g_shifted + geometry_vjp(backend, mesh, config, {m.geometry, g_output}, grad);

    if constexpr (has_effect<E, EyeOffset>) {
        VecX<T> g_pose_code = VecX<T>::Zero(code.pose.size());
        eye_offset_vjp<T>(backend, mesh.eye_offset, {config, m.eye_offset}, m.g_eye_offset,
                          {grad.eye_offset, g_pose_code});
    }
}

} // namespace rye
