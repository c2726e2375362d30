// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/device_effects.hpp: which lists of effects a device has kernels for.
#pragma once

#include <rye/avatar/eye_optics.hpp>
#include <rye/avatar/own_effects.hpp>
#include <rye/rig/driven_features.hpp>
#include <rye/rig/gaze_features.hpp>
#include <rye/rig/gaze_mechanisms.hpp>

namespace rye {

/// The encoding that kernels know; other encodings run on the host only.
template <class E>
concept EncodedByDevice = std::same_as<detail::EncodingOf<E>, PositionalEncoding>;
/// Whether a gaze mechanism or an eye appearance has kernels: a specialisation of
/// DeviceGazeMechanism or DeviceEyeAppearance (avatar/cuda/eye_parts.hpp). Set it where the part is
/// defined, before any avatar that has it.
template <class Part>
inline constexpr bool part_has_kernels = false;
template <>
inline constexpr bool part_has_kernels<ExplicitRotation> = true;
template <>
inline constexpr bool part_has_kernels<FixedEye> = true;
template <>
inline constexpr bool part_has_kernels<LearnedQuaternion> = true;
template <>
inline constexpr bool part_has_kernels<FreeFeatures> = true;
template <>
inline constexpr bool part_has_kernels<RotatedFeatures> = true;
template <>
inline constexpr bool part_has_kernels<ConditionedFeatures> = true;
template <>
inline constexpr bool part_has_kernels<RotatedCode> = true;
template <>
inline constexpr bool part_has_kernels<DrivenFeatures> = true;

/// True if a user's parts of an avatar have kernels, and there are no effects of the user's own.
template <class E>
concept HasPartsOfDevice = !has_own_effects<E> && part_has_kernels<GazeMechanismOf<E>> &&
                           part_has_kernels<EyeAppearanceOf<E>>;

namespace detail {

template <class X, class... Known>
inline constexpr bool is_part_or_one_of = requires {
    typename X::part_of;
}
|| (std::same_as<X, Known> || ...);
template <class S>
inline constexpr bool all_have_kernels = false;
template <class... X>
inline constexpr bool all_have_kernels<Effects<X...>> =
    (is_part_or_one_of<X, Expression, HeadPose, PoseResidual, LeftGaze, RightGaze, EyeOffset, Kappa,
                       Periocular, CornealBulge, CornealRefraction, Glint, Pupil, LidShadow,
                       HeadShading, ViewColor> &&
     ...);

} // namespace detail

/// Every effect is one that a device has kernels for.
template <class E>
concept EachHasKernels = detail::all_have_kernels<E>;
/// Effects that have kernels on a device: a list of others does not compile. Metrics of influence
/// and the networks' activation may be a user's.
template <class E>
concept DeviceEffects =
    EffectSet<E> && EncodedByDevice<E> && HasPartsOfDevice<E> && EachHasKernels<E>;

} // namespace rye
