// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/drivers.hpp: what a frame is driven by, and its codes as the networks read them.
/// Frames: x_world = S R(pose[0:3]) x_head + pose[3:6] (GHA's convention); gaze is a unit vector in
/// the head frame, +z out of the face; eye 0 is the subject's left.
#pragma once

#include <array>

#include <rye/avatar/config.hpp>
#include <rye/core/columns.hpp>
#include <rye/nn/encoding.hpp>
#include <rye/rig/gaze.hpp>

namespace rye {

template <class T>
struct Drivers {
    VecX<T> expression;            ///< blendshape coefficients
    Vec<T, 6> pose;                ///< axis-angle [rad], translation [world unit]
    T scale = T(1);                ///< S, world units per canonical unit
    std::array<Vec3<T>, 2> gaze;   ///< optical axes, left and right, head frame

    template <class U>
    Drivers<U> cast() const {
        Drivers<U> r;
        r.expression = expression.template cast<U>();
        r.pose = pose.template cast<U>();
        r.scale = U(scale);
        r.gaze = {gaze[0].template cast<U>(), gaze[1].template cast<U>()};
        return r;
    }
};

/// The frame inputs of the networks.
template <class T>
struct FrameCode {
    VecX<T> expression;            ///< raw
    VecX<T> pose;                  ///< encoded, 54 with 4 octaves
    std::array<VecX<T>, 2> gaze;   ///< encoded (pitch, yaw), 18 an eye with 4
};

template <class T>
FrameCode<T> frame_code(const AvatarConfig& config, const Drivers<T>& drivers) {
    FrameCode<T> code;
    code.expression = drivers.expression;
    code.pose = positional_encoding(drivers.pose, config.pose_frequencies);
    for (std::size_t eye = 0; eye < 2; ++eye) {
        const Vec2<T> angles = pitch_yaw(drivers.gaze[eye]);
        code.gaze[eye] = positional_encoding(angles, config.gaze_frequencies);
    }
    return code;
}

} // namespace rye
