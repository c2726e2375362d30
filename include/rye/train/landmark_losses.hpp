// SPDX-License-Identifier: Apache-2.0
/// rye/train/landmark_losses.hpp: terms of stage 1 that need no surface and no picture: positions
/// of landmarks and eyeball centres, and the landmarks' distance from the surface.
/// Canonical units. Source: paper eq. (12), L_def, L_lmk and L_eye.
#pragma once

#include <rye/avatar/eye_stream.hpp>
#include <rye/avatar/guidance_mesh.hpp>
#include <rye/loss/mesh_terms.hpp>
#include <rye/train/samples.hpp>
#include <rye/train/settings.hpp>

namespace rye {

/// Terms of the first stage's objective, unweighted except for the total.
template <class T>
struct MeshLosses {
    T rgb = T(0), silhouette = T(0), deform = T(0), offset = T(0), landmark = T(0);
    T laplacian = T(0), eye_offset = T(0);
    T total = T(0);      ///< weighted
    Index vertices = 0;  ///< of the surface; 0 for no surface, without image losses
};

namespace detail {

/// Neutral landmarks as inputs of the deformations' networks, which are the same in every frame.
template <class T, EffectSet E = PaperEffects>
struct LandmarkPlaces {
    Columns<T> shifted;         ///< after the lattice offset, 3 x L
    Columns<T> code;
    Columns<T> ones;            ///< influence, 1 everywhere
    [[no_unique_address]] Weights<T, E> weights; ///< of the gaze, if landmarks follow it
    [[no_unique_address]] WeightsTrace<T, E> nearest;
};

/// Deformation of the landmarks in a frame.
template <class T, EffectSet E = PaperEffects>
struct DeformedLandmarks {
    Columns<T> deformed;        ///< 3 x L
    [[no_unique_address]] Slot<E, Expression, FieldTrace<T>> exp;
    [[no_unique_address]] SkinSlot<E, FieldTrace<T>> gaze;
};

} // namespace detail

/// Deformation of the neutral landmarks by expression (and optionally by gaze), for L_def.
template <class T, EffectSet E = PaperEffects>
struct LandmarkTrace : detail::LandmarkPlaces<T, E>, detail::DeformedLandmarks<T, E> {
    [[no_unique_address]] FrameCode<T, E> frame;
    GeometryTrace<T> geometry;  ///< at the landmarks: signed distance and offset
    [[no_unique_address]] detail::Slot<E, EyeOffset, EyeOffsetTrace<T>> eye_offset;
    Columns<T> g_deformed, g_sdf;  ///< weighted cotangents
    [[no_unique_address]] detail::Slot<E, EyeOffset, Columns<T>, 1> g_eye_offset;
};

/// Settings of the landmarks' terms. `landmarks_follow_gaze` also deforms the landmarks of L_def by
/// the gaze fields, weighted by lambda_gaze; GHA, which has no gaze fields, deforms them by
/// expression alone.
struct LandmarkStage {
    const AvatarConfig& config;
    const LandmarkRoles& roles;
    bool landmarks_follow_gaze;
};
/// Settings and weights of the landmarks' terms.
struct WeightedLandmarks : LandmarkStage {
    const MeshLossConfig& weights;
};

/// Sets the places of the landmarks; `geometry`: trace of the lattice's network there.
template <class T, EffectSet E, Backend B>
void place_landmarks(const B& backend, const GuidanceMesh<T, E>& mesh, const LandmarkStage& stage,
                     GeometryTrace<T>& geometry, detail::LandmarkPlaces<T, E>& places) {
    using std::tanh;
    const AvatarConfig& config = stage.config;
    geometry_at(backend, mesh, config, mesh.landmarks, geometry);
    const T reach = T(config.vertex_offset);
    places.shifted = mesh.landmarks + geometry.output.middleRows(1, 3).unaryExpr(
                                          [&](const T& o) { return T(reach * tanh(o)); });
    encode_points<detail::EncodingOf<E>>(backend, places.shifted, config.frequencies, places.code);
    places.ones = Columns<T>::Ones(1, places.shifted.cols());
    if (stage.landmarks_follow_gaze && has_effect<E, Periocular>)
        places.weights = face_weights<T>(backend, {config, places.shifted, mesh.landmarks},
                                         stage.roles, places.nearest);
}

namespace detail {

/// Inputs of the deformation of landmarks in a frame by a face's networks.
template <class T, EffectSet E>
struct LandmarkDeformation {
    const FaceNetworks<T, E>& networks;
    const LandmarkStage& stage;
    const LandmarkPlaces<T, E>& places;
    const FrameCode<T, E>& code;
};

} // namespace detail

/// Sets the deformed landmarks.
template <class T, EffectSet E, Backend B>
void deform_landmarks(const B& backend, const detail::LandmarkDeformation<T, E>& at,
                      detail::DeformedLandmarks<T, E>& m) {
    [[maybe_unused]] const T gain = T(at.stage.config.deform_scale);
    [[maybe_unused]] const detail::LandmarkPlaces<T, E>& places = at.places;
    m.deformed = places.shifted;
    if constexpr (has_effect<E, Expression>)
        add_field(backend, Field{at.networks.exp_deform, Squash::tanh, gain},
                  {places.code, places.ones, at.code.expression}, m.deformed, m.exp);
    if (!at.stage.landmarks_follow_gaze || !has_effect<E, Periocular>) return;
    for_eyes([&]<std::size_t eye>() {
        if constexpr (detail::skin_follows<E, eye>)
            add_field(backend, Field{of_eye<eye>(at.networks.gaze_deform), Squash::tanh, gain},
                      {places.code, of_eye<eye>(places.weights.gaze), of_eye<eye>(at.code.gaze)},
                      m.deformed, of_eye<eye>(m.gaze));
    });
}

namespace detail {

/// Gradients of deform_landmarks, accumulated; those of code and influences may be null.
template <class T, EffectSet E>
struct LandmarkGradients {
    FaceNetworks<T, E>& networks;
    Columns<T>* code = nullptr;
    Weights<T, E>* weights = nullptr;
};

} // namespace detail

/// Propagates the cotangent of the deformed landmarks, 3 x L, back; not to the places themselves.
template <class T, EffectSet E, Backend B>
void deform_landmarks_vjp(const B& backend, const detail::LandmarkDeformation<T, E>& at,
                          const detail::DeformedLandmarks<T, E>& m, const Columns<T>& g_deformed,
                          const detail::LandmarkGradients<T, E>& g) {
    [[maybe_unused]] const T gain = T(at.stage.config.deform_scale);
    if constexpr (has_effect<E, Expression>)
        field_vjp(backend, Field{at.networks.exp_deform, Squash::tanh, gain},
                  {at.places.ones, at.code.expression, m.exp}, g_deformed,
                  {&g.networks.exp_deform, g.code});
    if (!at.stage.landmarks_follow_gaze || !has_effect<E, Periocular>) return;
    for_eyes([&]<std::size_t eye>() {
        if constexpr (detail::skin_follows<E, eye>)
            field_vjp(backend, Field{of_eye<eye>(at.networks.gaze_deform), Squash::tanh, gain},
                      {of_eye<eye>(at.places.weights.gaze), of_eye<eye>(at.code.gaze),
                       of_eye<eye>(m.gaze)},
                      g_deformed,
                      {&of_eye<eye>(g.networks.gaze_deform), g.code,
                       g.weights != nullptr ? &of_eye<eye>(g.weights->gaze) : nullptr});
    });
}

/// Returns the losses with deform, landmark and eye_offset set.
template <class T, EffectSet E, Backend B>
MeshLosses<T> landmark_losses(const B& backend, const GuidanceMesh<T, E>& mesh,
                              const WeightedLandmarks& stage, const MeshSample<T, E>& sample,
                              LandmarkTrace<T, E>& m) {
    const MeshLossConfig& weights = stage.weights;
    const FrameCode<T, E>& code = m.frame =
        frame_code(stage.config, OpticalDrivers<T, E>(sample.drivers));
    MeshLosses<T> l;
    place_landmarks<T, E>(backend, mesh, stage, m.geometry, m);
    deform_landmarks<T, E>(backend, {mesh.networks, stage, m, code}, m);
    const LossTerm<T> def = detail::deformation_term<T>(m.deformed, sample.landmarks);
    l.deform = def.value;
    m.g_deformed = T(weights.deform) * def.gradient;
    const Columns<T> sdf = m.geometry.output.topRows(1);
    const LossTerm<T> lmk = detail::landmark_term<T>(sdf);
    l.landmark = lmk.value;
    m.g_sdf = T(weights.landmark) * lmk.gradient;

    if constexpr (has_effect<E, EyeOffset>) {
        const Columns<T> moved =
            eye_offset<T>(backend, mesh.eye_offset, stage.config, code, m.eye_offset);
        const LossTerm<T> eye = detail::eye_offset_term<T>(moved, sample.eye_displacement);
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
    const T reach = T(config.vertex_offset);
    Columns<T> g_code = Columns<T>::Zero(m.code.rows(), m.code.cols());
    Columns<T> g_shifted = m.g_deformed;
    const bool follow = stage.landmarks_follow_gaze && has_effect<E, Periocular>;
    Weights<T, E> g_w(follow ? m.shifted.cols() : 0);
    deform_landmarks_vjp<T, E>(backend, {mesh.networks, stage, m, code}, m, m.g_deformed,
                               {grad.networks, &g_code, &g_w});
    if (follow)
        face_weights_vjp<T>(backend, {config, m.shifted, mesh.landmarks}, m.nearest, g_w,
                            {g_shifted, &grad.landmarks});
    encode_points_vjp<detail::EncodingOf<E>>(backend, m.code, g_code, config.frequencies,
                                             g_shifted);
    Columns<T> g_output = Columns<T>::Zero(m.geometry.output.rows(), m.geometry.output.cols());
    g_output.topRows(1) = m.g_sdf;
    g_output.middleRows(1, 3) =
        g_shifted.cwiseProduct(m.geometry.output.middleRows(1, 3).unaryExpr([&](const T& o) {
            const T h = tanh(o);
            return T(reach * (T(1) - h) * (T(1) + h));
        }));
    grad.landmarks += g_shifted;
    geometry_vjp(backend, mesh, config, {m.geometry, g_output}, grad, &grad.landmarks);

    if constexpr (has_effect<E, EyeOffset>) {
        VecX<T> g_pose_code = VecX<T>::Zero(code.pose.size());
        eye_offset_vjp<T>(backend, mesh.eye_offset, {config, m.eye_offset}, m.g_eye_offset,
                          {grad.eye_offset, g_pose_code});
    }
}

} // namespace rye
