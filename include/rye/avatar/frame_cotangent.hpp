// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/frame_cotangent.hpp: cotangents of what networks read of a frame, as far as they lead
/// to something that is trained: the pose code's, and the pose's of an eye appearance, to the
/// frame's pose, the gaze codes' to kappa; and what the eyes' optics (avatar/eye_optics.hpp) add to
/// those of the eyes' transforms, or the shadows of the lids.
#pragma once

#include <rye/avatar/drivers.hpp>
#include <rye/avatar/eye_optics.hpp>
#include <rye/avatar/face_fields.hpp>

namespace rye::detail {

/// True if the eyes' appearance reads the head pose.
template <EffectSet E>
inline constexpr bool eyes_read_pose =
    EyeAppearanceOf<E>::reads_inputs && has_effect<E, ReadsHeadPose>;
struct EyesKeepTheirFeatures {};

/// What the shadows of the lids (avatar/eye_lids.hpp) add to the cotangents of the eyes' places in
/// the head.
template <class T>
struct LidsCotangent {
    std::array<Mat3<T>, 2> turn{Mat3<T>::Zero(), Mat3<T>::Zero()}; ///< eye to head, as a matrix
    Columns<T> centre = Columns<T>::Zero(3, 2);                    ///< head frame
};

/// Cotangents of the codes of a frame that lead to trained parameters, and of the eyes' optics.
template <class T, EffectSet E = PaperEffects>
struct FrameCotangent {
    [[no_unique_address]] Slot<E, ReadsPoseCode, VecX<T>> pose;
    [[no_unique_address]] KappaSlot<E, VecX<T>> gaze;
    [[no_unique_address]] Slot<E, SeesCornea, OpticsCotangent<T>> optics;
    [[no_unique_address]] Slot<E, LidShadow, LidsCotangent<T>> lids;
    /// Cotangent of the head pose as the eyes' appearance reads it, 6.
    [[no_unique_address]] PresentIf<eyes_read_pose<E>, EyesKeepTheirFeatures, Vec<T, 6>> eye_pose;

    explicit FrameCotangent(const FrameCode<T, E>& code) {
        if constexpr (has_effect<E, ReadsPoseCode>) pose = VecX<T>::Zero(code.pose.size());
        if constexpr (eyes_read_pose<E>) eye_pose.setZero();
        for_eyes([&]<std::size_t eye>() {
            if constexpr (skin_follows<E, eye> && has_effect<E, Kappa>)
                of_eye<eye>(gaze) = VecX<T>::Zero(of_eye<eye>(code.gaze).size());
        });
    }
    VecX<T>* of(ExpressionField) { return nullptr; }
    VecX<T>* of(PoseField) { return &pose; }
    template <std::size_t eye>
    VecX<T>* of(GazeField<eye>) {
        if constexpr (has_effect<E, Kappa>)
            return &of_eye<eye>(gaze);
        else
            return nullptr;
    }
};

/// The gaze code's, or null where nothing is trained by it.
template <std::size_t eye, class T, EffectSet E>
const VecX<T>* gaze_code_cotangent(const FrameCotangent<T, E>& g) {
    if constexpr (skin_follows<E, eye> && has_effect<E, Kappa>)
        return &of_eye<eye>(g.gaze);
    else
        return nullptr;
}

} // namespace rye::detail
