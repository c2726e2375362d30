// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/two_stream.hpp: the whole avatar: face stream, eyeball stream, upsampler, and small
/// corrections of each frame's head pose and gazes, and of each camera's pose.
/// Source: paper fig. 2 and section 3.2.
#pragma once

#include <rye/avatar/eye_stream.hpp>
#include <rye/avatar/face_stream.hpp>
#include <rye/avatar/head_shading.hpp>
#include <rye/avatar/own_effects.hpp>
#include <rye/avatar/view_color.hpp>

namespace rye {

/// Trained parameters of an avatar: its face, its eyes, its upsampler, corrections of the tracked
/// head poses and gazes and of cameras, its shading, its colours by the view,
/// and those of own effects.
template <class T, EffectSet E = PaperEffects>
struct TwoStream : OwnParameters<T, E> {
    FaceStream<T, E> face;
    EyeStream<T, E> eyes;
    detail::UpsamplerOf<T, E> upsampler;
    /// 6 x training frames, added to the tracked pose.
    [[no_unique_address]] detail::Slot<E, ReadsHeadPose, Columns<T>> delta_pose;
    /// 4 x training frames, or empty: added to the angles of the tracked gazes, (pitch, yaw) of the
    /// left eye, then of the right [rad]. Needs eyes.kappa, which may be 0.
    [[no_unique_address]] detail::Slot<E, Kappa, Columns<T>> delta_gaze;
    /// 6 x cameras, or empty: how the head is moved in the pictures of each camera, by an
    /// axis-angle about a common point and a translation, in the world. A camera whose pose is
    /// wrong by the inverse motion shows the same.
    [[no_unique_address]] detail::Slot<E, HeadPose, Columns<T>> delta_view;
    [[no_unique_address]] detail::Slot<E, HeadShading, Shading<T>> shading;
    [[no_unique_address]] detail::Slot<E, ViewColor, ViewColors<T>> view_color;

    /// True if colours depend on where they are seen from.
    bool has_view_color() const {
        if constexpr (has_effect<E, ViewColor>) return view_color.any();
        return false;
    }

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        if constexpr (has_own_effects<E>) OwnParameters<T, E>::fields(f, p...);
        detail::nested_fields<FaceStream<T, E>>("face", f, p.face...);
        detail::nested_fields<EyeStream<T, E>>("eyes", f, p.eyes...);
        detail::nested_fields<detail::UpsamplerOf<T, E>>("upsampler", f, p.upsampler...);
        if constexpr (has_effect<E, ReadsHeadPose>) f("delta_poses", p.delta_pose...);
        if constexpr (has_effect<E, Kappa>)
            if (((p.delta_gaze.size() > 0) || ...)) f("delta_gazes", p.delta_gaze...);
        if constexpr (has_effect<E, HeadPose>)
            if (((p.delta_view.size() > 0) || ...)) f("delta_views", p.delta_view...);
        if constexpr (has_effect<E, HeadShading>)
            detail::nested_fields<Shading<T>>("shading", f, p.shading...);
        if constexpr (has_effect<E, ViewColor>)
            detail::nested_fields<ViewColors<T>>("view_color", f, p.view_color...);
    }
    template <class F, class... P>
    static void buffers(F&& f, P&&... p) {
        FaceStream<T, E>::buffers([&](const std::string& n, auto&&... a) { f("face." + n, a...); },
                                  p.face...);
        EyeStream<T, E>::buffers([&](const std::string& n, auto&&... a) { f("eyes." + n, a...); },
                                 p.eyes...);
    }
};

namespace detail {

/// Throws an Error unless delta_gaze is empty, or has a column for each of delta_pose's beside a
/// kappa; and unless delta_view is empty or has 6 rows.
template <class T, EffectSet E>
void check_corrections([[maybe_unused]] const TwoStream<T, E>& avatar,
                       [[maybe_unused]] const char* who) {
    if constexpr (has_effect<E, HeadPose>)
        require(avatar.delta_view.size() == 0 || avatar.delta_view.rows() == 6, who,
                "delta_view has ", avatar.delta_view.rows(), " rows, expected 6");
    if constexpr (has_effect<E, Kappa>) {
        const Columns<T>& gaze = avatar.delta_gaze;
        if (gaze.size() == 0) return;
        Index frames = gaze.cols();
        if constexpr (has_effect<E, ReadsHeadPose>) frames = avatar.delta_pose.cols();
        require(gaze.rows() == 4 && gaze.cols() == frames, who, "delta_gaze is ", gaze.rows(),
                " x ", gaze.cols(), ", expected 4 x ", frames);
        require(avatar.eyes.kappa.size() > 0, who, "delta_gaze needs a kappa, which may be 0");
    }
}

} // namespace detail

/// Driven Gaussians in the world: the face's columns first, then the eyes'.
template <class T>
struct TwoStreamGaussians {
    Gaussians<T> gaussians;
    Index face_count = 0;

    detail::ColumnRange face_columns() const { return {0, face_count}; }
    detail::ColumnRange eye_columns() const { return {face_count, gaussians.count() - face_count}; }
    GaussianView<T> face_gaussians() const { return view_of(gaussians).columns(0, face_count); }
    GaussianView<T> eye_gaussians() const {
        return view_of(gaussians).columns(face_count, eye_columns().count);
    }
};

/// Driven Gaussians, and what their vjp reads.
template <class T, EffectSet E = PaperEffects>
struct TwoStreamTrace : TwoStreamGaussians<T> {
    [[no_unique_address]] FrameCode<T, E> code;
    [[no_unique_address]] detail::HeadSlot<T, E> head;
    [[no_unique_address]] FaceTrace<T, E> face;
    [[no_unique_address]] EyeTrace<T, E> eyes;
    [[no_unique_address]] OwnTrace<T, E> own;
    [[no_unique_address]] detail::Slot<E, HeadShading, ShadingTrace<T>> shading;
};

namespace detail {

/// The frame as the avatar's shading reads it.
template <class T, EffectSet E>
    requires has_effect<E, HeadShading>
ShadedFrame<T> shaded_frame(const TwoStream<T, E>& avatar, const Drivers<T, E>& drivers) {
    return {drivers.pose.template head<3>(), avatar.face.position.cols(),
            avatar.eyes.points_of(0)};
}

/// The head of a driven frame before its camera.
template <class T, EffectSet E>
    requires has_effect<E, ViewColor>
SeenHead<T> seen_head_of(const Drivers<T, E>& drivers, const TwoStreamTrace<T, E>& trace) {
    if constexpr (has_effect<E, HeadPose>)
        return seen_head_of(drivers, trace.head);
    else
        return seen_head_of(drivers);
}

/// The transform by which delta_view moves a picture's head; the column must be there.
template <class T, EffectSet E>
    requires has_effect<E, HeadPose>
HeadTransform<T> view_transform(const TwoStream<T, E>& avatar, Index column) {
    RYE_ASSERT(column < avatar.delta_view.cols(), "view_transform: no such column of delta_view");
    return head_transform<T>(avatar.delta_view.col(column), T(1));
}

} // namespace detail

/// Drives both streams: the Gaussians are trace.gaussians. Without a head pose the head's frame is
/// the world.
template <class T, EffectSet E, Backend B>
void drive(const B& backend, const TwoStream<T, E>& avatar,
           const std::type_identity_t<AvatarFrame<T, E>>& frame, TwoStreamTrace<T, E>& trace) {
    const auto& [config, roles, drivers, view] = frame;
    const OpticalDrivers<T, E> optical = optical_drivers(avatar.eyes, drivers);
    trace.code = frame_code(config, optical);
    const Index n = trace.face_count = avatar.face.position.cols();
    Gaussians<T>& g = trace.gaussians;
    g.resize(n + avatar.eyes.position.cols(), config.channels);
    face_gaussians<T>(backend, avatar.face, {config, roles, trace.code}, trace.face, g);
    if constexpr (has_own_effects<E>) {
        Columns<T>& scale = detail::head_scale<T, E>(trace.face, g);
        detail::add_own_effects<T, E>(
            backend, avatar, optical.drivers,
            {g.mean.leftCols(n), g.rotation.leftCols(n), scale.leftCols(n), g.opacity.leftCols(n),
             g.feature.leftCols(n)},
            trace.own);
    }
    detail::take_lid_points(avatar.eyes, g.mean, avatar.face.position, trace.eyes.lids);
    if constexpr (has_effect<E, HeadPose>) {
        trace.head = head_transform(optical.drivers);
        if (view.column >= 0)
            trace.head = detail::seen_head(detail::view_transform(avatar, view.column), view.pivot,
                                           trace.head);
        to_world(backend, trace.head, trace.face.scale, g);
        eye_gaussians<T>(backend, avatar.eyes, {config, optical, trace.code}, {trace.eyes, g, n},
                         trace.head);
    } else {
        eye_gaussians<T>(backend, avatar.eyes, {config, optical, trace.code}, {trace.eyes, g, n});
    }
    if constexpr (has_effect<E, ViewColor>)
        if (avatar.has_view_color())
            add_view_colors(backend, avatar.view_color, detail::seen_head_of(drivers, trace), g);
    if constexpr (has_effect<E, HeadShading>)
        shade(backend, avatar.shading, detail::shaded_frame(avatar, drivers), g.feature,
              trace.shading);
}

namespace detail {

/// World cotangents of the Gaussians, which drive_vjp consumes, and the parameters' gradients,
/// which it adds to.
template <class T, EffectSet E>
struct DriveGradients {
    Gaussians<T>& gaussians;
    TwoStream<T, E>& avatar;
};

} // namespace detail

/// Accumulates parameter gradients (all but those of the upsampler, delta_pose and delta_gaze).
/// Returns the cotangent of the pose: 0 if nothing reads it.
template <class T, EffectSet E, Backend B>
Vec<T, 6> drive_vjp(const B& backend, const TwoStream<T, E>& avatar,
                    const std::type_identity_t<AvatarFrame<T, E>>& frame,
                    const TwoStreamTrace<T, E>& trace,
                    const std::type_identity_t<detail::DriveGradients<T, E>>& gradients) {
    const AvatarConfig& config = frame.config;
    const Drivers<T, E>& drivers = frame.drivers;
    Gaussians<T>& g = gradients.gaussians;
    TwoStream<T, E>& grad = gradients.avatar;
    Vec<T, 6> g_pose = Vec<T, 6>::Zero();
    detail::FrameCotangent<T, E> g_frame(trace.code);
    const Index n = trace.face_count;
    [[maybe_unused]] Vec3<T> g_shaded;
    if constexpr (has_effect<E, HeadShading>)
        g_shaded = shade_vjp(
            backend, avatar.shading,
            {detail::shaded_frame(avatar, drivers), trace.gaussians.feature, trace.shading},
            g.feature, grad.shading);
    [[maybe_unused]] Mat3<T> g_view = Mat3<T>::Zero();
    if constexpr (has_effect<E, ViewColor>)
        if (avatar.has_view_color())
            g_view =
                view_colors_vjp(backend, avatar.view_color, detail::seen_head_of(drivers, trace),
                                trace.gaussians.mean, g, grad.view_color);
    [[maybe_unused]] const auto optics_vjp = [&](const auto&... head) {
        // Lids darken what has highlights.
        if constexpr (has_effect<E, LidShadow>)
            detail::eye_lids_vjp(backend, avatar.eyes, trace.eyes.lids,
                                 detail::moved_points(avatar.eyes, trace.eyes.pupils),
                                 {g, n, grad.eyes, grad.face.position, g_frame.lids});
        if constexpr (has_effect<E, SeesCornea>)
            detail::eye_optics_vjp(
                backend, avatar.eyes.optics,
                {drivers.camera, detail::moved_points(avatar.eyes, trace.eyes.pupils),
                 avatar.eyes.points_of(0), trace.eyes.optics},
                {g, n}, {grad.eyes.optics, g_frame.optics}, head...);
    };
    const auto driven = [&]() -> detail::DrivenFace<T, E> {
        if constexpr (has_own_effects<E>)
            return {config, trace.code, trace.face, trace.own.front().scale,
                    trace.own.front().opacity};
        else
            return {config, trace.code, trace.face,
                    detail::head_scale<T, E>(trace.face, trace.gaussians), trace.gaussians.opacity};
    };
    const auto face_part = [&] {
        if constexpr (has_own_effects<E>)
            detail::own_effects_vjp<T, E>(
                backend, avatar, {optical_drivers(avatar.eyes, drivers).drivers, trace.own},
                detail::first_columns(g, n), grad);
        face_vjp(backend, avatar.face, driven(), g, {grad.face, g_frame});
    };
    const DrivenEyes<T, E> eyes{config, drivers, trace.code, trace.eyes, trace.gaussians, n};
    const auto eyes_vjp = [&](const auto& sums) {
        eye_vjp(backend, avatar.eyes, eyes, {g, sums, grad.eyes, g_frame});
    };
    if constexpr (has_effect<E, HeadPose>) {
        HeadTransformGradient<T> g_head =
            to_world_vjp(backend, trace.head, trace.gaussians, trace.face_columns(), g);
        const detail::SumsOfEyes<T, E> sums =
            eye_points_vjp(backend, avatar.eyes, eyes, {g, grad.eyes}, trace.head);
        detail::take_head_sums(std::get<0>(sums).begin(), g_head);
        detail::take_head_sums(std::get<1>(sums).begin(), g_head);
        optics_vjp(trace.head);
        if constexpr (has_effect<E, SeesCornea>) g_head += g_frame.optics.head;
        if constexpr (has_effect<E, ViewColor>) g_head.rotation += g_view;
        if (const auto& [column, pivot] = frame.view; column >= 0) {
            const auto g_seen = detail::seen_head_vjp(detail::view_transform(avatar, column), pivot,
                                                      head_transform(drivers), g_head);
            grad.delta_view.col(column) +=
                head_pose_vjp<T>(avatar.delta_view.col(column), g_seen.view);
            g_head = g_seen.head;
        }
        g_pose = head_pose_vjp(drivers, g_head);
        face_part();
        eyes_vjp(sums);
    } else {
        const detail::SumsOfEyes<T, E> sums =
            eye_points_vjp(backend, avatar.eyes, eyes, {g, grad.eyes});
        optics_vjp();
        face_part();
        eyes_vjp(sums);
    }
    if constexpr (has_effect<E, ReadsPoseCode>)
        g_pose +=
            detail::EncodingOf<E>::vjp(trace.code.pose, g_frame.pose, config.pose_frequencies);
    if constexpr (has_effect<E, HeadShading>) g_pose.template head<3>() += g_shaded;
    if constexpr (detail::eyes_read_pose<E>) g_pose += g_frame.eye_pose;
    return g_pose;
}

} // namespace rye
