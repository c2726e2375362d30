// SPDX-License-Identifier: Apache-2.0
/// rye/rig/effect_mask.hpp: conversion of a list of effect types to a run-time set of names
/// (rig/effect_names.hpp), to compare the effects that a scene needs with those of a variant.
#pragma once

#include <rye/rig/effect_names.hpp>
#include <rye/rig/effects.hpp>

namespace rye {

/// The effects of a set as bits.
template <EffectSet S>
inline constexpr EffectMask effect_mask{};
template <class... E>
inline constexpr EffectMask effect_mask<Effects<E...>> = mask_of<E...>();

static_assert(effect_mask<PaperEffects>.count() == 8 &&
              !effect_mask<PaperEffects>.has(EffectName::kappa));
static_assert(effect_mask<Effects<LeftGaze>> == EffectMask{EffectName::left_gaze});

} // namespace rye
