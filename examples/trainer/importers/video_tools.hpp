// SPDX-License-Identifier: Apache-2.0
/// importers/video_tools.hpp: the programs and models that turn videos into tracks, and their runs.
/// None of them is part of rye.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace rye::trainer {

/// The paths of tools, as far as the user says; an empty one is looked for.
struct VideoToolOptions {
    std::filesystem::path modules;    ///< node_modules; else $RYE_MODULES, else ./node_modules
    std::filesystem::path landmarker; ///< else $RYE_FACE_LANDMARKER, else ./face_landmarker.task
    std::filesystem::path tracker;    ///< track.js; else $RYE_VIDEO_TRACKER, else beside the program
};

struct VideoTools {
    std::filesystem::path ffmpeg, ffprobe, node, chromium, modules, landmarker, tracker;
};

/// Returns all tools. Throws an Error that names each that is missing, with the command that
/// installs it. The browser is $CHROMIUM, else chromium, chromium-browser or google-chrome of PATH.
VideoTools find_video_tools(const VideoToolOptions& options);

/// Writes the tracks of a video to a folder: every `every`-th picture (0: every third, or fewer, so
/// that there are at most 1500), at most 1920 pixels a side, in frames/ and frames.jsonl, and what
/// track.js finds in them. What is there already is kept. Calls
/// progress(done, of) after each picture. Throws an Error for a file that ffmpeg does not read, and
/// with what the tracker says.
void track_video(const VideoTools& tools, const std::filesystem::path& video, int every,
                 const std::filesystem::path& folder,
                 const std::function<void(int, int)>& progress);

} // namespace rye::trainer
