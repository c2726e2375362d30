// SPDX-License-Identifier: Apache-2.0
/// importers/video_gaze.hpp: gazes of a video by its pictures: those of the tracker's coefficients,
/// corrected by the irises that gaze_estimator.hpp sees on the eyeballs of the head.
#pragma once

#include "importers/video_head.hpp"
#include "importers/video_tracks.hpp"

namespace rye::trainer {

/// The gazes by the pictures.
struct VideoGazes {
    int seen = 0;      ///< eyes whose iris was found, of all poses
    double up_deg = 0; ///< mean change of both eyes' pitch; 0 if too few were seen
};

/// Corrects the gazes of all poses. Both measures have errors of their own that vary from picture
/// to picture, the eyeballs' places and the lids'; so both eyes turn by the mean of both. The mean
/// pitch is that of the irises: coefficients have a zero of their own. The mean yaw stays that of
/// the coefficients. Changes nothing if fewer than half of the irises are found. Throws an Error
/// for a picture that cannot be read or has another size than the tracks.
VideoGazes correct_gazes(const Tracks& tracks, VideoHead& head);

} // namespace rye::trainer
