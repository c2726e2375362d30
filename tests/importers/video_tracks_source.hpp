// SPDX-License-Identifier: Apache-2.0
/// tests/importers/video_tracks_source.hpp: tracks of a head that is known, as a tracker without
/// bias would write them: a shell of 468 points whose jaw and brow move, with eyes that turn.
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/geometry/rigid.hpp>

namespace rye::trainer {

struct KnownVideo {
    int size = 640, pictures = 24;
    double focal = 700;  ///< [px]
    double noise = 0.3;  ///< of a landmark's coordinate [px]
    double turn_deg = 35;
    /// Returns where both eyes look in a picture, before the camera [dm]; without one they look
    /// around at random.
    std::function<Vec3<double>(int)> target;
};

/// The truth of one picture.
struct KnownPicture {
    Rigid<double> head;               ///< head to camera (x right, y down, z forward), dm
    Vec2<double> look = Vec2<double>::Zero(); ///< pitch and yaw that the coefficients say [rad]
    std::array<Vec3<double>, 2> gaze;         ///< unit optical axes, those of average eyes, head frame
};

/// Returns what the pictures of this video show.
std::vector<KnownPicture> known_pictures(const KnownVideo& video);

/// Returns the lines of its tracks.jsonl.
std::vector<std::string> known_tracks(const KnownVideo& video);

/// Writes a folder of tracks with pictures (grey) and masks (an ellipse about the face).
void write_known_video(const KnownVideo& video, const std::filesystem::path& folder);

/// Replaces the pictures of such a folder by ones with skin and, between the lids, eyes whose dark
/// irises look where the known gazes do.
void paint_eyes(const KnownVideo& video, const std::filesystem::path& folder);

} // namespace rye::trainer
