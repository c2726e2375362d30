// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/trained.hpp: the avatar that a program trains, keeps in a file and shows: one type,
/// whatever a configuration has on. A part without parameters changes no bit and costs nothing:
///     eyes.kappa        empty: gazes are optical axes; else 2 x 2 [rad], gazes are visual axes
///     eyes.optics       without lights: no highlights; without an index: no refraction
///     eyes.lid_shadow   empty: the upper lids cast no shadow
///     shading           default-constructed: colours do not depend on the head's rotation
///     view_color        default-constructed: colours do not depend on the view
///     eyes.networks     default-constructed: the eyes' features are their constants
/// Pupil has none: it follows its driver, and changes nothing at rest.
/// With all of them empty it is TwoStream<T>, of the paper's effects.
/// restricted<TrainedEffects> (avatar/hold.hpp) makes one of an avatar with fewer effects.
#pragma once

#include <rye/avatar/two_stream.hpp>
#include <rye/rig/driven_features.hpp>

namespace rye {

/// The paper's effects, and all that an avatar may be trained with beside them.
using TrainedEffects = More<PaperEffects, Kappa, CornealRefraction, Glint, Pupil, LidShadow,
                            HeadShading, ViewColor, EyesBy<DrivenFeatures>>;
/// Trained parameters of an avatar with any of these.
template <class T>
using TrainedAvatar = TwoStream<T, TrainedEffects>;

/// Returns true if the frame drives the features of the avatar's eyes.
template <class T>
bool has_driven_eyes(const TrainedAvatar<T>& avatar) {
    return DrivenFeatures::driven(avatar.eyes.appearance(), 0) ||
           DrivenFeatures::driven(avatar.eyes.appearance(), 1);
}

} // namespace rye
