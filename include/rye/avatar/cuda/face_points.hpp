// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/face_points.hpp: what happens to each Gaussian of a face in device memory after
/// its networks, and before their vjps: activation and the head's motion, by the formulas of
/// avatar/activation.hpp and avatar/head_pose.hpp.
#pragma once

#include <rye/avatar/cuda/frame.hpp>
#include <rye/gaussian/attributes.hpp>
#include <rye/splat/cuda/gaussians.hpp>

namespace rye::detail {

/// Arrays of a face that its points read or add to, in device memory.
struct DeviceFaceArrays {
    float* position;      ///< 3 x N
    float* log_scale;     ///< 3 x N
    float* rotation;      ///< 4 x N
    float* opacity_logit; ///< 1 x N
};

/// The attributes of point i as they are trained, with the networks' steps (8 x N, or null).
struct DeviceRawPoint {
    const DeviceFaceArrays& raw;
    const float* steps;
    Index i;

    RYE_HD float step(int k) const { return steps != nullptr ? steps[8 * i + k] : 0.0F; }
    RYE_HD float scale(int k) const { return drawn_scale(raw.log_scale[3 * i + k] + step(k)); }
    RYE_HD float rotation(int k) const { return raw.rotation[4 * i + k] + step(3 + k); }
    RYE_HD float opacity() const { return drawn_opacity(raw.opacity_logit[i] + step(7)); }
};

/// A mean of the face in the world, given that in the head's frame.
template <EffectSet E>
RYE_HD Vec3<float> mean_of_face([[maybe_unused]] const DeviceFrameState* frame,
                                const Vec3<float>& mean) {
    if constexpr (has_effect<E, HeadPose>) {
        const HeadTransform<float>& head = frame->head;
        const Mat3<float> scaled = head.scale * head.rotation;
        return mean_to_world<float>(head, scaled, mean);
    } else {
        return mean;
    }
}

/// Sets rotation, scale and opacity of face point i, and takes it, with its mean, to the world.
template <EffectSet E>
struct FinishFacePoint {
    static constexpr const char* name = "face, activation and head";
    DeviceFaceArrays raw;
    const float* steps;
    DeviceGaussians<float> to;
    const DeviceFrameState* frame;

    RYE_DEVICE void operator()(Index i) const {
        const DeviceRawPoint p{raw, steps, i};
        Vec3<float> scale(p.scale(0), p.scale(1), p.scale(2));
        Vec4<float> rotation(p.rotation(0), p.rotation(1), p.rotation(2), p.rotation(3));
        if constexpr (has_effect<E, HeadPose>) {
            const HeadTransform<float>& head = frame->head;
            put_column<3>(mean_of_face<E>(frame, column3(to.mean.data, i)), to.mean.data, i);
            rotation = quat_product<float>(head.quaternion, rotation);
            for (int k = 0; k < 3; ++k) scale[k] *= head.scale;
        }
        put_column<3>(scale, to.scale.data, i);
        put_column<4>(rotation, to.rotation.data, i);
        to.opacity.data[i] = p.opacity();
    }
};

/// Lists that may be longer than there was room for.
struct DeviceRooms {
    const std::uint32_t* count;
    std::uint32_t room[4];
    int lists;

    RYE_HD bool exceeded() const {
        for (int k = 0; k < lists; ++k)
            if (count[k] > room[k]) return true;
        return false;
    }
};

/// Takes the cotangents of face point i to the head's frame, in place, and through the activation;
/// sums what the head's transform gets. Where a list had no room the gradient is not a number, so
/// that the step is not taken.
template <EffectSet E>
struct FacePointVjp {
    static constexpr const char* name = "face, activation and head, reverse";
    static constexpr int sums = has_effect<E, HeadPose> ? head_sums : 0;
    DeviceFaceArrays raw, gradient;
    const float* steps;
    float* g_steps; ///< 8 x N, overwritten, or null
    DeviceGaussians<float> world, g;
    const DeviceFrameState* frame;
    DeviceRooms rooms;

    template <class Sums>
    RYE_DEVICE void operator()(Index i, [[maybe_unused]] Sums& sum) const {
        const DeviceRawPoint p{raw, steps, i};
        MovedPoint<float> own{column3(g.mean.data, i), column4(g.rotation.data, i)};
        Vec3<float> g_scale = column3(g.scale.data, i);
        if constexpr (has_effect<E, HeadPose>) {
            const HeadTransform<float>& head = frame->head;
            HeadTransformGradient<float> part;
            part.add(head, {column3(world.mean.data, i), column4(world.rotation.data, i)}, own);
            add_head_sums(part, sum, 0);
            for (int k = 0; k < 3; ++k) g_scale[k] *= head.scale;
        }
        for (int k = 0; k < 3; ++k) g_scale[k] = drawn_scale_vjp<float>(p.scale(k), g_scale[k]);
        const float a = world.opacity.data[i];
        float g_logit = drawn_opacity_vjp<float>(a, 1.0F - a, g.opacity.data[i]);
        if (i == 0 && rooms.exceeded()) g_logit = Limits<float>::nan;
        put_column<3>(own.mean, g.mean.data, i);
        add_column<3>(own.mean, gradient.position, i);
        add_column<3>(g_scale, gradient.log_scale, i);
        add_column<4>(own.rotation, gradient.rotation, i);
        gradient.opacity_logit[i] += g_logit;
        if (g_steps == nullptr) return;
        for (int k = 0; k < 3; ++k) g_steps[8 * i + k] = g_scale[k];
        for (int k = 0; k < 4; ++k) g_steps[8 * i + 3 + k] = own.rotation[k];
        g_steps[8 * i + 7] = g_logit;
    }
};

} // namespace rye::detail
