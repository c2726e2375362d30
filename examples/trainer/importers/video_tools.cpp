// SPDX-License-Identifier: Apache-2.0
#include "importers/video_tools.hpp"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <string>

#include <rye/io/atomic_file.hpp>
#include <rye/core/error.hpp>

#include "data/process.hpp"
#include "data/system.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

constexpr int largest_side = 1920;
constexpr std::size_t most_pictures = 1500; ///< that are tracked of one video, if nobody says how many

fs::path first_of(const fs::path& option, const char* variable, const fs::path& otherwise) {
    if (!option.empty()) return option;
    const std::optional<std::string> value = environment(variable);
    return value ? fs::path(*value) : otherwise;
}

/// Returns track.js beside the program, or where it is installed.
fs::path own_tracker() {
    const fs::path folder = program_file().parent_path();
    const fs::path beside = folder / "video_tracker/track.js";
    return fs::exists(beside) ? beside
                              : folder.parent_path() / "share/rye/video_tracker/track.js";
}

std::string seconds_text(double seconds) {
    char text[32];
    std::snprintf(text, sizeof text, "%.4f", seconds);
    return text;
}

/// Returns the times of a video's pictures in their order [s]; those without a time are left out.
std::vector<double> picture_times(const VideoTools& tools, const fs::path& video) {
    std::vector<double> times;
    run_program({tools.ffprobe.string(), "-v", "error", "-select_streams", "v:0", "-show_entries",
                 "packet=pts_time", "-of", "csv=p=0", video.string()},
                [&](std::string_view line) {
                    const std::string text(line.substr(0, line.find(',')));
                    char* end = nullptr;
                    const double seconds = std::strtod(text.c_str(), &end);
                    if (end != text.c_str()) times.push_back(seconds);
                });
    std::sort(times.begin(), times.end());
    return times;
}

/// Takes the pictures out of a video, then lists them in frames.jsonl.
void extract(const VideoTools& tools, const fs::path& video, int wanted, const fs::path& folder) {
    const std::vector<double> times = picture_times(tools, video);
    const int every =
        wanted > 0 ? wanted
                   : std::max(3, static_cast<int>((times.size() + most_pictures - 1) / most_pictures));
    const fs::path frames = folder / "frames";
    fs::remove_all(frames); // of an interrupted run
    fs::create_directories(frames);
    const std::string most = std::to_string(largest_side);
    const std::string filter = "select=not(mod(n\\," + std::to_string(every) +
                               ")),scale=w='if(gt(iw,ih),min(iw," + most +
                               "),-2)':h='if(gt(iw,ih),-2,min(ih," + most + "))'";
    const ProgramEnd end = run_program(
        {tools.ffmpeg.string(), "-hide_banner", "-nostats", "-loglevel", "error", "-y", "-i",
         video.string(), "-map", "0:v:0", "-vf", filter, "-vsync", "0", "-q:v", "2",
         (frames / "%06d.jpg").string()});
    std::vector<fs::path> names;
    for (const fs::directory_entry& entry : fs::directory_iterator(frames))
        names.push_back(entry.path().filename());
    std::sort(names.begin(), names.end());
    std::string said = end.message.substr(0, end.message.find_last_not_of('\n') + 1);
    said = said.substr(said.find_last_of('\n') + 1); // its last line
    require(end.code == 0 && !names.empty(), video.string(), "ffmpeg reads no pictures of it: ",
            said.empty() ? "no video stream" : said, "; is the file whole, and a video?");
    std::string list;
    for (std::size_t i = 0; i < names.size(); ++i) {
        const std::size_t number = i * static_cast<std::size_t>(every);
        list += "{\"picture\": \"frames/" + names[i].string() +
                "\", \"number\": " + std::to_string(number) +
                ", \"time\": " + seconds_text(number < times.size() ? times[number] : 0) + "}\n";
    }
    write_atomic(folder / "frames.jsonl", as_bytes(list), Durability::atomic_only);
}

} // namespace

VideoTools find_video_tools(const VideoToolOptions& o) {
    VideoTools t;
    std::string missing;
    const auto add = [&](const std::string& what) { missing += (missing.empty() ? "" : "; ") + what; };
    const auto program = [&](std::vector<std::string> names, const char* package) {
        const auto found = find_program(names);
        if (!found) add(names[0] + ": `apt-get install " + package + "`");
        return found.value_or(fs::path());
    };
    t.ffmpeg = program({"ffmpeg"}, "ffmpeg");
    t.ffprobe = t.ffmpeg.empty() ? fs::path() : program({"ffprobe"}, "ffmpeg");
    t.node = program({"node"}, "nodejs");
    t.chromium = first_of({}, "CHROMIUM", {});
    if (t.chromium.empty())
        t.chromium = program({"chromium", "chromium-browser", "google-chrome"}, "chromium");
    t.modules = first_of(o.modules, "RYE_MODULES", "node_modules");
    if (!fs::exists(t.modules / "@mediapipe/tasks-vision/vision_bundle.mjs") ||
        !fs::exists(t.modules / "@mediapipe/selfie_segmentation/selfie_segmentation.tflite"))
        add("the tracker's packages in " + t.modules.string() +
            ": `npm install --ignore-scripts @mediapipe/tasks-vision@1.1.0 "
            "@mediapipe/selfie_segmentation@0.1.1675465747` (--modules names another node_modules)");
    t.landmarker = first_of(o.landmarker, "RYE_FACE_LANDMARKER", "face_landmarker.task");
    if (!fs::is_regular_file(t.landmarker))
        add("the tracker's model " + t.landmarker.string() +
            ": `curl -LO https://storage.googleapis.com/mediapipe-models/face_landmarker/"
            "face_landmarker/float16/latest/face_landmarker.task` (--landmarker names another file)");
    t.tracker = first_of(o.tracker, "RYE_VIDEO_TRACKER", own_tracker());
    if (!fs::is_regular_file(t.tracker))
        add("rye's own " + t.tracker.string() + " (examples/video_tracker of the sources; --tracker "
            "names it)");
    require(missing.empty(), "rye import video", "needs what is not here: ", missing);
    return t;
}

void track_video(const VideoTools& tools, const fs::path& video, int every, const fs::path& folder,
                 const std::function<void(int, int)>& progress) {
    fs::create_directories(folder);
    if (!fs::exists(folder / "frames.jsonl")) extract(tools, video, every, folder);
    const ProgramEnd end =
        run_program({tools.node.string(), tools.tracker.string(), tools.chromium.string(),
                     tools.modules.string(), tools.landmarker.string(), folder.string()},
                    [&](std::string_view line) {
                        int done = 0, of = 0;
                        if (std::sscanf(std::string(line).c_str(), "tracked %d of %d", &done, &of) == 2)
                            progress(done, of);
                    });
    require(end.code == 0, video.string(), "the tracker ended with code ", end.code, ": ",
            (end.message.empty() ? "it said nothing" : end.message));
}

} // namespace rye::trainer
