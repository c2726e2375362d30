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

/// Trained parameters of the first stage's mesh: a signed distance in a lattice, and its colours
/// and deformations.
template <class T, EffectSet E = PaperEffects>
struct GuidanceMesh {
    detail::NetworkOf<T, E>
        geometry; ///< PE(x) -> tanh -> signed distance, vertex offset (3), feature
    [[no_unique_address]] FaceNetworks<T, E> networks;
    [[no_unique_address]] detail::Slot<E, EyeOffset, EyeOffsetNetwork<T, detail::NetworksOf<E>>>
        eye_offset;
    Columns<T> landmarks;    ///< neutral landmarks, trainable, 3 x L

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        detail::nested_fields<detail::NetworkOf<T, E>>("geo_mlp", f, p.geometry...);
        FaceNetworks<T, E>::fields(f, p.networks...);
        if constexpr (has_effect<E, EyeOffset>)
            EyeOffsetNetwork<T, detail::NetworksOf<E>>::fields(f, p.eye_offset...);
        f("landmarks_3d_neutral", p.landmarks...);
    }
    static GuidanceMesh init(const AvatarConfig& c, const Columns<T>& landmarks,
                             const Random& random) {
        const MlpShape shape = detail::network_shape<detail::NetworksOf<E>>(mlp_shape(
            c.position_code<detail::NetworksOf<E>>(), 0, c.networks.geometry, 4 + c.feature));
        GuidanceMesh m;
        m.geometry = detail::NetworkOf<T, E>::init(shape, random.fork(11));
        m.networks = FaceNetworks<T, E>::init(c, random.fork(12));
        if constexpr (has_effect<E, EyeOffset>)
            m.eye_offset = EyeOffsetNetwork<T, detail::NetworksOf<E>>::init(c, random.fork(13));
        m.landmarks = landmarks;
        return m;
    }
};

/// The geometry network at points (3 x N), and what its vjp reads.
template <class T>
struct GeometryTrace {
    Columns<T> code; ///< of the points
    /// tanh of the network, (4 + F) x N: signed distance, positive outside, offset (3), feature.
    Columns<T> output;
    MlpTrace<T> mlp;
};

/// Evaluates the geometry network at points of the head frame (3 x N), into `trace`.
template <class T, EffectSet E, Backend B>
void geometry_at(const B& backend, const GuidanceMesh<T, E>& mesh, const AvatarConfig& config,
                 const Columns<T>& points, GeometryTrace<T>& trace) {
    encode_points<detail::EncodingOf<E>>(backend, points, config.frequencies, trace.code);
    trace.output = mlp_forward<T>(backend, mesh.geometry, trace.code, VecX<T>(), &trace.mlp);
    detail::squash_in_place(backend, Squash::tanh, trace.output);
}

/// The geometry at some points, and the cotangents of its outputs.
template <class T>
struct GeometryCotangent {
    const GeometryTrace<T>& trace; ///< of geometry_at
    const Columns<T>& output;      ///< cotangent of trace.output, (4 + F) x N
};

/// Accumulates network gradients, and the cotangent of the points in `g_points`, if not null.
template <class T, EffectSet E, Backend B>
void geometry_vjp(const B& backend, const GuidanceMesh<T, E>& mesh, const AvatarConfig& config,
                  const std::type_identity_t<GeometryCotangent<T>>& g, GuidanceMesh<T, E>& grad,
                  std::type_identity_t<Columns<T>>* g_points = nullptr) {
    const GeometryTrace<T>& trace = g.trace;
    Columns<T> g_output = g.output;
    detail::squash_vjp(backend, Squash::tanh, trace.output, g_output);
    Columns<T> g_code;
    mlp_vjp<T>(backend, mesh.geometry, {trace.code, VecX<T>(), trace.mlp}, g_output,
               {.params = grad.geometry, .points = g_points != nullptr ? &g_code : nullptr});
    if (g_points != nullptr)
        encode_points_vjp<detail::EncodingOf<E>>(backend, trace.code, g_code, config.frequencies,
                                                 *g_points);
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

namespace detail {

/// Lattice vertices whose code is held at once, to bound the memory of a fine lattice.
inline constexpr Index signed_distance_block = 32768;

/// signed_distances by codes in blocks and mlp_forward.
template <class T, EffectSet E, Backend B>
Columns<T> signed_distances_by_blocks(const B& backend, const GuidanceMesh<T, E>& mesh,
                                      const AvatarConfig& config, const Columns<T>& points) {
    Columns<T> sdf(1, points.cols()), code;
    for (Index b = 0; b < sdf.cols(); b += signed_distance_block) {
        const Index count = std::min(signed_distance_block, sdf.cols() - b);
        const Columns<T> block = points.middleCols(b, count);
        encode_points<EncodingOf<E>>(backend, block, config.frequencies, code);
        sdf.middleCols(b, count) =
            mlp_forward<T>(backend, mesh.geometry, code, VecX<T>(), nullptr).topRows(1);
    }
    return sdf;
}

} // namespace detail

/// Signed distances before tanh at points of the head frame (3 x N), without a trace, 1 x N. A
/// backend whose networks run elsewhere has an overload (avatar/cuda/offload.hpp).
template <class T, EffectSet E, Backend B>
Columns<T> signed_distances(const B& backend, const GuidanceMesh<T, E>& mesh,
                            const AvatarConfig& config, const Columns<T>& points) {
    return detail::signed_distances_by_blocks(backend, mesh, config, points);
}

/// The surface of signed distance 0 in the lattice, in the head frame, with each vertex's features.
template <class T, EffectSet E, Backend B>
NeutralSurface<T> neutral_surface(const B& backend, const GuidanceMesh<T, E>& mesh,
                                  const AvatarConfig& config, const TetGrid<T>& grid) {
    using std::tanh;
    NeutralSurface<T> n;
    const Columns<T> sdf = signed_distances(backend, mesh, config, grid.vertices);
    const SurfaceTopology topology =
        surface_topology<T>(backend, grid.topology, sdf); // sign of tanh(s) = s
    if (topology.faces.empty()) return n;
    const std::vector<Index> touched = detail::touched_vertices(topology);
    const Columns<T> rest = pick_columns(grid.vertices, touched);
    geometry_at(backend, mesh, config, rest, n.geometry);
    n.sdf = n.geometry.output.topRows(1);
    const T reach = T(config.vertex_offset);
    n.lattice = rest + n.geometry.output.middleRows(1, 3).unaryExpr([&](const T& o) {
        return T(reach * tanh(o));  // a second tanh, as GHA's code has it
    });
    n.lattice_feature = n.geometry.output.bottomRows(config.feature);
    n.surface.topology = detail::over_touched(topology, touched);
    n.surface.fraction = detail::crossing_fractions<T>(n.surface.topology, n.sdf);
    n.surface.positions =
        interpolate<T>(backend, n.surface.topology, n.surface.fraction, n.lattice);
    n.feature =
        interpolate<T>(backend, n.surface.topology, n.surface.fraction, n.lattice_feature);
    return n;
}

namespace detail {

/// A neutral surface, and the cotangents of its vertices.
template <class T>
struct NeutralCotangent {
    const NeutralSurface<T>& neutral;
    const Columns<T>& positions; ///< 3 x M
    const Columns<T>& feature;   ///< F x M
};

} // namespace detail

/// Adds the gradient of the geometry network, given those of the neutral surface's vertices.
template <class T, EffectSet E, Backend B>
void neutral_surface_vjp(const B& backend, const GuidanceMesh<T, E>& mesh,
                         const AvatarConfig& config,
                         const std::type_identity_t<detail::NeutralCotangent<T>>& cotangent,
                         GuidanceMesh<T, E>& grad) {
    using std::tanh;
    const NeutralSurface<T>& n = cotangent.neutral;
    const SurfaceGradient<T> g =
        surface_vjp<T>(backend, n.surface, {n.lattice, n.sdf, n.lattice_feature},
                       {cotangent.positions, cotangent.feature});
    Columns<T> g_output(n.geometry.output.rows(), n.geometry.output.cols());
    const T reach = T(config.vertex_offset);
    g_output.topRows(1) = g.sdf;
    g_output.middleRows(1, 3) =
        g.vertices.cwiseProduct(n.geometry.output.middleRows(1, 3).unaryExpr([&](const T& o) {
            const T t = tanh(o);
            return T(reach * (T(1) - t) * (T(1) + t));
        }));
    g_output.bottomRows(config.feature) = g.features;
    geometry_vjp(backend, mesh, config, {n.geometry, g_output}, grad);
}

/// One frame of the guidance mesh.
template <class T, EffectSet E = PaperEffects>
struct PosedMesh : detail::FaceFields<FieldTrace<T>, E> {
    [[no_unique_address]] FrameCode<T, E> code;
    [[no_unique_address]] detail::HeadSlot<T, E> head;
    [[no_unique_address]] Weights<T, E> weights;
    [[no_unique_address]] WeightsTrace<T, E> nearest;
    Columns<T> rest_code, moved;        ///< PE(x), and x after expression and gaze
    Columns<T> moved_code;              ///< PE of the latter, which the head pose's field reads
    Columns<T> color;                   ///< channels x M; the first three are RGB
    Columns<T> canonical;               ///< deformed, head frame, 3 x M
    Columns<T> world;                   ///< 3 x M
};

namespace detail {

/// Colours by expression and head pose are in [0, 1]; the gaze's are added to them.
constexpr Squash mesh_colour_squash(ExpressionField) { return Squash::sigmoid; }
/// The same of the head pose.
constexpr Squash mesh_colour_squash(PoseField) { return Squash::sigmoid; }
/// The same of an eye's gaze.
template <std::size_t eye>
constexpr Squash mesh_colour_squash(GazeField<eye>) { return Squash::none; }

} // namespace detail

/// Colours, then deforms one after the other (expression and gaze, then head pose), then poses.
template <class T, EffectSet E, Backend B>
void pose_mesh(const B& backend, const GuidanceMesh<T, E>& mesh,
               const std::type_identity_t<AvatarFrame<T, E>>& frame,
               const NeutralSurface<T>& neutral, PosedMesh<T, E>& p) {
    const AvatarConfig& config = frame.config;
    const Drivers<T, E>& drivers = frame.drivers;
    const FaceNetworks<T, E>& nets = mesh.networks;
    const Columns<T>& x = neutral.surface.positions;
    const T one = T(1), reach = T(config.deform_scale);
    p.code = frame_code(config, OpticalDrivers<T, E>(drivers)); // no kappa is known yet
    p.weights = face_weights<T>(backend, {config, x, mesh.landmarks}, frame.roles, p.nearest);
    const Weights<T, E>& w = p.weights;
    p.color = Columns<T>::Zero(config.channels, x.cols());
    for_face_fields<E>([&](auto by) {
        add_field(backend, Field{by.color(nets), detail::mesh_colour_squash(by), one},
                  {neutral.feature, by.influence(w), by.code(p.code)}, p.color, by.color(p));
    });
    encode_points<detail::EncodingOf<E>>(backend, x, config.frequencies, p.rest_code);
    p.moved = x;
    for_face_fields<Less<E, PoseResidual>>([&](auto by) {
        add_field(backend, Field{by.deform(nets), Squash::tanh, reach},
                  {p.rest_code, by.influence(w), by.code(p.code)}, p.moved, by.deform(p));
    });
    p.canonical = p.moved;
    if constexpr (has_effect<E, PoseResidual>) {
        encode_points<detail::EncodingOf<E>>(backend, p.moved, config.frequencies, p.moved_code);
        add_field(backend, Field{nets.pose_deform, Squash::tanh, reach},
                  {p.moved_code, w.pose, p.code.pose}, p.canonical, p.pose_deform);
    }
    if constexpr (has_effect<E, HeadPose>) {
        p.head = head_transform(drivers);
        const Mat3<T> scaled = p.head.scale * p.head.rotation;
        p.world = (scaled * p.canonical).colwise() + p.head.translation;
    } else {
        p.world = p.canonical;
    }
}

namespace detail {

/// Extra cotangents of the offset loss: those of the raw outputs of the deformation networks.
template <class T, EffectSet E = PaperEffects>
struct DeformCotangents {
    [[no_unique_address]] Slot<E, Expression, Columns<T>> exp;
    [[no_unique_address]] Slot<E, PoseResidual, Columns<T>> pose;
    [[no_unique_address]] SkinSlot<E, Columns<T>> gaze;
};

/// A posed mesh, and the cotangents of its vertices, colours and deformations.
template <class T, EffectSet E>
struct PosedCotangent {
    const NeutralSurface<T>& neutral;
    const PosedMesh<T, E>& posed;
    const Columns<T>& world;
    const Columns<T>& color;
    const DeformCotangents<T, E>& raw;
};

/// Gradients that pose_mesh_vjp adds to: of networks and landmarks, and of the neutral surface's
/// vertices, which lead to the geometry.
template <class T, EffectSet E>
struct PosedGradients {
    GuidanceMesh<T, E>& mesh;
    Columns<T>& positions;
    Columns<T>& feature;
};

} // namespace detail

/// Adds the gradients of the networks, the neutral positions and the features of a posed mesh.
template <class T, EffectSet E, Backend B>
void pose_mesh_vjp(const B& backend, const GuidanceMesh<T, E>& mesh, const AvatarConfig& config,
                   const std::type_identity_t<detail::PosedCotangent<T, E>>& cotangent,
                   const std::type_identity_t<detail::PosedGradients<T, E>>& gradients) {
    const NeutralSurface<T>& neutral = cotangent.neutral;
    const PosedMesh<T, E>& p = cotangent.posed;
    const Columns<T>&g_world = cotangent.world, &g_color = cotangent.color;
    [[maybe_unused]] const detail::DeformCotangents<T, E>& g_raw = cotangent.raw;
    GuidanceMesh<T, E>& grad = gradients.mesh;
    Columns<T>&g_positions = gradients.positions, &g_feature = gradients.feature;
    const FaceNetworks<T, E>& nets = mesh.networks;
    FaceNetworks<T, E>& gnets = grad.networks;
    const Columns<T>& x = neutral.surface.positions;
    const T one = T(1), reach = T(config.deform_scale);
    const Weights<T, E>& w = p.weights;
    Weights<T, E> g_w(x.cols());
    Columns<T> g_canonical = g_world;
    if constexpr (has_effect<E, HeadPose>) {
        const Mat3<T> back = p.head.scale * p.head.rotation.transpose();
        g_canonical = back * g_world;
    }
    Columns<T> g_moved = g_canonical;
    Columns<T> g_code = Columns<T>::Zero(p.rest_code.rows(), x.cols());
    if constexpr (has_effect<E, PoseResidual>) {
        field_vjp(backend, Field{nets.pose_deform, Squash::tanh, reach},
                  {w.pose, p.code.pose, p.pose_deform}, g_canonical,
                  {&gnets.pose_deform, &g_code, &g_w.pose, nullptr, &g_raw.pose});
        encode_points_vjp<detail::EncodingOf<E>>(backend, p.moved_code, g_code, config.frequencies,
                                                 g_moved);
        g_code.setZero();
    }
    // In the order that the gradients' sums have always had: each eye's two networks together.
    const auto deform_vjp = [&](auto by, const Columns<T>& g_deform) {
        field_vjp(backend, Field{by.deform(nets), Squash::tanh, reach},
                  {by.influence(w), by.code(p.code), by.deform(p)}, g_moved,
                  {&by.deform(gnets), &g_code, &by.influence(g_w), nullptr, &g_deform});
    };
    const auto color_vjp = [&](auto by) {
        field_vjp(backend, Field{by.color(nets), detail::mesh_colour_squash(by), one},
                  {by.influence(w), by.code(p.code), by.color(p)}, g_color,
                  {&by.color(gnets), &g_feature, &by.influence(g_w)});
    };
    if constexpr (has_effect<E, Expression>) deform_vjp(ExpressionField{}, g_raw.exp);
    for_eyes([&]<std::size_t eye>() {
        if constexpr (detail::skin_follows<E, eye>) {
            deform_vjp(GazeField<eye>{}, of_eye<eye>(g_raw.gaze));
            color_vjp(GazeField<eye>{});
        }
    });
    if constexpr (has_effect<E, Expression>) color_vjp(ExpressionField{});
    if constexpr (has_effect<E, PoseResidual>) color_vjp(PoseField{});
    encode_points_vjp<detail::EncodingOf<E>>(backend, p.rest_code, g_code, config.frequencies,
                                             g_moved);
    g_positions += g_moved;
    face_weights_vjp<T>(backend, {config, x, mesh.landmarks}, p.nearest, g_w,
                        {g_positions, &grad.landmarks});
}

} // namespace rye
