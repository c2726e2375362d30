// SPDX-License-Identifier: Apache-2.0
/// rye/rig/effect_mask.hpp: a set of effects' types as the set of names that a program handles
/// while it runs (rig/effect_names.hpp): what a scene calls for against what a variant has.
#pragma once

#include <rye/rig/effect_names.hpp>
#include <rye/rig/effects.hpp>

namespace rye {

template <EffectSet S>
inline constexpr EffectMask effect_mask{};
template <class... E>
inline constexpr EffectMask effect_mask<Effects<E...>> = mask_of<E...>();

static_assert(effect_mask<PaperEffects>.count() == 8 &&
              !effect_mask<PaperEffects>.has(EffectName::kappa));
static_assert(effect_mask<Effects<LeftGaze>> == EffectMask{EffectName::left_gaze});

} // namespace rye
