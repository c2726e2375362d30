// SPDX-License-Identifier: Apache-2.0
/// rye/train/stage_mesh.hpp: one step of stage 1, geometry-guided initialisation: the guidance mesh
/// of one frame drawn in several views, seven losses, and their gradient.
/// Images are sRGB in [0, 1] over black. Source: paper section 4.1, eq. (12) and its weights.
#pragma once

#include <string>
#include <vector>

#include <rye/avatar/guidance_mesh.hpp>
#include <rye/geometry/mesh_raster.hpp>
#include <rye/loss/mesh_terms.hpp>
#include <rye/train/probe.hpp>
#include <rye/train/samples.hpp>
#include <rye/train/settings.hpp>

namespace rye {

template <class T>
struct MeshLosses {
    T rgb = T(0), silhouette = T(0), deform = T(0), offset = T(0), landmark = T(0);
    T laplacian = T(0), eye_offset = T(0);
    T total = T(0);      ///< weighted
    Index vertices = 0;  ///< of the surface; 0: no surface, image losses left out
};

/// The deformation of the neutral landmarks by expression (and by gaze where asked), for L_def.
template <class T>
struct LandmarkTrace {
    GeometryTrace<T> geometry;  ///< at the landmarks: signed distance and offset
    Columns<T> shifted;         ///< after the lattice offset
    Columns<T> code;
    Columns<T> ones;            ///< influence 1 everywhere
    Weights<T> weights;
    WeightsTrace<T> nearest;
    FieldTrace<T> exp;
    std::array<FieldTrace<T>, 2> gaze;
    Columns<T> deformed;
};

template <class T>
struct MeshTrace {
    NeutralSurface<T> neutral;
    PosedMesh<T> posed;
    LandmarkTrace<T> landmarks;
    EyeOffsetTrace<T> eye_offset;
    std::vector<MeshRaster<T>> rasters;

    // Weighted cotangents of what the losses read.
    std::vector<Columns<T>> g_image, g_silhouette;
    Columns<T> g_world;
    DeformCotangents<T> g_raw;
    Columns<T> g_deformed, g_landmark_sdf, g_eye_offset;
};

/// Renders and compares. `landmarks_follow_gaze` deforms the landmarks of L_def by the gaze fields
/// too, weighted by lambda_gaze; GHA, which has none, deforms them by expression alone.
template <Backend B, class T, class Probe = NoProbe>
MeshLosses<T> mesh_losses(const GuidanceMesh<T>& mesh, const AvatarConfig& config,
                          const LandmarkRoles& roles, const TetGrid<T>& grid,
                          const MeshLossConfig& weights, bool landmarks_follow_gaze,
                          const MeshSample<T>& sample, MeshTrace<T>& t,
                          Probe&& probe = {}) {
    using std::tanh;
    MeshLosses<T> l;
    t.neutral = neutral_surface<B>(mesh, config, grid);
    probe("surface");
    t.rasters.clear();
    t.g_image.clear();
    t.g_silhouette.clear();
    if (!t.neutral.empty()) {
        l.vertices = t.neutral.surface.positions.cols();
        pose_mesh<B>(mesh, config, roles, sample.drivers, t.neutral, t.posed);
        probe("networks");
        const Columns<T> shown = t.posed.color.topRows(3);  // the other channels have no loss here
        const T share = T(1.0 / static_cast<double>(sample.views.size()));
        for (const MeshView<T>& view : sample.views) {
            t.rasters.push_back(rasterize_mesh<B, T>(
                t.posed.world, t.neutral.surface.topology.faces, view.camera, shown));
            const MeshRaster<T>& raster = t.rasters.back();
            const LossTerm<T> color =
                color_term<B, T>(raster.attributes.pixels, view.truth.pixels, view.visible);
            l.rgb += share * color.value;
            t.g_image.push_back((T(weights.rgb) * share) * color.gradient);
            const LossTerm<T> sil =
                silhouette_term<T>(raster.silhouette.pixels, view.mask, view.visible);
            l.silhouette += share * sil.value;
            t.g_silhouette.push_back((T(weights.silhouette) * share) * sil.gradient);
        }
        probe("mesh render");
        const LossTerm<T> lap =
            laplacian_term<T>(t.posed.world, t.neutral.surface.topology.faces);
        l.laplacian = lap.value;
        t.g_world = T(weights.laplacian) * lap.gradient;
        const auto offset = [&](const FieldTrace<T>& field, Columns<T>& g) {
            const LossTerm<T> o = offset_term<T>(field.output);
            l.offset += o.value;
            g = T(weights.offset) * o.gradient;
        };
        offset(t.posed.exp_deform, t.g_raw.exp);
        offset(t.posed.pose_deform, t.g_raw.pose);
        for (std::size_t eye = 0; eye < 2; ++eye)
            offset(t.posed.gaze_deform[eye], t.g_raw.gaze[eye]);
    }

    const FrameCode<T> code = frame_code(config, sample.drivers);
    LandmarkTrace<T>& m = t.landmarks;
    geometry_at<B>(mesh, config, mesh.landmarks, m.geometry);
    const T reach = T(config.vertex_offset), gain = T(config.deform_scale);
    m.shifted = mesh.landmarks + m.geometry.output.middleRows(1, 3).unaryExpr(
                                     [&](const T& o) { return T(reach * tanh(o)); });
    m.code = positional_encoding(m.shifted, config.frequencies);
    m.ones = Columns<T>::Ones(1, m.shifted.cols());
    m.deformed = m.shifted;
    add_field<B>(mesh.networks.exp_deform, Squash::tanh, gain, m.code, m.ones, code.expression,
                 m.deformed, m.exp);
    if (landmarks_follow_gaze) {
        m.weights = face_weights<B, T>(config, m.shifted, mesh.landmarks, roles, m.nearest);
        for (std::size_t eye = 0; eye < 2; ++eye)
            add_field<B>(mesh.networks.gaze_deform[eye], Squash::tanh, gain, m.code,
                         m.weights.gaze[eye], code.gaze[eye], m.deformed, m.gaze[eye]);
    }
    const LossTerm<T> def = deformation_term<T>(m.deformed, sample.landmarks);
    l.deform = def.value;
    t.g_deformed = T(weights.deform) * def.gradient;
    const Columns<T> sdf = m.geometry.output.topRows(1);
    const LossTerm<T> lmk = landmark_term<T>(sdf);
    l.landmark = lmk.value;
    t.g_landmark_sdf = T(weights.landmark) * lmk.gradient;

    const Columns<T> moved = eye_offset<B, T>(mesh.eye_offset, config, code, t.eye_offset);
    const LossTerm<T> eye = eye_offset_term<T>(moved, sample.eye_displacement);
    l.eye_offset = eye.value;
    t.g_eye_offset = T(weights.eye_offset) * eye.gradient;

    l.total = T(weights.rgb) * l.rgb + T(weights.silhouette) * l.silhouette +
              T(weights.deform) * l.deform + T(weights.offset) * l.offset +
              T(weights.landmark) * l.landmark + T(weights.laplacian) * l.laplacian +
              T(weights.eye_offset) * l.eye_offset;
    probe("losses");
    return l;
}

/// Adds dL/dparameters to `grad`.
template <Backend B, class T, class Probe = NoProbe>
void mesh_losses_vjp(const GuidanceMesh<T>& mesh, const AvatarConfig& config,
                     bool landmarks_follow_gaze, const MeshSample<T>& sample, const MeshTrace<T>& t,
                     GuidanceMesh<T>& grad, Probe&& probe = {}) {
    using std::tanh;
    if (!t.neutral.empty()) {
        const std::vector<Face>& faces = t.neutral.surface.topology.faces;
        Columns<T> g_world = t.g_world;
        Columns<T> g_color = Columns<T>::Zero(t.posed.color.rows(), t.posed.color.cols());
        const Columns<T> shown = t.posed.color.topRows(3);
        for (std::size_t v = 0; v < t.rasters.size(); ++v) {
            const MeshRasterGradient<T> g = rasterize_mesh_vjp<B, T>(
                t.rasters[v], faces, sample.views[v].camera, shown,
                {&t.g_image[v], &t.g_silhouette[v], nullptr});
            g_world += g.vertices;
            g_color.topRows(3) += g.attributes;
        }
        probe("mesh render vjp");
        Columns<T> g_positions = Columns<T>::Zero(3, g_world.cols());
        Columns<T> g_feature = Columns<T>::Zero(t.neutral.feature.rows(), g_world.cols());
        pose_mesh_vjp<B>(mesh, config, t.neutral, t.posed, g_world, g_color, t.g_raw, grad,
                         g_positions, g_feature);
        probe("networks vjp");
        neutral_surface_vjp<B>(mesh, config, t.neutral, g_positions, g_feature, grad);
        probe("surface vjp");
    }

    const FrameCode<T> code = frame_code(config, sample.drivers);
    const LandmarkTrace<T>& m = t.landmarks;
    const T reach = T(config.vertex_offset), gain = T(config.deform_scale);
    Columns<T> g_code = Columns<T>::Zero(m.code.rows(), m.code.cols());
    Columns<T> g_shifted = t.g_deformed;
    field_vjp<B>(mesh.networks.exp_deform, Squash::tanh, gain, m.ones, code.expression, m.exp,
                 t.g_deformed, {&grad.networks.exp_deform, &g_code});
    if (landmarks_follow_gaze) {
        Weights<T> g_w(m.shifted.cols());
        for (std::size_t eye = 0; eye < 2; ++eye)
            field_vjp<B>(mesh.networks.gaze_deform[eye], Squash::tanh, gain, m.weights.gaze[eye],
                         code.gaze[eye], m.gaze[eye], t.g_deformed,
                         {&grad.networks.gaze_deform[eye], &g_code, &g_w.gaze[eye]});
        face_weights_vjp<T>(config, m.shifted, mesh.landmarks, m.nearest, g_w, g_shifted,
                            &grad.landmarks);
    }
    g_shifted += positional_encoding_vjp(m.code, g_code, config.frequencies);
    Columns<T> g_output = Columns<T>::Zero(m.geometry.output.rows(), m.geometry.output.cols());
    g_output.topRows(1) = t.g_landmark_sdf;
    g_output.middleRows(1, 3) =
        g_shifted.cwiseProduct(m.geometry.output.middleRows(1, 3).unaryExpr([&](const T& o) {
            const T h = tanh(o);
            return T(reach * (T(1) - h) * (T(1) + h));
        }));
    grad.landmarks += g_shifted + geometry_vjp<B>(mesh, config, m.geometry, g_output, grad);

    VecX<T> g_pose_code = VecX<T>::Zero(code.pose.size());
    eye_offset_vjp<B, T>(mesh.eye_offset, config, t.eye_offset, t.g_eye_offset, grad.eye_offset,
                         g_pose_code);
    probe("landmarks vjp");
}

} // namespace rye
