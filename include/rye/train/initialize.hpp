// SPDX-License-Identifier: Apache-2.0
/// rye/train/initialize.hpp: initial state of each stage: a sphere for stage 1; Gaussians on the
/// neutral surface, in the mouth and on the eyeballs for stage 2.
/// Source: GHA's pre-training and GaussianHeadModule; paper section 4.1, last paragraph.
#pragma once

#include <algorithm>
#include <cmath>

#include <rye/avatar/guidance_mesh.hpp>
#include <rye/avatar/two_stream.hpp>
#include <rye/geometry/neighbours.hpp>
#include <rye/geometry/refine.hpp>
#include <rye/nn/adam.hpp>
#include <rye/rig/eyeball.hpp>
#include <rye/train/lid_margin.hpp>

namespace rye {

/// Fit of the signed distance to a sphere of radius 1, over random points of the cube around it.
template <class T>
struct SphereFit {
    Vec3<T> centre; ///< of sphere and cube [canonical units]
    T half_side;    ///< half a side of the cube [canonical units]
    int steps;      ///< of Adam, with new points in each
    double rate;    ///< of Adam
};

/// Pre-trains the geometry network to a sphere: row 0 of geometry_at's output to the distance from
/// it, positive outside. Targets beyond 1 are out of reach of tanh, and need not be reached.
template <Real T, EffectSet E, Backend B>
void pretrain_sphere(const B& backend, GuidanceMesh<T, E>& mesh, const AvatarConfig& config,
                     const std::type_identity_t<SphereFit<T>>& fit, const Random& random) {
    constexpr Index points = 8192;
    Adam<GuidanceMesh<T, E>> adam(mesh);
    GuidanceMesh<T, E> grad = zeros_like(mesh);
    for (int step = 0; step < fit.steps; ++step) {
        const Random r = random.fork(static_cast<std::uint64_t>(step));
        Columns<T> x(3, points), target(1, points);
        for (Index i = 0; i < x.size(); ++i)
            x(i) = fit.half_side * T(2 * r.uniform(static_cast<std::uint64_t>(i)) - 1);
        target.row(0) = x.colwise().norm().array() - T(1);
        x.colwise() += fit.centre;
        GeometryTrace<T> trace;
        geometry_at(backend, mesh, config, x, trace);
        Columns<T> g = Columns<T>::Zero(trace.output.rows(), points);
        g.row(0) = T(2.0 / points) * (trace.output.row(0) - target.row(0));
        GuidanceMesh<T, E>::fields([](const std::string&, auto& a) { a.setZero(); }, grad);
        geometry_vjp(backend, mesh, config, {trace, g}, grad);
        adam_step(backend, mesh, grad, adam, [&](const std::string& name) {
            return name.starts_with("geo_mlp.") ? fit.rate : 0.0;
        });
    }
}

/// Inputs of initialize_avatar beside the guidance mesh.
template <class T, EffectSet E = PaperEffects>
struct AvatarInit {
    TetGrid<T> grid = {};      ///< may be subdivided once more than stage 1's
    /// Edges of the neutral surface longer than spacing + slope * (distance to the nearest eye or
    /// lip landmark) are halved; spacing 0: none. Canonical units.
    T spacing = T(0), spacing_slope = T(0.1);
    int mouth_points = 3000;
    T lid_margin = T(0); ///< spacing of Gaussians on the lids' margins; 0: none. Canonical units.
    T opacity = T(0.3);
    /// Thickness of the surface's Gaussians along its normal, times their width; 1: round.
    T thickness = T(1);
    T eye_opacity = T(0.9);
    T eye_thickness = T(1); ///< of eyeball Gaussians along the normal, times their width
    std::array<detail::EyeballSourceOf<E>, 2> eyeball =
        {};                     ///< shapes about their centres, canonical units
    Columns<T> eye_centre = {}; ///< neutral, canonical, 3 x 2
    UpsamplerShape upsampler = {};
    Index frames = 0;          ///< training frames, for delta_pose
};

namespace detail {

/// Bound of a feature: a saturated tanh would need an infinite input; this keeps it below 6.2.
inline constexpr double max_initial_feature = 1 - 1e-5;

} // namespace detail

/// Returns points in the mouth, where the neutral surface has none: uniform in a box around the
/// lips. lips: their landmarks, 3 x K. Source: GHA, 1.6 times the lips' extent.
template <Real T>
Columns<T> mouth_points(const Columns<T>& lips, int count, const Random& random) {
    Vec3<T> centre = lips.rowwise().mean();
    centre.z() = lips.row(2).minCoeff();
    const Vec3<T> extent = (lips.colwise() - centre).cwiseAbs().rowwise().maxCoeff();
    Columns<T> x(3, count);
    for (Index i = 0; i < count; ++i)
        for (Index a = 0; a < 3; ++a)
            x(a, i) =
                centre(a) +
                T(1.6) * extent(a) * T(random.uniform(static_cast<std::uint64_t>(3 * i + a)) - 0.5);
    return x;
}

namespace detail {

/// Bound on edges: those longer than spacing + slope * (distance to the nearest landmark) are
/// halved.
template <class T>
struct EdgeBound {
    T spacing, slope;
};

/// Refines the neutral surface around eyes and lips, where a coarse one could neither open nor
/// close.
template <Real T>
void refine_at_landmarks(const Columns<T>& landmarks, const EdgeBound<T>& bound,
                         TriangleMesh<T>& mesh, Columns<T>& feature) {
    constexpr int passes = 6;  // 1/64 of the longest edge
    refine(
        mesh, feature,
        [&](const Vec3<T>& x) -> T {
            return bound.spacing +
                   bound.slope * std::sqrt(nearest_landmark<T>(x, landmarks).squared);
        },
        passes);
}

} // namespace detail

/// Moves points that lie in an eyeball to just outside it: lids that start inside could only be
/// seen through a transparent eye.
template <Real T>
void leave_eyeball(const Columns<T>& eyeball, const Vec3<T>& centre, Columns<T>& points) {
    const T reach = T(1.03) * std::sqrt(eyeball.colwise().squaredNorm().maxCoeff());
    for (Index i = 0; i < points.cols(); ++i) {
        const Vec3<T> d = points.col(i) - centre;
        const T r = d.norm();
        if (r < reach && r > T(0)) points.col(i) = centre + (reach / r) * d;
    }
}

/// Initial points of the face's Gaussians.
template <class T>
struct FacePoints {
    TriangleMesh<T> surface; ///< neutral, refined, outside the eyeballs
    Columns<T> feature;      ///< features of its vertices
    Columns<T> mouth;        ///< points in the mouth, which follow the vertices, 3 x M
    Columns<T> margin;       ///< lid_margin_points outside the eyeballs, which follow these, 3 x L
    Columns<T> margin_normals; ///< unit, from the eyeballs' centres, 3 x L
    std::array<EyeballTemplate<T>, 2> eyeball;

    /// Returns all points, in the order of the face's Gaussians, 3 x N.
    Columns<T> positions() const {
        Columns<T> p(3, surface.vertices.cols() + mouth.cols() + margin.cols());
        p << surface.vertices, mouth, margin;
        return p;
    }
    /// Returns the unit normals of all points, 3 x N; +z in the mouth.
    Columns<T> normals() const {
        Columns<T> n(3, surface.vertices.cols() + mouth.cols() + margin.cols());
        n << detail::vertex_normals(surface.vertices, surface.faces),
            Vec3<T>(T(0), T(0), T(1)).replicate(1, mouth.cols()), margin_normals;
        return n;
    }
};

/// Returns the points of initialize_avatar with the same arguments. Throws an Error if the guidance
/// mesh has no surface.
template <Real T, EffectSet E, Backend B>
FacePoints<T> face_points(const B& backend, const GuidanceMesh<T, E>& mesh,
                          const AvatarConfig& config, const AvatarInit<T, E>& init,
                          const Random& random) {
    const NeutralSurface<T> neutral = neutral_surface(backend, mesh, config, init.grid);
    require(!neutral.empty(), "initialize_avatar",
            "the guidance mesh of stage 1 has no surface (its signed distance has one sign "
            "everywhere), expected a head; check units and head pose with `rye info`, or train "
            "stage 1 for longer");
    FacePoints<T> points{
        {neutral.surface.positions, neutral.surface.topology.faces},
        neutral.feature,
        {},
        Columns<T>(3, 0),
        Columns<T>(3, 0),
        {eyeball_template<T>(init.eyeball[0]), eyeball_template<T>(init.eyeball[1])}};
    // Eyes and lips are landmarks 36 to 47 and 48 to 65 of GHA's numbering.
    if (init.spacing > T(0))
        detail::refine_at_landmarks<T>(mesh.landmarks.middleCols(36, 30),
                                       {init.spacing, init.spacing_slope}, points.surface,
                                       points.feature);
    for (Index eye = 0; eye < 2; ++eye)
        leave_eyeball<T>(points.eyeball[static_cast<std::size_t>(eye)].points,
                         init.eye_centre.col(eye), points.surface.vertices);
    points.mouth =
        mouth_points<T>(mesh.landmarks.middleCols(48, 18), init.mouth_points, random.fork(21));
    if (init.lid_margin > T(0)) {
        const LidMargin<T> lids =
            lid_margin_points<T>(mesh.landmarks, init.eye_centre, init.lid_margin);
        points.margin = lids.points;
        points.margin_normals = lids.points;
        for (Index eye = 0; eye < 2; ++eye) {
            const Index first = eye == 0 ? 0 : lids.left, count = lids.points_of(eye);
            const Vec3<T> centre = init.eye_centre.col(eye);
            Columns<T> of_eye = lids.points.middleCols(first, count);
            leave_eyeball<T>(points.eyeball[static_cast<std::size_t>(eye)].points, centre, of_eye);
            points.margin.middleCols(first, count) = of_eye;
            points.margin_normals.middleCols(first, count) =
                (of_eye.colwise() - centre).colwise().normalized();
        }
    }
    return points;
}

/// Makes the first `count` Gaussians of a face discs of that thickness, times their width, across
/// their normals, 3 x N.
template <Real T, EffectSet E>
void flatten(const Columns<T>& normals, Index count, std::type_identity_t<T> thickness,
             FaceStream<T, E>& face) {
    face.log_scale.row(2).leftCols(count).array() += std::log(thickness);
    for (Index i = 0; i < count; ++i)
        face.rotation.col(i) = shortest_arc(Vec3<T>(0, 0, 1), Vec3<T>(normals.col(i)));
}

/// Returns the initial avatar of stage 2, with the points that face_points returns for the same
/// arguments.
template <Real T, EffectSet E, Backend B>
TwoStream<T, E> initialize_avatar(const B& backend, const GuidanceMesh<T, E>& mesh,
                                  const AvatarConfig& config, const AvatarInit<T, E>& init,
                                  const Random& random, const FacePoints<T>& points_of_face) {
    const Columns<T>& surface = points_of_face.surface.vertices;
    const Columns<T>& feature = points_of_face.feature;
    const std::array<EyeballTemplate<T>, 2>& eyeball = points_of_face.eyeball;

    TwoStream<T, E> a;
    FaceStream<T, E>& f = a.face;
    f.position = points_of_face.positions();
    const Index n = f.position.cols(), lids = points_of_face.margin.cols();
    if constexpr (has_effect<E, FaceDrivers>) {
        f.feature = Columns<T>::Zero(config.feature, n);
        f.feature.leftCols(surface.cols()) = feature.unaryExpr([](const T& v) {
            const T limit = T(detail::max_initial_feature);
            return T(std::atanh(std::clamp(v, -limit, limit)));
        });
        if (lids > 0) { // the first colour and motion of the skin beside them
            const detail::PointGrid<T> skin(surface);
            for (Index k = n - lids; k < n; ++k)
                f.feature.col(k) =
                    f.feature.col(skin.template nearest<1>(f.position.col(k))[0]).eval();
        }
        f.landmarks = mesh.landmarks;
    }
    if constexpr (face_rests<E>) f.rest_color = Columns<T>::Zero(config.channels, n);
    // Those of the skin are as large as without any on the margins, so that it has no holes.
    const Columns<T> d2 =
        mean_squared_neighbour_distance<T>(backend, f.position.leftCols(n - lids));
    f.log_scale.resize(3, n);
    f.log_scale.leftCols(n - lids) = d2.unaryExpr([](const T& v) {
                                           return T(0.5) * std::log(std::max(v, T(1e-7)));
                                       }).replicate(3, 1);
    if (lids > 0) f.log_scale.rightCols(lids).setConstant(std::log(init.lid_margin));
    f.rotation = Columns<T>::Zero(4, n);
    f.rotation.row(0).setOnes();
    if (init.thickness < T(1))
        flatten(points_of_face.normals(), surface.cols(), init.thickness, f);
    f.opacity_logit = Columns<T>::Constant(1, n, logit(init.opacity));
    f.networks = mesh.networks;
    [[maybe_unused]] const auto attributes = [&](int frame_inputs, const std::vector<int>& hidden,
                                                 int key) {
        return driven_mlp<T, detail::NetworksOf<E>>(
            config, mlp_shape(config.feature, frame_inputs, hidden, 8),
            random.fork(static_cast<std::uint64_t>(key)));
    };
    if constexpr (has_effect<E, Expression>)
        f.exp_attributes = attributes(config.expression, config.networks.exp_attributes, 22);
    if constexpr (has_effect<E, PoseResidual>)
        f.pose_attributes = attributes(config.pose_code<detail::NetworksOf<E>>(),
                                       config.networks.pose_attributes, 23);

    EyeStream<T, E>& e = a.eyes;
    // Two eyes of different shapes may have different numbers of points.
    const Index left = eyeball[0].points.cols();
    const Index points = left + eyeball[1].points.cols();
    e.left_points = left;
    e.position.resize(3, points);
    e.position << eyeball[0].points, eyeball[1].points;
    e.centre = init.eye_centre;
    e.appearance() = init_eye_appearance<EyeAppearanceOf<E>, T>(
        appearance_sizes<E>(config, points), random.fork(24));
    e.mechanism() = GazeMechanismOf<E>::template init<GazeMechanismParameters<T, E>>(
        config.channels, random.fork(26));
    e.spacing.resize(1, points);
    e.spacing << eyeball[0].spacing, eyeball[1].spacing;
    e.spacing = e.spacing.cwiseMax(T(1e-4));
    e.log_scale = e.spacing.array().log().replicate(3, 1);
    e.log_scale.row(2).array() += std::log(init.eye_thickness);
    e.rotation.resize(4, points);
    for (Index i = 0; i < points; ++i) {
        const Vec3<T> normal = i < left ? eyeball[0].normals.col(i)
                                        : eyeball[1].normals.col(i - left);
        e.rotation.col(i) = shortest_arc(Vec3<T>(0, 0, 1), normal);
    }
    e.opacity_logit = Columns<T>::Constant(1, points, logit(init.eye_opacity));
    e.offset = mesh.eye_offset;
    if constexpr (has_effect<E, Kappa>) e.kappa = Columns<T>::Zero(2, 2);

    a.upsampler = detail::UpsamplerOf<T, E>::init(init.upsampler, random.fork(25));
    if constexpr (has_effect<E, ReadsHeadPose>)
        a.delta_pose = Columns<T>::Zero(6, std::max<Index>(init.frames, 1));
    if constexpr (has_effect<E, HeadShading>)
        a.shading = initial_shading<T>(points_of_face.normals());
    return a;
}

/// Returns the initial avatar of stage 2. Throws an Error if the guidance mesh has no surface.
template <Real T, EffectSet E, Backend B>
TwoStream<T, E> initialize_avatar(const B& backend, const GuidanceMesh<T, E>& mesh,
                                  const AvatarConfig& config, const AvatarInit<T, E>& init,
                                  const Random& random) {
    return initialize_avatar(backend, mesh, config, init, random,
                             face_points(backend, mesh, config, init, random));
}

} // namespace rye
