// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/eye_points.hpp: the eyeballs of a frame in device memory: where each lies, what
/// that does to its Gaussians, and back, by the formulas of rig/eye_transform.hpp,
/// avatar/eye_stream.hpp and avatar/eye_kappa.hpp.
#pragma once

#include <rye/avatar/cuda/eye_parts.hpp>

namespace rye {

/// The eye offset's network in device memory, where the effect is on.
struct DeviceEyeOffset {
    const float* output; ///< of the network, 6, or null
    float* squashed;     ///< tanh of it
    float scale;         ///< AvatarConfig::deform_scale
};

/// Whether a mechanism other than explicit rotation turns the eyes.
template <EffectSet E>
inline constexpr bool own_turn = !std::same_as<GazeMechanismOf<E>, ExplicitRotation>;
/// Whether something trained follows from an eye's turn: kappa, or a mechanism's parameters.
template <EffectSet E, int eye>
inline constexpr bool turn_is_trained = eye_turns<E, std::size_t(eye)> &&
                                        (own_turn<E> ? !std::same_as<GazeMechanismOf<E>, FixedEye>
                                                     : has_effect<E, Kappa>);
/// Whether kappa follows from optical axes as parts of the eyes read them.
template <EffectSet E>
inline constexpr bool axes_are_trained = has_effect<E, Kappa> &&
                                         (own_turn<E> || gives_cotangents<EyeAppearanceOf<E>>);
/// Whether the head pose's correction follows from what the eyes' features read.
template <EffectSet E>
inline constexpr bool eyes_train_pose = eyes_read_pose<E>&& gives_cotangents<EyeAppearanceOf<E>>;

struct NoOwnTurn {};
struct NoTrainedAxes {};

/// Where both eyes lie: neutral centres, their offset, the turn to their gaze, the head's motion.
template <EffectSet E>
struct PlaceEyesKernel {
    static constexpr const char* name = "eyes' transforms";
    static constexpr int threads = 32, blocks = 1;
    struct Shared {};
    const float* centre; ///< 3 x 2
    DeviceEyeOffset offset;
    DeviceFrameState* frame;
    /// Of the mechanism, 4 x 2, or null: DeviceGazeMechanism::turns.
    [[no_unique_address]] PresentIf<own_turn<E>, NoOwnTurn, const float*> turns = {};

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            if (t == 0) place<0>();
            if (t == 1) place<1>();
        });
    }

  private:
    template <int eye>
    RYE_DEVICE void place() const {
        Vec3<float> at = column3(centre, eye);
        if constexpr (has_effect<E, EyeOffset>)
            for (int k = 0; k < 3; ++k) {
                const float y = squash_value(Squash::tanh, offset.output[3 * eye + k]);
                offset.squashed[3 * eye + k] = y;
                at[k] += offset.scale * y;
            }
        EyeTransform<float> placed = eye_at<float>(at);
        if constexpr (eye_turns<E, std::size_t(eye)>) {
            const Vec3<float> gaze = normalized(frame->optical[eye]);
            if constexpr (own_turn<E>) {
                placed.quaternion = turns != nullptr ? column4(turns, eye) : quat_identity<float>();
                placed.rotation = quat_matrix(placed.quaternion);
                placed.beyond_range = beyond_gaze_range(gaze);
            } else {
                turn_eye_to<float>(placed, gaze);
            }
            frame->turn[eye] = placed.quaternion;
        }
        if constexpr (has_effect<E, HeadPose>) {
            const HeadTransform<float>& head = frame->head;
            carry_eye<float>(
                placed,
                HeadPlacement<float>{Rigid<float>{head.rotation, head.translation}, head.scale});
        }
        frame->eye[eye] = placed;
    }
};

/// Arrays of the eyes, in device memory.
struct DeviceEyeArrays {
    float* log_scale;     ///< 3 x P
    float* rotation;      ///< 4 x P
    float* opacity_logit; ///< 1 x P
};

/// Sets what Gaussian i of the eyes has beside its feature. `to`: the eyes' columns of a cloud.
template <EffectSet E>
struct DriveEyePoint {
    static constexpr const char* name = "eyes";
    DeviceEyeArrays raw;
    const float* position; ///< 3 x P
    Index left;            ///< points of the left eye, which come first
    DeviceGaussians<float> to;
    const DeviceFrameState* frame;

    RYE_DEVICE void operator()(Index i) const {
        const EyeTransform<float>& eye = frame->eye[i < left ? 0 : 1];
        put_column<3>(eye.apply(column3(position, i)), to.mean.data, i);
        put_column<4>(quat_product<float>(eye.quaternion, column4(raw.rotation, i)),
                      to.rotation.data, i);
        for (int k = 0; k < 3; ++k) {
            const float scale = drawn_scale(raw.log_scale[3 * i + k]);
            to.scale.data[3 * i + k] = has_effect<E, HeadPose> ? scale * frame->head.scale : scale;
        }
        to.opacity.data[i] = drawn_opacity(raw.opacity_logit[i]);
    }
};

/// What an eye's points are summed for: the head's transform, the eye's turn (a matrix and a
/// quaternion), its centre; as far as something trained follows.
template <EffectSet E, int eye>
struct EyeSums {
    static constexpr bool turn = turn_is_trained<E, eye>;
    static constexpr int head_at = 0;
    static constexpr int turn_at = has_effect<E, HeadPose> ? head_sums : 0;
    static constexpr int centre_at = turn_at + (turn ? 13 : 0);
    static constexpr int count = centre_at + (has_effect<E, EyeOffset> ? 3 : 0);
    static constexpr int room = 32; ///< numbers that an eye's sums are apart
};

/// Adds the gradients of point i of an eye, and sums. Arrays begin at that eye's first point.
template <EffectSet E, int eye>
struct EyePointVjp {
    using Places = EyeSums<E, eye>;
    static constexpr const char* name = "eyes, reverse";
    static constexpr int sums = Places::count;
    DeviceEyeArrays raw, gradient;
    const float* position;
    DeviceGaussians<float> world, g; ///< g's means are left in the head's frame
    const DeviceFrameState* frame;

    template <class Sums>
    RYE_DEVICE void operator()(Index i, [[maybe_unused]] Sums& sum) const {
        MovedPoint<float> own{column3(g.mean.data, i), column4(g.rotation.data, i)};
        const Vec4<float> rotation = column4(raw.rotation, i);
        if constexpr (has_effect<E, HeadPose>) {
            HeadTransformGradient<float> part;
            part.add(frame->head, {column3(world.mean.data, i), column4(world.rotation.data, i)},
                     own);
            add_head_sums(part, sum, Places::head_at);
        }
        // Scales in the world are proportional to the head's, so it cancels here.
        for (int k = 0; k < 3; ++k)
            gradient.log_scale[3 * i + k] +=
                drawn_scale_vjp<float>(world.scale.data[3 * i + k], g.scale.data[3 * i + k]);
        const float a = world.opacity.data[i];
        gradient.opacity_logit[i] += drawn_opacity_vjp<float>(a, 1.0F - a, g.opacity.data[i]);
        if constexpr (eye_turns<E, std::size_t(eye)>)
            add_column<4>(quat_product_vjp_right<float>(frame->turn[eye], own.rotation),
                          gradient.rotation, i);
        else
            add_column<4>(own.rotation, gradient.rotation, i);
        if constexpr (Places::turn) {
            TurnCotangent<float> turn;
            turn.add({column3(position, i), rotation}, own);
            for (int k = 0; k < 9; ++k)
                sum[std::size_t(Places::turn_at + k)] += turn.rotation.data()[k];
            for (int k = 0; k < 4; ++k)
                sum[std::size_t(Places::turn_at + 9 + k)] += turn.quaternion[k];
        }
        if constexpr (has_effect<E, EyeOffset>)
            for (int k = 0; k < 3; ++k) sum[std::size_t(Places::centre_at + k)] += own.mean[k];
    }
};

/// Cotangents of the offset network's outputs, from the eyes' sums.
template <EffectSet E>
struct EyeOffsetVjp {
    static constexpr const char* name = "eyes' offset, reverse";
    const float* sums; ///< of each eye, EyeSums::room apart
    DeviceEyeOffset offset;
    float* g_offset; ///< 6, of the network's outputs, overwritten

    RYE_DEVICE void operator()(Index i) const {
        const float* const own = sums + i / 3 * EyeSums<E, 0>::room;
        const int at = (i < 3 ? EyeSums<E, 0>::centre_at : EyeSums<E, 1>::centre_at);
        g_offset[i] = offset.scale * own[at + i % 3] * tanh_slope(offset.squashed[i]);
    }
};

/// Where gradients of angles of the eyes go.
struct DeviceAngleGradients {
    float* kappa;      ///< 2 x 2, added to
    float* delta_gaze; ///< 4 x frames, whose column of the frame is added to, or null
};

/// ... and the gradients of kappa and of the frame's correction of gazes, which adds to the same
/// angles.
template <EffectSet E>
struct KappaVjpKernel {
    static constexpr const char* name = "kappa, reverse";
    static constexpr int threads = 32, blocks = 1;
    struct Shared {};
    DeviceFrameNumbers frame;
    const float* sums; ///< of each eye, EyeSums::room apart
    CodePlaces<E> places;
    const float* g_codes; ///< of the gaze codes
    int gaze_frequencies;
    DeviceAngleGradients gradient;
    Index column; ///< place of the frame's column of delta_gaze among the drivers
    /// Of the optical axes as parts of the eyes read them, 3 x 2.
    [[no_unique_address]] PresentIf<axes_are_trained<E>, NoTrainedAxes, const float*> g_axis = {};

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            if (t == 0) kappa_of_eye<0>();
            if (t == 1) kappa_of_eye<1>();
        });
    }

  private:
    template <int eye>
    RYE_DEVICE void kappa_of_eye() const {
        if constexpr (has_effect<E, Kappa> && eye_turns<E, std::size_t(eye)>) {
            TurnCotangent<float> turn;
            if constexpr (!own_turn<E>) {
                using Places = EyeSums<E, eye>;
                const float* const own = sums + eye * Places::room + Places::turn_at;
                for (int k = 0; k < 9; ++k) turn.rotation.data()[k] = own[k];
                for (int k = 0; k < 4; ++k) turn.quaternion[k] = own[9 + k];
            }
            const KappaTangent<float> tangent(
                frame.state->visual[eye],
                KappaAngles<float>{frame.kappa[2 * eye], frame.kappa[2 * eye + 1]});
            for (int a = 0; a < 2; ++a) {
                float s = tangent.of_turn(turn, std::size_t(a));
                if constexpr (skin_follows<E, std::size_t(eye)>) {
                    const float *const code = frame.codes + places.gaze[eye], *const g =
                                                                                  g_codes +
                                                                                  places.gaze[eye];
                    const auto angles = pitch_yaw(tangent.optical);
                    for (int k = 0; k < 2; ++k)
                        s += encode_number_vjp(code + k, g + k, gaze_frequencies, 2) *
                             angles[k].d[std::size_t(a)];
                }
                if constexpr (axes_are_trained<E>)
                    for (int k = 0; k < 3; ++k)
                        s += g_axis[3 * eye + k] * tangent.optical[k].d[std::size_t(a)];
                gradient.kappa[2 * eye + a] += s;
                const float frames_column = frame.drivers[column];
                if (gradient.delta_gaze != nullptr && frames_column >= 0.0F)
                    gradient.delta_gaze[4 * Index(frames_column) + 2 * eye + a] += s;
            }
        }
    }
};

} // namespace rye
