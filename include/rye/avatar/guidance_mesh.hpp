// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/guidance_mesh.hpp: stage 1, the guidance model: a neutral surface extracted from a
/// learned signed distance, coloured and deformed by the networks that stage 2 inherits.
/// Frame: canonical head, canonical units; posed vertices are in the world.
/// Source: GHA's MeshHeadModule, with the paper's gaze fields (section 3.3) and eye offset.
#pragma once

#include <rye/avatar/eye_stream.hpp>
#include <rye/avatar/face_networks.hpp>
#include <rye/avatar/field.hpp>
#include <rye/avatar/head_pose.hpp>
#include <rye/avatar/weights.hpp>
#include <rye/geometry/marching_tets.hpp>

namespace rye {

template <class T>
struct GuidanceMesh {
    Mlp<T> geometry;         ///< PE(x) -> tanh -> signed distance, vertex offset (3), feature
    FaceNetworks<T> networks;
    EyeOffset<T> eye_offset;
    Columns<T> landmarks;    ///< neutral landmarks, trainable, 3 x L

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        nested_fields<Mlp<T>>("geo_mlp", f, p.geometry...);
        FaceNetworks<T>::fields(f, p.networks...);
        EyeOffset<T>::fields(f, p.eye_offset...);
        f("landmarks_3d_neutral", p.landmarks...);
    }
    static GuidanceMesh init(const AvatarConfig& c, const Columns<T>& landmarks,
                             const Random& random) {
        const MlpShape shape = mlp_shape(c.position_code(), 0, c.networks.geometry, 4 + c.feature);
        return {Mlp<T>::init(shape, random.fork(11)), FaceNetworks<T>::init(c, random.fork(12)),
                EyeOffset<T>::init(c, random.fork(13)), landmarks};
    }
};

/// tanh of the geometry network at points (3 x N): rows signed distance, offset (3), feature.
template <class T>
struct GeometryTrace {
    Columns<T> code, output;
    MlpTrace<T> mlp;
};

template <Backend B, class T>
void geometry_at(const GuidanceMesh<T>& mesh, const AvatarConfig& config, const Columns<T>& points,
                 GeometryTrace<T>& trace) {
    trace.code = positional_encoding(points, config.frequencies);
    trace.output = mlp_forward<B, T>(mesh.geometry, trace.code, VecX<T>(), &trace.mlp);
    squash_in_place(Squash::tanh, trace.output);
}

/// Accumulates network gradients; returns the cotangent of the points.
template <Backend B, class T>
Columns<T> geometry_vjp(const GuidanceMesh<T>& mesh, const AvatarConfig& config,
                        const GeometryTrace<T>& trace, Columns<T> g_output, GuidanceMesh<T>& grad) {
    squash_vjp(Squash::tanh, trace.output, g_output);
    Columns<T> g_code;
    mlp_vjp<B, T>(mesh.geometry, trace.code, VecX<T>(), trace.mlp, g_output, grad.geometry, &g_code,
                  nullptr);
    return positional_encoding_vjp(trace.code, g_code, config.frequencies);
}

/// The neutral surface. Gradients exist only at the lattice vertices that it touches, so only those
/// are evaluated with a trace.
template <class T>
struct NeutralSurface {
    Columns<T> lattice;        ///< moved lattice vertices that the surface touches, 3 x V'
    Columns<T> sdf;            ///< 1 x V'
    Columns<T> lattice_feature;///< F x V'
    GeometryTrace<T> geometry; ///< at those vertices
    Surface<T> surface;        ///< positions 3 x M, over the touched vertices
    Columns<T> feature;        ///< F x M, in (-1, 1)

    bool empty() const { return surface.topology.faces.empty(); }
};

/// Lattice vertices whose code is held at once, to bound the memory of a fine lattice.
inline constexpr Index signed_distance_block = 32768;

template <Backend B, class T>
NeutralSurface<T> neutral_surface(const GuidanceMesh<T>& mesh, const AvatarConfig& config,
                                  const TetGrid<T>& grid) {
    using std::tanh;
    NeutralSurface<T> n;
    Columns<T> sdf;
    sdf.resize(1, grid.vertices.cols());
    for (Index b = 0; b < sdf.cols(); b += signed_distance_block) {  // everywhere, without a trace
        const Index count = std::min(signed_distance_block, sdf.cols() - b);
        const Columns<T> code =
            positional_encoding(grid.vertices.middleCols(b, count), config.frequencies);
        sdf.middleCols(b, count) =
            mlp_forward<B, T>(mesh.geometry, code, VecX<T>(), nullptr).topRows(1);
    }
    const SurfaceTopology topology = surface_topology<T>(grid.topology, sdf); // sign of tanh(s) = s
    if (topology.faces.empty()) return n;
    const std::vector<Index> touched = touched_vertices(topology);
    const Columns<T> rest = pick_columns(grid.vertices, touched);
    geometry_at<B>(mesh, config, rest, n.geometry);
    n.sdf = n.geometry.output.topRows(1);
    const T reach = T(config.vertex_offset);
    n.lattice = rest + n.geometry.output.middleRows(1, 3).unaryExpr([&](const T& o) {
        return T(reach * tanh(o));  // a second tanh, as GHA's code has it
    });
    n.lattice_feature = n.geometry.output.bottomRows(config.feature);
    n.surface.topology = over_touched(topology, touched);
    n.surface.fraction = crossing_fractions<T>(n.surface.topology, n.sdf);
    n.surface.positions = interpolate<T>(n.surface.topology, n.surface.fraction, n.lattice);
    n.feature = interpolate<T>(n.surface.topology, n.surface.fraction, n.lattice_feature);
    return n;
}

template <Backend B, class T>
void neutral_surface_vjp(const GuidanceMesh<T>& mesh, const AvatarConfig& config,
                         const NeutralSurface<T>& n, const Columns<T>& g_positions,
                         const Columns<T>& g_feature, GuidanceMesh<T>& grad) {
    using std::tanh;
    const SurfaceGradient<T> g = surface_vjp<T>(n.surface, n.lattice, n.sdf, n.lattice_feature,
                                                g_positions, g_feature);
    Columns<T> g_output(n.geometry.output.rows(), n.geometry.output.cols());
    const T reach = T(config.vertex_offset);
    g_output.topRows(1) = g.sdf;
    g_output.middleRows(1, 3) =
        g.vertices.cwiseProduct(n.geometry.output.middleRows(1, 3).unaryExpr([&](const T& o) {
            const T t = tanh(o);
            return T(reach * (T(1) - t) * (T(1) + t));
        }));
    g_output.bottomRows(config.feature) = g.features;
    geometry_vjp<B>(mesh, config, n.geometry, g_output, grad);
}

/// One frame of the guidance mesh.
template <class T>
struct PosedMesh {
    FrameCode<T> code;
    HeadTransform<T> head;
    Weights<T> weights;
    WeightsTrace<T> nearest;
    Columns<T> rest_code, moved;        ///< PE(x), and x after expression and gaze
    Columns<T> moved_code;              ///< PE of the latter, which the head pose's field reads
    FieldTrace<T> exp_color, pose_color, exp_deform, pose_deform;
    std::array<FieldTrace<T>, 2> gaze_color, gaze_deform;
    Columns<T> color;                   ///< channels x M; the first three are RGB
    Columns<T> canonical;               ///< deformed, head frame, 3 x M
    Columns<T> world;                   ///< 3 x M
};

/// Colours, then deforms one after the other (expression and gaze, then head pose), then poses.
template <Backend B, class T>
void pose_mesh(const GuidanceMesh<T>& mesh, const AvatarConfig& config, const LandmarkRoles& roles,
               const Drivers<T>& drivers, const NeutralSurface<T>& neutral, PosedMesh<T>& p) {
    const FaceNetworks<T>& nets = mesh.networks;
    const Columns<T>& x = neutral.surface.positions;
    const T one = T(1), reach = T(config.deform_scale);
    p.code = frame_code(config, drivers);
    p.head = head_transform(drivers);
    p.weights = face_weights<B, T>(config, x, mesh.landmarks, roles, p.nearest);
    const Weights<T>& w = p.weights;
    p.color = Columns<T>::Zero(config.channels, x.cols());
    add_field<B>(nets.exp_color, Squash::sigmoid, one, neutral.feature, w.exp, p.code.expression,
                 p.color, p.exp_color);
    add_field<B>(nets.pose_color, Squash::sigmoid, one, neutral.feature, w.pose, p.code.pose,
                 p.color, p.pose_color);
    p.rest_code = positional_encoding(x, config.frequencies);
    p.moved = x;
    add_field<B>(nets.exp_deform, Squash::tanh, reach, p.rest_code, w.exp, p.code.expression,
                 p.moved, p.exp_deform);
    for (std::size_t eye = 0; eye < 2; ++eye) {
        add_field<B>(nets.gaze_color[eye], Squash::none, one, neutral.feature, w.gaze[eye],
                     p.code.gaze[eye], p.color, p.gaze_color[eye]);
        add_field<B>(nets.gaze_deform[eye], Squash::tanh, reach, p.rest_code, w.gaze[eye],
                     p.code.gaze[eye], p.moved, p.gaze_deform[eye]);
    }
    p.moved_code = positional_encoding(p.moved, config.frequencies);
    p.canonical = p.moved;
    add_field<B>(nets.pose_deform, Squash::tanh, reach, p.moved_code, w.pose, p.code.pose,
                 p.canonical, p.pose_deform);
    const Mat3<T> scaled = p.head.scale * p.head.rotation;
    p.world = (scaled * p.canonical).colwise() + p.head.translation;
}

/// Extra cotangents of the offset loss: those of the raw outputs of the deformation networks.
template <class T>
struct DeformCotangents {
    Columns<T> exp, pose;
    std::array<Columns<T>, 2> gaze;
};

/// Accumulates gradients to networks, landmarks, and (through the neutral surface) the geometry.
template <Backend B, class T>
void pose_mesh_vjp(const GuidanceMesh<T>& mesh, const AvatarConfig& config,
                   const NeutralSurface<T>& neutral, const PosedMesh<T>& p,
                   const Columns<T>& g_world, const Columns<T>& g_color,
                   const DeformCotangents<T>& g_raw, GuidanceMesh<T>& grad, Columns<T>& g_positions,
                   Columns<T>& g_feature) {
    const FaceNetworks<T>& nets = mesh.networks;
    FaceNetworks<T>& gnets = grad.networks;
    const Columns<T>& x = neutral.surface.positions;
    const T one = T(1), reach = T(config.deform_scale);
    const Weights<T>& w = p.weights;
    Weights<T> g_w(x.cols());
    const Mat3<T> back = p.head.scale * p.head.rotation.transpose();
    const Columns<T> g_canonical = back * g_world;
    Columns<T> g_moved = g_canonical;
    Columns<T> g_code = Columns<T>::Zero(p.moved_code.rows(), x.cols());
    field_vjp<B>(nets.pose_deform, Squash::tanh, reach, w.pose, p.code.pose, p.pose_deform,
                 g_canonical, {&gnets.pose_deform, &g_code, &g_w.pose, nullptr, &g_raw.pose});
    g_moved += positional_encoding_vjp(p.moved_code, g_code, config.frequencies);
    g_code.setZero();
    field_vjp<B>(nets.exp_deform, Squash::tanh, reach, w.exp, p.code.expression, p.exp_deform,
                 g_moved, {&gnets.exp_deform, &g_code, &g_w.exp, nullptr, &g_raw.exp});
    for (std::size_t eye = 0; eye < 2; ++eye) {
        field_vjp<B>(nets.gaze_deform[eye], Squash::tanh, reach, w.gaze[eye], p.code.gaze[eye],
                     p.gaze_deform[eye], g_moved,
                     {&gnets.gaze_deform[eye], &g_code, &g_w.gaze[eye], nullptr, &g_raw.gaze[eye]});
        field_vjp<B>(nets.gaze_color[eye], Squash::none, one, w.gaze[eye], p.code.gaze[eye],
                     p.gaze_color[eye], g_color,
                     {&gnets.gaze_color[eye], &g_feature, &g_w.gaze[eye]});
    }
    field_vjp<B>(nets.exp_color, Squash::sigmoid, one, w.exp, p.code.expression, p.exp_color,
                 g_color, {&gnets.exp_color, &g_feature, &g_w.exp});
    field_vjp<B>(nets.pose_color, Squash::sigmoid, one, w.pose, p.code.pose, p.pose_color, g_color,
                 {&gnets.pose_color, &g_feature, &g_w.pose});
    g_positions += g_moved + positional_encoding_vjp(p.rest_code, g_code, config.frequencies);
    face_weights_vjp<T>(config, x, mesh.landmarks, p.nearest, g_w, g_positions, &grad.landmarks);
}

} // namespace rye
