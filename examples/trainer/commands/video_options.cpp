// SPDX-License-Identifier: Apache-2.0
#include "commands/video_options.hpp"

#include <CLI/CLI.hpp>

#include "commands/options.hpp"

namespace rye::trainer {

void add_video_options(CLI::App& command, VideoImport& video) {
    command
        .add_option("FILE", video.files,
                    "Videos of one head by one camera, or folders of their tracks")
        ->required();
    command
        .add_option("--every", video.every,
                    "Track every so many-th picture; default: every third, or fewer of a long video, "
                    "so that 1500 are tracked at most")
        ->check(from_to(1, 10000));
    command
        .add_option("--frames", video.frames,
                    "Most frames of the capture: the most different pictures")
        ->check(from_to(8, 2000))
        ->capture_default_str();
    command
        .add_option("--focal", video.focal,
                    "Focal length [px] in pictures of at most 1920 pixels, where it is known")
        ->check(from_to(50.0, 50000.0));
    command
        .add_option("--iris-mm", video.iris_mm, "Diameter of an iris, which gives the scale [mm]")
        ->check(from_to(9.0, 14.0))
        ->capture_default_str();
    command.add_option("--dots", video.dots,
                       "CSV of the dots that the eyes of the first video look at "
                       "(docs/gaze_dots.html)");
    command.add_option("--modules", video.modules, "node_modules with the tracker's packages");
    command.add_option("--landmarker", video.landmarker, "face_landmarker.task of MediaPipe");
    command.add_option("--tracker", video.tracker, "track.js of rye's sources");
}

} // namespace rye::trainer
