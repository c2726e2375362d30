// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/frame.hpp: what drives a frame of an avatar, in device memory: the drivers'
/// numbers, their codes as networks read them, and the head's transform, by the formulas of
/// avatar/drivers.hpp and avatar/head_pose.hpp. Drivers are read on the device, so a captured frame
/// runs again with others.
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include <rye/avatar/cuda/device_effects.hpp>
#include <rye/avatar/eye_stream.hpp>
#include <rye/backend/cuda/each.hpp>
#include <rye/core/bits.hpp>
#include <rye/core/format.hpp>

namespace rye::detail {

/// True if frames have corrections of their poses or gazes.
template <EffectSet E>
inline constexpr bool frames_have_corrections =
    has_effect<E, ReadsHeadPose> || has_effect<E, Kappa>;

/// Places of the numbers of a frame's drivers, one after the other, as far as effects read them:
/// expression, pose, scale, gaze of each eye that turns, its pupil, the camera's centre, the column
/// of delta_pose and delta_gaze, -1 for none, that of delta_view, and its pivot.
template <EffectSet E>
struct DriverPlaces {
    Index expression = 0, pose = 0, scale = 0, gaze[2] = {0, 0}, pupil[2] = {0, 0}, camera = 0,
          column = 0, view = 0, size = 0;

    explicit DriverPlaces(const AvatarConfig& config) {
        const auto next = [&](Index& place, bool present, Index count) {
            place = size;
            if (present) size += count;
        };
        next(expression, has_effect<E, ReadsExpression>, config.expression);
        next(pose, has_effect<E, ReadsHeadPose>, 6);
        next(scale, has_effect<E, HeadPose>, 1);
        next(gaze[0], eye_turns<E, 0>, 3);
        next(gaze[1], eye_turns<E, 1>, 3);
        next(pupil[0], pupil_moves<E, 0>, 1);
        next(pupil[1], pupil_moves<E, 1>, 1);
        next(camera, has_effect<E, ReadsCamera>, 3);
        next(column, frames_have_corrections<E>, 1);
        next(view, has_effect<E, HeadPose>, 4);
    }

    /// The numbers of a frame's drivers; `frame_column` is the frame's in delta_pose and
    /// delta_gaze, -1: none; `seen` the picture's view. Throws an Error for an expression of
    /// another width, and for a gaze without a direction. A camera that is nowhere, which only an
    /// avatar without lights may have, is 0.
    std::vector<float> packed(const Drivers<float, E>& drivers,
                              [[maybe_unused]] Index frame_column,
                              [[maybe_unused]] const SeenBy<float>& seen = {}) const {
        std::vector<float> r(static_cast<std::size_t>(size));
        [[maybe_unused]] const auto put = [&](Index at, const auto& numbers) {
            for (Index k = 0; k < numbers.size(); ++k)
                r[static_cast<std::size_t>(at + k)] = numbers[k];
        };
        if constexpr (has_effect<E, ReadsExpression>) {
            require(drivers.expression.size() == pose - expression, "DeviceTwoStream",
                    "expression has ", drivers.expression.size(),
                    " numbers, the avatar's networks read ", pose - expression);
            put(expression, drivers.expression);
        }
        if constexpr (has_effect<E, ReadsHeadPose>) put(pose, drivers.pose);
        if constexpr (has_effect<E, ReadsCamera>)
            if (drivers.camera.allFinite()) put(camera, drivers.camera);
        if constexpr (frames_have_corrections<E>)
            r[static_cast<std::size_t>(column)] = static_cast<float>(frame_column);
        if constexpr (has_effect<E, HeadPose>) {
            r[static_cast<std::size_t>(scale)] = drivers.scale;
            r[static_cast<std::size_t>(view)] = static_cast<float>(seen.column);
            put(view + 1, seen.pivot);
        }
        for_eyes([&]<std::size_t eye>() {
            if constexpr (eye_turns<E, eye>) {
                static_cast<void>(checked_gaze(of_eye<eye>(drivers.gaze)));
                put(gaze[eye], of_eye<eye>(drivers.gaze));
            }
            if constexpr (pupil_moves<E, eye>)
                r[static_cast<std::size_t>(pupil[eye])] = of_eye<eye>(drivers.pupil);
        });
        for (std::size_t k = 0; k < r.size(); ++k)
            require(std::isfinite(r[k]), "DeviceTwoStream", "number ", k,
                    " of the drivers (expression, pose, scale, "
                    "gazes, pupils) is ",
                    r[k], ", expected a finite one");
        return r;
    }
    /// True where packed drivers of two frames have the same bits but for gazes, pupils and camera.
    bool same_but_gazes(const std::vector<float>& a, const std::vector<float>& b) const {
        bool same = a.size() == b.size();
        for (std::size_t k = 0; same && k < a.size(); ++k) {
            const auto i = static_cast<Index>(k);
            same = (i >= gaze[0] && i < column) || same_bits(a[k], b[k]);
        }
        return same;
    }
};

/// Places of a frame's codes: expression and pose code, which the eye offset reads as one column,
/// then the gaze codes.
template <EffectSet E>
struct CodePlaces {
    Index expression = 0, pose = 0, gaze[2] = {0, 0}, size = 0;

    explicit CodePlaces(const AvatarConfig& config) {
        const auto next = [&](Index& place, bool present, Index count) {
            place = size;
            if (present) size += count;
        };
        next(expression, has_effect<E, ReadsExpression>, config.expression);
        next(pose, has_effect<E, ReadsPoseCode>, encoded_size(6, config.pose_frequencies));
        next(gaze[0], skin_follows<E, 0>, encoded_size(2, config.gaze_frequencies));
        next(gaze[1], skin_follows<E, 1>, encoded_size(2, config.gaze_frequencies));
    }
    Index of(ExpressionField) const { return expression; }
    Index of(PoseField) const { return pose; }
    template <std::size_t eye>
    Index of(GazeField<eye>) const {
        return gaze[eye];
    }
};

/// State of a frame that follows from its drivers, in device memory.
struct DeviceFrameState {
    HeadTransform<float> head; ///< as the picture's view shows it
    EyeTransform<float> eye[2]; ///< to the world
    Quat<float> turn[2];        ///< rest (+z) to gaze
    Vec<float, 6> pose;         ///< with its correction
    Vec3<float> visual[2];      ///< gazes with their correction
    Vec3<float> optical[2];     ///< optical axes, by kappa
    std::uint32_t bad_gaze; ///< a bit an eye whose gaze has no direction
};

/// A frame in device memory.
struct DeviceFrameNumbers {
    const float* drivers;
    float* codes;
    DeviceFrameState* state;
    const float* delta_pose = nullptr; ///< 6 x frames, or null
    const float* kappa = nullptr;      ///< 2 x 2 [rad], or null: gazes are optical axes
    const float* delta_gaze = nullptr; ///< 4 x frames [rad], or null; not without kappa
    const float* delta_view = nullptr; ///< 6 x cameras, or null

    /// The head's transform by the pose, and by the picture's view.
    template <EffectSet E>
    RYE_DEVICE HeadTransform<float> seen(const DriverPlaces<E>& from) const {
        const HeadTransform<float> head = own(from);
        const float column = drivers[from.view];
        if (delta_view == nullptr || column < 0.0F) return head;
        return seen_head<float>(view(column), pivot(from), head);
    }
    /// The cotangent of the pose, given that of seen(). Adds that of the view, 6 x cameras.
    template <EffectSet E>
    RYE_DEVICE Vec<float, 6> seen_vjp(const DriverPlaces<E>& from,
                                      const HeadTransformGradient<float>& g,
                                      float* g_delta_view) const {
        const float column = drivers[from.view];
        if (delta_view == nullptr || column < 0.0F) return head_pose_vjp<float>(state->pose, g);
        const SeenHeadGradient<float> parts =
            seen_head_vjp<float>(view(column), pivot(from), own(from), g);
        const Vec<float, 6> g_view = head_pose_vjp<float>(motion(column), parts.view);
        for (int k = 0; k < 6; ++k) g_delta_view[6 * Index(column) + k] += g_view[k];
        return head_pose_vjp<float>(state->pose, parts.head);
    }

  private:
    template <EffectSet E>
    RYE_DEVICE HeadTransform<float> own(const DriverPlaces<E>& from) const {
        return head_transform<float>(state->pose, drivers[from.scale]);
    }
    RYE_DEVICE Vec<float, 6> motion(float column) const {
        Vec<float, 6> m;
        for (int k = 0; k < 6; ++k) m[k] = delta_view[6 * Index(column) + k];
        return m;
    }
    RYE_DEVICE HeadTransform<float> view(float column) const {
        return head_transform<float>(motion(column), 1.0F);
    }
    template <EffectSet E>
    RYE_DEVICE Vec3<float> pivot(const DriverPlaces<E>& from) const {
        const float* const p = drivers + from.view + 1;
        return Vec3<float>(p[0], p[1], p[2]);
    }
};

/// Codes, the head's transform, and optical axes.
template <EffectSet E>
struct FrameCodesKernel {
    static constexpr const char* name = "codes of a frame";
    static constexpr int threads = 128, blocks = 1;
    struct Shared {};
    DriverPlaces<E> from;
    CodePlaces<E> to;
    int expression, pose_frequencies, gaze_frequencies;
    DeviceFrameNumbers frame;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            if constexpr (has_effect<E, ReadsExpression>)
                for (int k = t; k < expression; k += threads)
                    frame.codes[to.expression + k] = frame.drivers[from.expression + k];
            if (t == 0) frame.state->bad_gaze = 0;
            if constexpr (has_effect<E, ReadsHeadPose>)
                if (t == 0) take_pose();
        });
        block.each_thread([&](int t) {
            if constexpr (has_effect<E, ReadsPoseCode>)
                if (t < 6)
                    encode_number(frame.state->pose[t], pose_frequencies, 6,
                                  frame.codes + to.pose + t);
            if constexpr (has_effect<E, AnyOf<LeftGaze, RightGaze>>)
                if (t == 32) take_gazes();
        });
    }

  private:
    RYE_DEVICE void take_pose() const {
        Vec<float, 6>& pose = frame.state->pose;
        for (int k = 0; k < 6; ++k) pose[k] = frame.drivers[from.pose + k];
        const float column = frame.drivers[from.column];
        if (frame.delta_pose != nullptr && column >= 0.0F)
            for (int k = 0; k < 6; ++k) pose[k] += frame.delta_pose[6 * Index(column) + k];
        if constexpr (has_effect<E, HeadPose>)
            frame.state->head = frame.seen(from);
    }
    RYE_DEVICE void take_gazes() const {
        if constexpr (eye_turns<E, 0>) take_gaze<0>();
        if constexpr (eye_turns<E, 1>) take_gaze<1>();
    }
    template <int eye>
    RYE_DEVICE void take_gaze() const {
        const float* const g = frame.drivers + from.gaze[eye];
        Vec3<float> visual(g[0], g[1], g[2]);
        if constexpr (has_effect<E, Kappa>) {
            const float column = frame.drivers[from.column];
            if (frame.delta_gaze != nullptr && column >= 0.0F)
                visual = corrected_gaze<float>(visual, frame.delta_gaze + 4 * Index(column), eye);
        }
        Vec3<float> optical = visual;
        if constexpr (has_effect<E, Kappa>)
            if (frame.kappa != nullptr)
                optical = apply_kappa<float>(
                    visual, KappaAngles<float>{frame.kappa[2 * eye], frame.kappa[2 * eye + 1]});
        frame.state->visual[eye] = visual;
        frame.state->optical[eye] = optical;
        const float length = norm(optical);
        if (!(length >= 1e-6F) || !(length < Limits<float>::infinity))
            frame.state->bad_gaze |= 1U << eye;
        if constexpr (skin_follows<E, std::size_t(eye)>) {
            const Vec2<float> angles = pitch_yaw(optical);
            for (int k = 0; k < 2; ++k)
                encode_number(angles[k], gaze_frequencies, 2, frame.codes + to.gaze[eye] + k);
        }
    }
};

/// Memory of the sums of a frame's reverse pass: of the head's transform over the face and over
/// each eye, and cotangents of the codes, as CodePlaces has them.
struct DeviceFrameSums {
    const float* face;   ///< head_sums, or null
    const float* eye[2]; ///< head_sums first, or null
    const float* codes;  ///< or null
    float* pose;         ///< 6, overwritten: the cotangent of the pose
    float* delta_pose;   ///< 6 x frames, added to, or null
    float* delta_view;   ///< 6 x cameras, added to, or null
    const float* parts = nullptr; ///< 6: of the pose as shading and features read it, or null
    const float* seen = nullptr;  ///< 9: of the head's rotation as the camera sees it, or null
};

/// The cotangent of the pose.
template <EffectSet E>
struct FramePoseKernel {
    static constexpr const char* name = "pose, reverse";
    static constexpr int threads = 32, blocks = 1;
    struct Shared {};
    DriverPlaces<E> from;
    CodePlaces<E> to;
    int pose_frequencies;
    DeviceFrameNumbers frame;
    DeviceFrameSums sums;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            if (t != 0) return;
            Vec<float, 6> g;
            for (int k = 0; k < 6; ++k) g[k] = 0.0F;
            if constexpr (has_effect<E, HeadPose>) {
                HeadTransformGradient<float> head;
                take_head_sums(sums.face, head);
                for (int eye = 0; eye < 2; ++eye) take_head_sums(sums.eye[eye], head);
                if constexpr (has_effect<E, ViewColor>)
                    if (sums.seen != nullptr)
                        for (int k = 0; k < 9; ++k) head.rotation.data()[k] += sums.seen[k];
                g = frame.seen_vjp(from, head, sums.delta_view);
            }
            if constexpr (has_effect<E, ReadsPoseCode>)
                for (int k = 0; k < 6; ++k)
                    g[k] += encode_number_vjp(frame.codes + to.pose + k, sums.codes + to.pose + k,
                                              pose_frequencies, 6);
            if constexpr (has_effect<E, HeadShading> || eyes_read_pose<E>)
                if (sums.parts != nullptr)
                    for (int k = 0; k < 6; ++k) g[k] += sums.parts[k];
            const float column = frame.drivers[from.column];
            for (int k = 0; k < 6; ++k) {
                sums.pose[k] = g[k];
                if (sums.delta_pose != nullptr && column >= 0.0F)
                    sums.delta_pose[6 * Index(column) + k] += g[k];
            }
        });
    }
};

} // namespace rye::detail
