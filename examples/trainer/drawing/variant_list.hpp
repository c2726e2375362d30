// SPDX-License-Identifier: Apache-2.0
/// drawing/variant_list.hpp: the avatars for pictures of a trained run. Each is compiled whole;
/// benchmarks/compile/variants.sh prints the cost. Edit this list alone: an avatar added here is
/// used if it is the smallest one that suffices.
#pragma once

#include <string_view>

#include <rye/rig/effect_mask.hpp>

#include "drawing/dispatch.hpp"
#include "model/types.hpp"

namespace rye::trainer {

/// Base of a variant, which adds its name.
template <EffectSet E>
struct AvatarVariant {
    using List = E;
    static constexpr EffectMask effects = effect_mask<E>;
};

/// All trained effects.
struct PaperVariant : AvatarVariant<TrainEffects> {
    static constexpr std::string_view name = "paper";
};
/// A face that talks and looks around, on a head that does not move.
struct TalkVariant : AvatarVariant<Less<TrainEffects, PoseResidual>> {
    static constexpr std::string_view name = "talk";
};
/// Eyes that turn, their pupils, and the skin around them. A cornea is part of the eyeballs and
/// costs nothing.
struct GazeVariant
    : AvatarVariant<
          Effects<HeadPose, LeftGaze, RightGaze, Kappa, Periocular, CornealBulge, CornealRefraction,
                  Glint, Pupil, LidShadow, HeadShading, ViewColor, EyesBy<DrivenFeatures>>> {
    static constexpr std::string_view name = "gaze";
};
/// A camera that moves around a head that does not.
struct StillVariant : AvatarVariant<Effects<HeadPose, CornealBulge, CornealRefraction, Glint,
                                            LidShadow, HeadShading, ViewColor>> {
    static constexpr std::string_view name = "still";
};

using AvatarVariants = Variants<PaperVariant, TalkVariant, GazeVariant, StillVariant>;

} // namespace rye::trainer
