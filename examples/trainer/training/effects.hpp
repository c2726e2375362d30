// SPDX-License-Identifier: Apache-2.0
/// training/effects.hpp: the avatars that the reference trainer trains, as lists of effects. Units
/// that device compilers read include this and not training/types.hpp, which has lanes.
#pragma once

#include <rye/avatar/trained.hpp>
#include <rye/rig/gaze_features.hpp>
#include <rye/rig/gaze_mechanisms.hpp>

#include "training/chosen_parts.hpp"

namespace rye::trainer {

using TrainEffects = PaperEffects;
using Avatar = TwoStream<float, TrainEffects>;
/// The avatar that is trained by lines of sight.
using VisualEffects = More<TrainEffects, Kappa>;
using VisualAvatar = TwoStream<float, VisualEffects>;
/// The avatar of a run whose gaze mechanism is not explicit rotation; it may be shaded.
using ComparedMechanism = OneMechanism<FixedEye, LearnedQuaternion>;
using ComparedAppearance =
    OneAppearance<FreeFeatures, RotatedFeatures, ConditionedFeatures, RotatedCode>;
using ComparedEffects =
    More<TrainEffects, HeadShading, GazeBy<ComparedMechanism>, EyesBy<ComparedAppearance>>;
using ComparedAvatar = TwoStream<float, ComparedEffects>;
/// The avatar of a run with driven eyes or shading, and explicit rotation.
using AppearanceEffects = TrainedEffects;
using AppearanceAvatar = TrainedAvatar<float>;

} // namespace rye::trainer
