// SPDX-License-Identifier: Apache-2.0
/// model/effects.hpp: the avatars that the reference trainer trains, as lists of effects. Units
/// for device compilers include this and not model/types.hpp, which has lanes.
#pragma once

#include <rye/avatar/trained.hpp>
#include <rye/rig/gaze_features.hpp>
#include <rye/rig/gaze_mechanisms.hpp>

#include "model/chosen_parts.hpp"

namespace rye::trainer {

/// Effects of stage 1: of its guidance mesh and the eyeballs' template.
using MeshEffects = PaperEffects;
/// Effects of a run's avatar; parts that its configuration leaves off have no parameters.
using TrainEffects = TrainedEffects;
using Avatar = TrainedAvatar<float>;
/// Gaze mechanism of a run other than explicit rotation; its avatar may be shaded.
using ComparedMechanism = OneMechanism<FixedEye, LearnedQuaternion>;
using ComparedAppearance =
    OneAppearance<FreeFeatures, RotatedFeatures, ConditionedFeatures, RotatedCode>;
using ComparedEffects =
    More<PaperEffects, Pupil, HeadShading, GazeBy<ComparedMechanism>, EyesBy<ComparedAppearance>>;
using ComparedAvatar = TwoStream<float, ComparedEffects>;

} // namespace rye::trainer
