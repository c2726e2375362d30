// SPDX-License-Identifier: Apache-2.0
/// importers/video_choice.hpp: which pictures of a video a capture takes: those with one whole,
/// sharp face, and of these the ones that differ most in head pose, gaze and expression.
#pragma once

#include <functional>
#include <vector>

#include "importers/video_tracks.hpp"

namespace rye::trainer {

/// Least pictures of a capture.
inline constexpr int least_pictures = 8;

struct VideoChoice {
    std::vector<int> pictures; ///< of the tracks, in their order
    int without_face = 0, with_several = 0, at_border = 0, blurred = 0;
    int unwanted = 0;          ///< good ones that are not wanted, or no better than preferred ones
    int spare = 0;             ///< good ones, but like others that are taken
};

/// A caller's opinion of a picture.
enum class Wanted {
    no,
    otherwise, ///< only if head and expression are like those of no preferred one
    preferred,
};

/// Returns at most `most` pictures, of those that are wanted. Throws an Error, with what is wrong
/// with the others, if there are fewer than least_pictures.
VideoChoice choose_pictures(
    const Tracks& tracks, int most,
    const std::function<Wanted(const TrackedPicture&)>& wanted =
        [](const TrackedPicture&) { return Wanted::preferred; });

} // namespace rye::trainer
