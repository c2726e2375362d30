// SPDX-License-Identifier: Apache-2.0
/// importers/video_dots.hpp: gazes of a video by dots on a screen beside the camera that were
/// looked at. When their clock begins in the video follows from the gazes that are known without
/// them.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "data/gaze_dots.hpp"
#include "importers/video_head.hpp"
#include "importers/video_tracks.hpp"

namespace rye::trainer {

/// Dots of the first video, and when their clock begins in it.
struct DotClock {
    std::vector<GazeDot> dots;
    double begin = 0;       ///< with a reaction [s]
    double correlation = 0; ///< of the directions to the dots with the tracker's gazes

    /// Returns true from the first dot to the last.
    bool has(const TrackedPicture& picture) const;
    /// Returns the dot on which the eyes rest; nothing when they have just left another one.
    std::optional<GazeDot> looked_at(const TrackedPicture& picture) const;
};

/// Returns when the dots were shown: when what the tracker says of gazes follows them best. Throws
/// an Error, which begins with `who`, if that is at no time: a correlation below 0.5 in 12 pictures
/// or more.
DotClock find_dots(const Tracks& tracks, std::vector<GazeDot> dots, const std::string& who);

/// The gazes by the dots.
struct DotGazes {
    int pictures = 0;   ///< in which a dot was looked at
    double off_deg = 0; ///< root mean square of the gazes' changes, an angle
};

/// Turns the eyes of poses to the dots: optical axes of average eyes whose lines of sight meet
/// there. The camera's plane is the screen's. Gazes of other poses follow as those did from what
/// they were, on a line for each angle.
DotGazes look_at_dots(const Tracks& tracks, const DotClock& clock, VideoHead& head);

} // namespace rye::trainer
