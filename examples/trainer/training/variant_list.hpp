// SPDX-License-Identifier: Apache-2.0
/// training/variant_list.hpp: the avatars that pictures of a trained run are drawn with.
/// Each is compiled whole; benchmarks/compile/variants.sh prints what that costs. This list is the
/// one place to edit: an avatar that is added here is chosen where it is the smallest that will do.
#pragma once

#include <string_view>

#include <rye/rig/effect_mask.hpp>

#include "training/dispatch.hpp"
#include "training/types.hpp"

namespace rye::trainer {

/// The base of a variant, which adds its name.
template <EffectSet E>
struct AvatarVariant {
    using List = E;
    static constexpr EffectMask effects = effect_mask<E>;
};

/// All that is trained.
struct PaperVariant : AvatarVariant<TrainEffects> {
    static constexpr std::string_view name = "paper";
};
/// A face that talks and looks about, on a head that keeps still.
struct TalkVariant : AvatarVariant<Less<TrainEffects, PoseResidual>> {
    static constexpr std::string_view name = "talk";
};
/// Eyes that turn, and the skin around them. A cornea is part of the eyeballs and costs nothing.
struct GazeVariant
    : AvatarVariant<Effects<HeadPose, LeftGaze, RightGaze, Kappa, Periocular, CornealBulge,
                            HeadShading, EyesBy<DrivenFeatures>>> {
    static constexpr std::string_view name = "gaze";
};
/// A camera that moves around a head that does not.
struct StillVariant : AvatarVariant<Effects<HeadPose, CornealBulge, HeadShading>> {
    static constexpr std::string_view name = "still";
};

using AvatarVariants = Variants<PaperVariant, TalkVariant, GazeVariant, StillVariant>;

} // namespace rye::trainer
