// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/two_stream.hpp: the whole avatar: face stream, eyeball stream, upsampler, and a small
/// correction of each frame's head pose.
/// Source: paper fig. 2 and section 3.2.
#pragma once

#include <algorithm>

#include <rye/avatar/eye_stream.hpp>
#include <rye/avatar/face_stream.hpp>
#include <rye/avatar/own_effects.hpp>
#include <rye/nn/upsampler.hpp>

namespace rye {

template <class T, EffectSet E = PaperEffects>
struct TwoStream : OwnParameters<T, E> {
    FaceStream<T, E> face;
    EyeStream<T, E> eyes;
    Upsampler<T> upsampler;
    /// 6 x training frames, added to the tracked pose.
    [[no_unique_address]] Slot<E, ReadsHeadPose, Columns<T>> delta_pose;

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        if constexpr (has_own_effects<E>) OwnParameters<T, E>::fields(f, p...);
        nested_fields<FaceStream<T, E>>("face", f, p.face...);
        nested_fields<EyeStream<T, E>>("eyes", f, p.eyes...);
        nested_fields<Upsampler<T>>("upsampler", f, p.upsampler...);
        if constexpr (has_effect<E, ReadsHeadPose>) f("delta_poses", p.delta_pose...);
    }
    template <class F, class... P>
    static void buffers(F&& f, P&&... p) {
        FaceStream<T, E>::buffers([&](const std::string& n, auto&&... a) { f("face." + n, a...); },
                                  p.face...);
        EyeStream<T, E>::buffers([&](const std::string& n, auto&&... a) { f("eyes." + n, a...); },
                                 p.eyes...);
    }
};

template <class T, EffectSet E = PaperEffects>
struct TwoStreamTrace {
    [[no_unique_address]] FrameCode<T, E> code;
    [[no_unique_address]] HeadSlot<T, E> head;
    [[no_unique_address]] FaceTrace<T, E> face;
    [[no_unique_address]] EyeTrace<T, E> eyes;
    Gaussians<T> driven_face;  ///< head frame
    Gaussians<T> world_face;   ///< world
    Gaussians<T> world_eyes;   ///< world
};

/// Both clouds, the face's columns first.
template <class T>
Gaussians<T> concat(const Gaussians<T>& a, const Gaussians<T>& b) {
    Gaussians<T> g;
    Gaussians<T>::fields([](const std::string&, auto& out, const auto& x, const auto& y) {
        out.resize(x.rows(), x.cols() + y.cols());
        std::copy_n(y.data(), y.size(), std::copy_n(x.data(), x.size(), out.data()));
    }, g, a, b);
    return g;
}

/// Columns [begin, begin + n) of every field.
template <class T>
Gaussians<T> slice(const Gaussians<T>& all, Index begin, Index n) {
    Gaussians<T> g;
    Gaussians<T>::fields([&](const std::string&, auto& out, const auto& x) {
        out.resize(x.rows(), n);
        std::copy_n(x.data() + begin * x.rows(), out.size(), out.data());
    }, g, all);
    return g;
}

/// The driven Gaussians of both streams, in trace.world_face and trace.world_eyes. Without a head
/// pose the head's frame is the world.
template <class T, EffectSet E, Backend B>
void drive(const B& backend, const TwoStream<T, E>& avatar, const AvatarConfig& config,
           const LandmarkRoles& roles, const Drivers<T, E>& drivers, TwoStreamTrace<T, E>& trace) {
    const Drivers<T, E>& optical = optical_drivers(avatar.eyes, drivers);
    trace.code = frame_code(config, optical);
    trace.driven_face =
        face_gaussians<T>(backend, avatar.face, config, roles, trace.code, trace.face);
    trace.world_face = trace.driven_face;
    if constexpr (has_own_effects<E>)
        add_own_effects<T, E>(backend, avatar, optical, trace.world_face);
    if constexpr (has_effect<E, HeadPose>) {
        trace.head = head_transform(optical);
        to_world(backend, trace.head, trace.world_face);
        trace.world_eyes = eye_gaussians<T>(backend, avatar.eyes, config, optical, trace.code,
                                            trace.eyes, trace.head);
    } else {
        trace.world_eyes =
            eye_gaussians<T>(backend, avatar.eyes, config, optical, trace.code, trace.eyes);
    }
}

/// Accumulates parameter gradients (all but the upsampler's) from world cotangents, which are
/// consumed. Returns the cotangent of the pose: 0 if nothing reads it.
template <class T, EffectSet E, Backend B>
Vec<T, 6> drive_vjp(const B& backend, const TwoStream<T, E>& avatar, const AvatarConfig& config,
                    const Drivers<T, E>& drivers, const TwoStreamTrace<T, E>& trace,
                    Gaussians<T>& g_face, Gaussians<T>& g_eyes, TwoStream<T, E>& grad) {
    Vec<T, 6> g_pose = Vec<T, 6>::Zero();
    FrameCotangent<T, E> g_frame(trace.code);
    [[maybe_unused]] const auto optics_vjp = [&](const auto&... head) {
        if constexpr (has_effect<E, SeesCornea>)
            eye_optics_vjp<B>(avatar.eyes.optics, drivers, avatar.eyes.position,
                              trace.eyes.optics, g_eyes, grad.eyes.optics, g_frame.optics,
                              head...);
    };
    const auto streams_vjp = [&](const auto&... head) {
        if constexpr (has_own_effects<E>)
            own_effects_vjp<T, E>(backend, avatar, optical_drivers(avatar.eyes, drivers),
                                  trace.driven_face, g_face, grad);
        face_vjp(backend, avatar.face, config, trace.code, trace.face, trace.driven_face, g_face,
                 grad.face, g_frame);
        eye_vjp(backend, avatar.eyes, config, drivers, trace.eyes, trace.world_eyes, g_eyes,
                grad.eyes, g_frame, head...);
    };
    if constexpr (has_effect<E, HeadPose>) {
        HeadTransformGradient<T> g_head =
            to_world_vjp(backend, trace.head, trace.world_face, g_face);
        g_head += to_world_vjp(backend, trace.head, trace.world_eyes, g_eyes);
        optics_vjp(trace.head);
        if constexpr (has_effect<E, SeesCornea>) g_head += g_frame.optics.head;
        g_pose = head_pose_vjp(drivers, g_head);
        streams_vjp(trace.head);
    } else {
        optics_vjp();
        streams_vjp();
    }
    if constexpr (has_effect<E, ReadsPoseCode>)
        g_pose +=
            positional_encoding_vjp(trace.code.pose, g_frame.pose, config.pose_frequencies);
    return g_pose;
}

} // namespace rye
