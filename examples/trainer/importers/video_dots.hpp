// SPDX-License-Identifier: Apache-2.0
/// importers/video_dots.hpp: gazes of a video by dots on a screen beside the camera that were looked
/// at. When their clock begins in the video follows from the gazes that are known without them.
#pragma once

#include "data/gaze_dots.hpp"
#include "importers/video_head.hpp"
#include "importers/video_tracks.hpp"

namespace rye::trainer {

/// What the dots said of the gazes.
struct DotGazes {
    int pictures = 0;       ///< in which a dot was looked at
    double begin = 0;       ///< of the dots' clock and a reaction, in the first video [s]
    double correlation = 0; ///< of the directions to the dots with the gazes before
    double off_deg = 0;     ///< root mean square of the gazes' changes, an angle
};

/// Turns the eyes of poses in the first video to the dots: optical axes of average eyes whose lines
/// of sight meet there. The camera's plane is the screen's. Gazes of other poses follow as those did
/// from what they were, on a line for each angle. Throws an Error, which begins with `who`, if gazes follow the dots at no
/// time: a correlation below 0.5 in 12 pictures or more.
DotGazes look_at_dots(const Tracks& tracks, const std::vector<GazeDot>& dots, const std::string& who,
                      VideoHead& head);

} // namespace rye::trainer
