// SPDX-License-Identifier: Apache-2.0
/// `rye avatar FILE... --out head.avatar`: from videos of a head to its avatar: the commands
/// import, train, export and redirect, one after the other. What each has made stays in a folder of
/// work beside the avatar, so that the same command goes on where it was interrupted.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <iostream>
#include <memory>
#include <optional>

#include <CLI/CLI.hpp>

#include <rye/io/atomic_file.hpp>
#include <rye/core/error.hpp>

#include "commands/child_jobs.hpp"
#include "commands/commands.hpp"
#include "commands/options.hpp"
#include "commands/progress.hpp"
#include "commands/video_options.hpp"
#include "data/folder_lock.hpp"
#include "data/gaze_dots.hpp"
#include "data/json.hpp"
#include "data/system.hpp"
#include "data/validate.hpp"
#include "device/device.hpp"
#include "importers/video_tools.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

/// Pixels a side of the capture's pictures that the presets are for.
constexpr int size_of_cpu = 256, size_of_device = 512;

struct AvatarOptions {
    VideoImport video;
    fs::path out, work, config;
    std::string preset; ///< empty: by the machine
    int threads = 0;
    bool quiet = false;
};

fs::path work_of(const AvatarOptions& o) {
    return o.work.empty() ? fs::path(o.out.string() + ".work") : o.work;
}
fs::path sheet_of(const AvatarOptions& o) { return fs::path(o.out).replace_extension(".png"); }

/// One of the commands that make an avatar.
struct Step {
    std::string name, doing;
    std::vector<std::string> words; ///< of its command line
};

/// The record of a folder of work, its avatar.json.
class Record {
  public:
    /// Throws an Error if the folder is of another job, or of something else.
    Record(const fs::path& work, const Json& job) : file_(work / "avatar.json") {
        if (fs::exists(file_)) {
            const Json was = read_json<Json>(file_);
            require(was.is_object() && was.contains("job") && was.contains("done") &&
                        was["done"].is_array(),
                    file_.string(), "is no record of `rye avatar`");
            require(was["job"] == job, work.string(),
                    "holds what other videos or options began; --work names another folder");
            record_ = was;
            return;
        }
        require(!fs::exists(work) || fs::is_empty(work), work.string(),
                "is not empty and has no avatar.json, expected a new folder");
        fs::create_directories(work);
        record_ = {{"job", job}, {"done", Json::array()}};
        save();
    }
    bool has(const std::string& step) const {
        const Json& done = record_["done"];
        return std::find(done.begin(), done.end(), Json(step)) != done.end();
    }
    void add(const std::string& step) {
        record_["done"].push_back(step);
        save();
    }

  private:
    void save() const { write_atomic(file_, as_bytes(record_.dump(2) + "\n")); }
    fs::path file_;
    Json record_;
};

/// Shows which step is at work, and the last line that it printed, which has the time left.
class StepLine {
  public:
    StepLine(std::size_t steps, bool quiet)
        : steps_(steps),
          quiet_(quiet),
          terminal_(is_terminal(Stream::output)) {}

    void show(std::size_t step, const std::string& doing, const std::string& words,
              bool last = false) {
        const std::string line = std::to_string(step + 1) + " of " + std::to_string(steps_) + "  " +
                                 doing + (words.empty() ? "" : ": " + words);
        if (quiet_ || (line == shown_ && !last)) return;
        shown_ = line;
        if (!terminal_) {
            std::cout << line << std::endl;
            return;
        }
        const std::size_t width = std::max<std::size_t>(20, terminal_width());
        std::cout << "\r\033[K" << line.substr(0, width - 1) << (last ? "\n" : "") << std::flush;
    }

  private:
    std::size_t steps_;
    bool quiet_, terminal_;
    std::string shown_;
};

Json job_of(const AvatarOptions& o, const std::string& preset) {
    Json sources = Json::array();
    for (const fs::path& file : o.video.files)
        sources.push_back(fs::weakly_canonical(file).string());
    return {{"source", sources},
            {"every", o.video.every},
            {"frames", o.video.frames},
            {"focal", o.video.focal},
            {"iris_mm", o.video.iris_mm},
            {"dots", o.video.dots.empty() ? "" : fs::weakly_canonical(o.video.dots).string()},
            {"preset", preset},
            {"config", o.config.empty() ? "" : fs::weakly_canonical(o.config).string()}};
}

/// Throws an Error, before anything is written, for files that are not there and for tools that
/// are missing.
void check_sources(const VideoImport& v) {
    if (!v.dots.empty()) static_cast<void>(read_gaze_dots(v.dots));
    bool tracked = true;
    for (const fs::path& file : v.files) {
        require(fs::exists(file), file.string(), "no such file or folder");
        tracked = tracked && fs::exists(file / "tracks.jsonl");
    }
    if (!tracked) static_cast<void>(find_video_tools({v.modules, v.landmarker, v.tracker}));
}

std::vector<Step> steps_of(const AvatarOptions& o, const std::string& preset) {
    const fs::path work = work_of(o), capture = work / "capture", run = work / "run";
    const std::string threads = std::to_string(o.threads);
    const auto number = [](double x) {
        char text[40];
        std::snprintf(text, sizeof text, "%.17g", x);
        return std::string(text);
    };
    std::vector<std::string> import{"import", "video"};
    for (const fs::path& file : o.video.files) import.push_back(file.string());
    const int size = preset == "gpu" ? size_of_device : size_of_cpu;
    for (const auto& [name, value] : std::vector<std::pair<std::string, std::string>>{
             {"--out", capture.string()},
             {"--size", std::to_string(size)},
             {"--every", o.video.every > 0 ? std::to_string(o.video.every) : ""},
             {"--frames", std::to_string(o.video.frames)},
             {"--focal", o.video.focal > 0 ? number(o.video.focal) : ""},
             {"--iris-mm", number(o.video.iris_mm)},
             {"--dots", o.video.dots.string()},
             {"--modules", o.video.modules.string()},
             {"--landmarker", o.video.landmarker.string()},
             {"--tracker", o.video.tracker.string()},
             {"--threads", threads}})
        if (!value.empty()) import.insert(import.end(), {name, value});
    std::vector<std::string> train{"train",    "--capture", capture.string(), "--out", run.string(),
                                   "--preset", preset,      "--threads",      threads};
    if (!o.config.empty()) train.insert(train.end(), {"--config", o.config.string()});
    return {{"import", "finding the head in the video", import},
            {"train", "training", train},
            {"export",
             "writing the avatar",
             {"export", "--run", run.string(), "--out", o.out.string()}},
            {"sheet",
             "drawing a sheet of gazes",
             {"redirect", "--run", run.string(), "--sweep", "--out", sheet_of(o).string(),
              "--threads", threads}}};
}

/// Throws an Error if the imported capture cannot be trained on; prints what to expect of it.
void follow_verdict(const fs::path& capture, bool quiet) {
    std::vector<std::string> expect;
    static_cast<void>(read_trainable_capture(capture, &expect));
    for (const std::string& words : expect)
        if (!quiet) std::cerr << "rye avatar: warning: " << words << "\n";
}

int make_avatar(const AvatarOptions& o) {
    require(o.out.extension() == ".avatar", "--out", "got '", o.out.string(),
            "', expected a name that ends in .avatar");
    const std::string preset = !o.preset.empty()     ? o.preset
                               : find_device().found ? std::string("gpu")
                                                     : std::string("cpu");
    check_sources(o.video);
    const fs::path work = work_of(o);
    Record record(work, job_of(o, preset));
    const FolderLock lock(work, {"rye avatar"});
    std::vector<Step> steps = steps_of(o, preset);
    StepLine line(steps.size(), o.quiet);
    using Clock = std::chrono::steady_clock;
    const auto began = Clock::now();
    for (std::size_t i = 0; i < steps.size(); ++i) {
        Step& step = steps[i];
        const bool lost = (step.name == "export" && !fs::exists(o.out)) ||
                          (step.name == "sheet" && !fs::exists(sheet_of(o)));
        if (record.has(step.name) && !lost) continue;
        if (step.name == "train") {
            follow_verdict(work / "capture", o.quiet);
            if (fs::exists(checkpoint_path(work / "run")))
                step.words = {"train",    "--out",     (work / "run").string(),
                              "--resume", "--threads", std::to_string(o.threads)};
        }
        const fs::path log = work / (step.name + ".log");
        ChildResult result;
        const int signal = run_children(
            {{step.name, {step.words}, log}}, 1,
            [&](std::size_t, const ChildResult& r) { result = r; },
            [&] {
                line.show(i, step.doing, last_line(log));
                return false;
            });
        if (signal != 0) {
            std::cerr << "rye avatar: stopped; the same command goes on\n";
            return 128 + signal;
        }
        // The command has said what is wrong; the log of its answers has more.
        require(result.code == 0, "rye avatar", "step `rye ", step.words[0],
                "` failed: ", result.message.empty() ? last_line(log) : result.message,
                "; its log is ", log.string());
        line.show(i, step.doing, "done in " + clock_text(result.seconds), true);
        if (!lost || !record.has(step.name)) record.add(step.name);
    }
    if (o.quiet) return 0;
    const double seconds = std::chrono::duration<double>(Clock::now() - began).count();
    std::cout << "avatar    " << o.out.string() << ", after " << clock_text(seconds) << "\n"
              << "sheet     " << sheet_of(o).string() << "\n"
              << "next      `rye view " << o.out.string() << "`; " << work.string()
              << " has the capture and the run, and may be removed\n";
    return 0;
}

} // namespace

void add_avatar(CLI::App& app) {
    const auto o = std::make_shared<AvatarOptions>();
    CLI::App* c = app.add_subcommand(
        "avatar", "Make an avatar of videos of a head: import, train, export (docs/video.md)");
    add_video_options(*c, o->video);
    c->add_option("--out", o->out,
                  "File of the avatar, NAME.avatar; NAME.png becomes a sheet of gazes")
        ->required();
    c->add_option(
        "--work", o->work,
        "Folder of the capture and the run, by which an interrupted command goes on (default: "
        "NAME.avatar.work)");
    c->add_option("--preset", o->preset,
                  "Preset of the training (default: gpu where there is a device, else cpu)")
        ->check(CLI::IsMember({"tiny", "cpu", "gpu"}));
    c->add_option("--config", o->config, "JSON file whose fields replace the preset's");
    add_threads(*c, o->threads, "Threads; the files do not depend on it (0: all)");
    c->add_flag("--quiet", o->quiet, "No progress line and no summary");
    c->callback([o] {
        if (const int code = make_avatar(*o); code != 0) throw CLI::RuntimeError(code);
    });
}

} // namespace rye::trainer
