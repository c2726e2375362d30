// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/two_stream.hpp: the whole avatar: face stream, eyeball stream, upsampler, and a small
/// correction of each frame's head pose.
/// Source: paper fig. 2 and section 3.2.
#pragma once

#include <rye/avatar/eye_stream.hpp>
#include <rye/avatar/face_stream.hpp>
#include <rye/nn/upsampler.hpp>

namespace rye {

template <class T>
struct TwoStream {
    FaceStream<T> face;
    EyeStream<T> eyes;
    Upsampler<T> upsampler;
    Columns<T> delta_pose;  ///< 6 x training frames, added to the tracked pose

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        nested_fields<FaceStream<T>>("face", f, p.face...);
        nested_fields<EyeStream<T>>("eyes", f, p.eyes...);
        nested_fields<Upsampler<T>>("upsampler", f, p.upsampler...);
        f("delta_poses", p.delta_pose...);
    }
    template <class F, class... P>
    static void buffers(F&& f, P&&... p) {
        FaceStream<T>::buffers([&](const std::string& n, auto&&... a) { f("face." + n, a...); },
                               p.face...);
        EyeStream<T>::buffers([&](const std::string& n, auto&&... a) { f("eyes." + n, a...); },
                              p.eyes...);
    }
};

template <class T>
struct TwoStreamTrace {
    FrameCode<T> code;
    HeadTransform<T> head;
    FaceTrace<T> face;
    EyeTrace<T> eyes;
    Gaussians<T> driven_face;  ///< head frame
    Gaussians<T> world_face;   ///< world
    Gaussians<T> world_eyes;   ///< world
};

/// Both clouds, the face's columns first.
template <class T>
Gaussians<T> joined(const Gaussians<T>& a, const Gaussians<T>& b) {
    Gaussians<T> g;
    Gaussians<T>::fields([](const std::string&, auto& out, const auto& x, const auto& y) {
        out.resize(x.rows(), x.cols() + y.cols());
        out << x, y;
    }, g, a, b);
    return g;
}

/// Columns [begin, begin + n) of every field.
template <class T>
Gaussians<T> part(const Gaussians<T>& all, Index begin, Index n) {
    Gaussians<T> g;
    Gaussians<T>::fields([&](const std::string&, auto& out, const auto& x) {
        out = x.middleCols(begin, n);
    }, g, all);
    return g;
}

/// The driven Gaussians of both streams, in trace.world_face and trace.world_eyes.
template <Backend B, class T>
void drive(const TwoStream<T>& avatar, const AvatarConfig& config, const LandmarkRoles& roles,
           const Drivers<T>& drivers, TwoStreamTrace<T>& trace) {
    trace.code = frame_code(config, drivers);
    trace.head = head_transform(drivers);
    trace.driven_face = face_gaussians<B, T>(avatar.face, config, roles, trace.code, trace.face);
    trace.world_face = trace.driven_face;
    to_world<B>(trace.head, trace.world_face);
    trace.world_eyes = eye_gaussians<B, T>(avatar.eyes, config, drivers, trace.head, trace.code,
                                           trace.eyes);
}

/// Accumulates parameter gradients (all but the upsampler's) from world cotangents, which are
/// consumed. Returns the cotangent of the pose.
template <Backend B, class T>
Vec<T, 6> drive_vjp(const TwoStream<T>& avatar, const AvatarConfig& config,
                    const Drivers<T>& drivers, const TwoStreamTrace<T>& trace, Gaussians<T>& g_face,
                    Gaussians<T>& g_eyes, TwoStream<T>& grad) {
    HeadTransformGradient<T> g_head = to_world_vjp<B>(trace.head, trace.world_face, g_face);
    g_head += to_world_vjp<B>(trace.head, trace.world_eyes, g_eyes);
    VecX<T> g_pose_code = VecX<T>::Zero(trace.code.pose.size());
    face_vjp<B>(avatar.face, config, trace.code, trace.face, trace.driven_face, g_face, grad.face,
                g_pose_code);
    eye_vjp<B>(avatar.eyes, config, trace.head, trace.eyes, trace.world_eyes, g_eyes, grad.eyes,
               g_pose_code);
    Vec<T, 6> g_pose = head_pose_vjp(drivers, g_head);
    g_pose += positional_encoding_vjp(trace.code.pose, g_pose_code, config.pose_frequencies);
    return g_pose;
}

} // namespace rye
