// SPDX-License-Identifier: Apache-2.0
/// importers/video_choice.hpp: which pictures of a video a capture takes: those with one whole, sharp
/// face, and of these the ones that differ most in head pose, gaze and expression.
#pragma once

#include <vector>

#include "importers/video_tracks.hpp"

namespace rye::trainer {

/// Least pictures of a capture.
inline constexpr int least_pictures = 8;

struct VideoChoice {
    std::vector<int> pictures; ///< of the tracks, in their order
    int without_face = 0, with_several = 0, at_border = 0, blurred = 0;
    int spare = 0;             ///< good ones, but like others that are taken
};

/// Returns at most `most` pictures. Throws an Error, with what is wrong with the others, if there are
/// fewer than least_pictures.
VideoChoice choose_pictures(const Tracks& tracks, int most);

} // namespace rye::trainer
