// SPDX-License-Identifier: Apache-2.0
/// importers/video_tracks.hpp: what examples/video_tracker/track.js wrote of a video: a line of JSON
/// for each picture. Pixels: (0, 0) is the upper left corner of the picture.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/geometry/rigid.hpp>

namespace rye::trainer {

/// One picture of a video, and the face in it.
struct TrackedPicture {
    std::filesystem::path picture, mask; ///< of the tracks' folder; no mask without a face
    int number = 0;                      ///< of the picture in its video, from 0
    int video = 0;                       ///< which of the videos, from 0
    double time = 0;                     ///< [s]
    int faces = 0;
    Columns<double> landmarks;           ///< 3 x 478: u, v and depth [px]; the rest is of one face
    VecX<double> coefficients;           ///< by Tracks::names
    Rigid<double> head;                  ///< canonical face [dm] to a camera (x right, y up, z back)
    double sharpness = 0;                ///< of the face, in grey values
};

/// Pictures of one or several videos of one size.
struct Tracks {
    int width = 0, height = 0;      ///< of every picture [px]
    std::vector<std::string> names; ///< of the coefficients
    std::vector<TrackedPicture> pictures;
};

/// Adds the pictures in the text of a tracks.jsonl. Throws an Error that begins with `who` and the
/// line for what is no such line, for numbers that are not finite, and for a size or for names of
/// coefficients that differ from those of the pictures before.
void add_tracks(Tracks& tracks, std::string_view text, const std::string& who);

/// Reads the tracks.jsonl of each folder. Throws an Error for a folder without one, or empty ones.
Tracks read_tracks(const std::vector<std::filesystem::path>& folders);

} // namespace rye::trainer
