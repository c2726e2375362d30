// SPDX-License-Identifier: Apache-2.0
/// training/effects.hpp: the avatars that the reference trainer trains, as lists of effects. Units
/// that device compilers read include this and not training/types.hpp, which has lanes.
#pragma once

#include <rye/avatar/trained.hpp>
#include <rye/rig/gaze_features.hpp>
#include <rye/rig/gaze_mechanisms.hpp>

#include "training/chosen_parts.hpp"

namespace rye::trainer {

/// Effects that stage 1 knows of: its guidance mesh and the eyeballs' template have these.
using MeshEffects = PaperEffects;
/// The avatar of a run; what its configuration leaves off has no parameters.
using TrainEffects = TrainedEffects;
using Avatar = TrainedAvatar<float>;
/// The avatar of a run whose gaze mechanism is not explicit rotation; it may be shaded.
using ComparedMechanism = OneMechanism<FixedEye, LearnedQuaternion>;
using ComparedAppearance =
    OneAppearance<FreeFeatures, RotatedFeatures, ConditionedFeatures, RotatedCode>;
using ComparedEffects =
    More<PaperEffects, HeadShading, GazeBy<ComparedMechanism>, EyesBy<ComparedAppearance>>;
using ComparedAvatar = TwoStream<float, ComparedEffects>;

} // namespace rye::trainer
