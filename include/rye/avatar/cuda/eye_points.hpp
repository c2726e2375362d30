// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/eye_points.hpp: the eyeballs of a frame in device memory: where each lies, what
/// that does to its Gaussians, and back, by the formulas of rig/eye_transform.hpp,
/// avatar/eye_stream.hpp and avatar/eye_kappa.hpp.
#pragma once

#include <rye/avatar/cuda/eye_parts.hpp>

namespace rye::detail {

/// The eye offset's network in device memory, where the effect is on.
struct DeviceEyeOffset {
    const float* output; ///< of the network, 6, or null
    float* squashed;     ///< tanh of it
    float scale;         ///< AvatarConfig::deform_scale
};

/// True if parts of the eyes read optical axes and give their cotangents, which lead to kappa.
template <EffectSet E>
inline constexpr bool axes_are_trained = has_effect<E, Kappa> &&
                                         (own_turn<E> || gives_cotangents<EyeAppearanceOf<E>>);
/// True if the eyes' features read the head pose and give its cotangent.
template <EffectSet E>
inline constexpr bool eyes_train_pose = eyes_read_pose<E>&& gives_cotangents<EyeAppearanceOf<E>>;

struct NoOwnTurn {};
struct NoTrainedAxes {};

/// Sets both eyes' transforms: neutral centres, offset, turn to the gaze, the head's motion.
template <EffectSet E>
struct PlaceEyesKernel {
    static constexpr const char* name = "eyes' transforms";
    static constexpr int threads = 32, blocks = 1;
    struct Shared {};
    const float* centre; ///< 3 x 2
    DeviceEyeOffset offset;
    DeviceFrameState* frame;
    /// Turns by the mechanism, 4 x 2, or null: DeviceGazeMechanism::turns.
    PresentIf<own_turn<E>, NoOwnTurn, const float*> turns = {};

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

/// Both eyes' pupils in device memory.
struct DevicePupils {
    const float* ratio[2]; ///< among the drivers, or null: at rest
    const float* position; ///< of both eyes at rest, 3 x P
    float* moved;          ///< as the pupils move them, 3 x P
    Iris<float> iris[2];
};

/// Sets all of Gaussian i of both eyes but its feature.
template <EffectSet E>
struct DriveBothEyes {
    static constexpr const char* name = "eyes";
    DriveEyePoint<float, E> point; ///< of the left eye, whose points and transform come first
    Index left;                    ///< number of its points
    Slot<E, Pupil, DevicePupils, 1> pupils = {};

    RYE_DEVICE void operator()(Index i) const {
        DriveEyePoint<float, E> own = point;
        if (i >= left) ++own.place.eye;
        if constexpr (has_effect<E, Pupil>) {
            const int eye = i < left ? 0 : 1;
            PupilMap<float> map;
            if (pupils.ratio[eye] != nullptr) map = {pupils.iris[eye], *pupils.ratio[eye]};
            MoveEyePoint<float>{pupils.position, map, pupils.moved}(i);
            own(i);
            StretchEyePoint<float>{pupils.position, map, own.place.to.scale.data}(i);
        } else {
            own(i);
        }
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

/// Destinations of the gradients of the eyes' angles.
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
    /// Cotangents of the optical axes as parts of the eyes read them, 3 x 2.
    PresentIf<axes_are_trained<E>, NoTrainedAxes, const float*> g_axis = {};

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
                take_turn_sums(own, turn);
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

} // namespace rye::detail
