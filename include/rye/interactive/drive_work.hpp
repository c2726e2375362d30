// SPDX-License-Identifier: Apache-2.0
/// rye/interactive/drive_work.hpp: which avatars a DriveCache (interactive/drive_cache.hpp) keeps
/// from frame to frame, and what an update of it did.
#pragma once

#include <array>

#include <rye/avatar/drivers.hpp>
#include <rye/avatar/face_fields.hpp>
#include <rye/avatar/own_effects.hpp>

namespace rye {

/// Effects whose Gaussians depend only on what a cache compares: expression, head pose, gaze,
/// pupil, and for effects that read it the camera; the inputs of a user's own effects are
/// not known.
template <class E>
concept KeptFromFrameToFrame = EffectSet<E> && !has_own_effects<E>;

namespace detail {

/// What differs between two frames.
struct DriveChanges {
    bool first = false; ///< true until the first evaluation
    std::array<bool, face_drivers> driver{};
    bool scale = false, light = false, view = false, bent = false;
    std::array<bool, 2> pupil{};
    bool tint = false; ///< true if colours depend on the view, which differs

    bool any() const { return moves(0) || moves(1) || driver[0] || view; }
    bool moves_all() const { return first || driver[1] || scale; }
    bool moves(std::size_t e) const { return moves_all() || bent || driver[2 + e] || pupil[e]; }
    bool attributes() const { return driver[0] || driver[1]; }
};

} // namespace detail

/// Work of the last update.
struct DriveWork {
    Index networks = 0;   ///< evaluated; driven features of an eye count as one
    Index points = 0;     ///< evaluated, summed over networks
    Index summed = 0;     ///< points of the face summed
    Index eyes = 0;       ///< eyeballs transformed
    Index lit = 0;        ///< gains of the light computed
};

} // namespace rye
