// SPDX-License-Identifier: Apache-2.0
/// rye/train/stage_mesh.hpp: one step of stage 1, geometry-guided initialisation: the guidance mesh
/// of one frame drawn in several views, seven losses, and their gradient.
/// Images are sRGB in [0, 1] over black. Source: paper section 4.1, eq. (12) and its weights.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include <rye/avatar/guidance_mesh.hpp>
#include <rye/geometry/mesh_raster.hpp>
#include <rye/train/landmark_losses.hpp>
#include <rye/train/probe.hpp>

namespace rye {

/// Intermediate results of mesh_losses for mesh_losses_vjp.
template <class T, EffectSet E = PaperEffects>
struct MeshTrace {
    NeutralSurface<T> neutral;
    PosedMesh<T, E> posed;
    LandmarkTrace<T, E> landmarks;
    std::vector<MeshRaster<T>> rasters;
    std::vector<Pinhole<real_t<T>>> cameras; ///< of the rasters

    // Weighted cotangents of the losses' inputs.
    std::vector<Columns<T>> g_image, g_silhouette;
    Columns<T> g_world;
    [[no_unique_address]] detail::DeformCotangents<T, E> g_raw;
};

/// Settings of a step of stage 1; the probe is called at the end of each part.
template <class T, class Probe = NoProbe>
struct MeshStage : WeightedLandmarks {
    const TetGrid<T>& grid;
    Probe probe = {};
};

/// Returns the area of a square of the world, one unit wide, in the Laplacian term's unit: the
/// factor of the term.
template <class T, EffectSet E>
T laplacian_area(const MeshLossConfig& weights, const Drivers<T, E>& drivers) {
    if (weights.laplacian_unit == LaplacianUnit::world) return T(1);
    T scale = T(1); // world units per unit of the head frame, a decimetre
    detail::copy_slot(drivers.scale, scale);
    const T metres = T(0.1) / scale;
    return metres * metres;
}

/// Renders the views; returns the losses.
template <class T, EffectSet E, class Probe, Backend B>
MeshLosses<T> mesh_losses(const B& backend, const GuidanceMesh<T, E>& mesh,
                          const MeshStage<T, Probe>& stage, const MeshSample<T, E>& sample,
                          MeshTrace<T, E>& t) {
    const AvatarConfig& config = stage.config;
    const MeshLossConfig& weights = stage.weights;
    const Probe& probe = stage.probe;
    MeshLosses<T> l;
    t.neutral = neutral_surface(backend, mesh, config, stage.grid);
    probe("surface");
    const std::size_t views = t.neutral.empty() ? 0 : sample.views.size();
    t.rasters.resize(views); // whose memory is used again
    t.g_image.resize(views);
    t.g_silhouette.resize(views);
    t.cameras.clear();
    if (!t.neutral.empty()) {
        l.vertices = t.neutral.surface.positions.cols();
        pose_mesh(backend, mesh, {config, stage.roles, sample.drivers}, t.neutral, t.posed);
        probe("networks");
        const Columns<T> shown = t.posed.color.topRows(3);  // the other channels have no loss
        const T share = T(1.0 / static_cast<double>(views));
        for (std::size_t v = 0; v < views; ++v) {
            const MeshView<T>& view = sample.views[v];
            MeshRaster<T>& raster = t.rasters[v];
            detail::rasterize_mesh_into<T>(backend,
                                           {t.posed.world, t.neutral.surface.topology.faces, shown},
                                           view.camera, {}, raster);
            t.cameras.push_back(view.camera);
            LossTerm<T> color = detail::color_term<T>(backend, raster.attributes.pixels,
                                                      view.truth.pixels, view.visible);
            l.rgb += share * color.value;
            color.gradient *= T(weights.rgb) * share;
            t.g_image[v] = std::move(color.gradient);
            LossTerm<T> sil = detail::silhouette_term<T>(backend, raster.silhouette.pixels,
                                                         view.mask, view.visible);
            l.silhouette += share * sil.value;
            sil.gradient *= T(weights.silhouette) * share;
            t.g_silhouette[v] = std::move(sil.gradient);
        }
        probe("mesh render");
        const LossTerm<T> lap =
            detail::laplacian_term<T>(t.posed.world, t.neutral.surface.topology.faces);
        const T area = laplacian_area<T, E>(weights, sample.drivers);
        l.laplacian = area * lap.value;
        t.g_world = (T(weights.laplacian) * area) * lap.gradient;
        const auto offset = [&](const FieldTrace<T>& field, Columns<T>& g) {
            const LossTerm<T> o = detail::offset_term<T>(field.output);
            l.offset += o.value;
            g = T(weights.offset) * o.gradient;
        };
        if constexpr (has_effect<E, Expression>) offset(t.posed.exp_deform, t.g_raw.exp);
        if constexpr (has_effect<E, PoseResidual>) offset(t.posed.pose_deform, t.g_raw.pose);
        for_eyes([&]<std::size_t eye>() {
            if constexpr (detail::skin_follows<E, eye>)
                offset(of_eye<eye>(t.posed.gaze_deform), of_eye<eye>(t.g_raw.gaze));
        });
    }

    const MeshLosses<T> at_landmarks = landmark_losses(backend, mesh, stage, sample, t.landmarks);
    l.deform = at_landmarks.deform;
    l.landmark = at_landmarks.landmark;
    l.eye_offset = at_landmarks.eye_offset;
    l.total = T(weights.rgb) * l.rgb + T(weights.silhouette) * l.silhouette +
              T(weights.deform) * l.deform + T(weights.offset) * l.offset +
              T(weights.landmark) * l.landmark + T(weights.laplacian) * l.laplacian +
              T(weights.eye_offset) * l.eye_offset;
    probe("losses");
    return l;
}

/// Adds dL/dparameters to `grad`.
template <class T, EffectSet E, class Probe, Backend B>
void mesh_losses_vjp(const B& backend, const GuidanceMesh<T, E>& mesh,
                     const MeshStage<T, Probe>& stage, const MeshTrace<T, E>& t,
                     GuidanceMesh<T, E>& grad) {
    const AvatarConfig& config = stage.config;
    const Probe& probe = stage.probe;
    if (!t.neutral.empty()) {
        const std::vector<Face>& faces = t.neutral.surface.topology.faces;
        Columns<T> g_world = t.g_world;
        Columns<T> g_color = Columns<T>::Zero(t.posed.color.rows(), t.posed.color.cols());
        const Columns<T> shown = t.posed.color.topRows(3);
        for (std::size_t v = 0; v < t.rasters.size(); ++v) {
            const MeshRasterGradient<T> g =
                rasterize_mesh_vjp<T>(backend, t.rasters[v], {t.posed.world, faces, shown},
                                      t.cameras[v], {&t.g_image[v], &t.g_silhouette[v], nullptr});
            g_world += g.vertices;
            g_color.topRows(3) += g.attributes;
        }
        probe("mesh render vjp");
        Columns<T> g_positions = Columns<T>::Zero(3, g_world.cols());
        Columns<T> g_feature = Columns<T>::Zero(t.neutral.feature.rows(), g_world.cols());
        pose_mesh_vjp(backend, mesh, config, {t.neutral, t.posed, g_world, g_color, t.g_raw},
                      {grad, g_positions, g_feature});
        probe("networks vjp");
        neutral_surface_vjp(backend, mesh, config, {t.neutral, g_positions, g_feature}, grad);
        probe("surface vjp");
    }

    landmark_losses_vjp(backend, mesh, stage, t.landmarks, grad);
    probe("landmarks vjp");
}

} // namespace rye
