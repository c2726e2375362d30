// SPDX-License-Identifier: Apache-2.0
/// rye/interactive/drive_work.hpp: which avatars a DriveCache (interactive/drive_cache.hpp) keeps
/// from frame to frame, and what an update of it did.
#pragma once

#include <rye/avatar/drivers.hpp>
#include <rye/avatar/own_effects.hpp>

namespace rye {

/// Effects whose Gaussians depend only on what a cache compares: expression, head pose, gaze,
/// pupil, and for CornealRefraction and Glint the camera; the inputs of a user's own effects are
/// not known.
template <class E>
concept KeptFromFrameToFrame = EffectSet<E> && !has_own_effects<E>;

/// Work of the last update.
struct DriveWork {
    Index networks = 0;   ///< evaluated; driven features of an eye count as one
    Index points = 0;     ///< evaluated, summed over networks
    Index summed = 0;     ///< points of the face summed
    Index eyes = 0;       ///< eyeballs transformed
    Index lit = 0;        ///< gains of the light computed
};

} // namespace rye
