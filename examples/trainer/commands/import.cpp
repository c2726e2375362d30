// SPDX-License-Identifier: Apache-2.0
/// `rye import KIND SOURCE --out CAPTURE`: converts other programs' data to a capture.

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <iostream>
#include <memory>

#include <CLI/CLI.hpp>

#include <rye/core/error.hpp>

#include "commands/commands.hpp"
#include "commands/options.hpp"
#include "commands/video_options.hpp"
#include "data/system.hpp"
#include "data/threads.hpp"
#include "data/validate.hpp"
#include "importers/import_folder.hpp"

namespace rye::trainer {
namespace {

struct Arguments {
    ImportOptions options;
    int threads = 0;
    bool quiet = false;
};

using Importer = ImportSummary (*)(const ImportOptions&);

/// Returns the kinds in the order of --help, for the error about an unknown one.
std::string kinds_of(const CLI::App& command) {
    std::string all;
    const auto kinds = command.get_subcommands([](const CLI::App*) { return true; });
    for (const CLI::App* kind : kinds)
        all += (all.empty() ? "" : kind == kinds.back() ? " or " : ", ") + kind->get_name();
    return all;
}

/// Prints the verdict of `rye info`, so that the next command is known; returns true if the capture
/// has no errors.
bool print_verdict(const std::filesystem::path& out, bool quiet) {
    std::vector<Problem> problems;
    const Capture capture = read_capture(out, {}, &problems);
    const std::vector<Problem> more = validate(capture);
    problems.insert(problems.end(), more.begin(), more.end());
    const Verdict verdict = judge(capture, problems);
    for (const Problem& p : problems)
        if (p.severity == Problem::Severity::error)
            (quiet ? std::cerr : std::cout) << "error     " << p.message << "\n";
    if (quiet) return verdict.errors == 0;
    for (const std::string& words : verdict.expect) std::cout << "warning   " << words << "\n";
    std::cout << "verdict   " << verdict.text() << "\n"
              << "next      `rye info " << out.string() << "`"
              << (verdict.trainable() ? ", `rye train --capture " + out.string() +
                                            " --out RUN --preset tiny`"
                                      : "")
              << "\n";
    return verdict.errors == 0;
}

/// Returns what prints the pictures that are tracked, and the time left, on one line of a terminal
/// or now and then.
std::function<void(int, int)> tracking_progress(bool quiet, bool terminal) {
    const auto now = [] { return std::chrono::steady_clock::now(); };
    const auto begin = std::make_shared<std::pair<int, decltype(now())>>(-1, now());
    return [=](int done, int of) {
        if (begin->first < 0 || done <= begin->first) *begin = {done, now()};
        if (quiet || (!terminal && done != of && done % 50 != 0)) return;
        const double seconds = std::chrono::duration<double>(now() - begin->second).count();
        const double left = seconds / std::max(1, done - begin->first) * (of - done);
        std::printf("%spicture %d of %d tracked, %.0f s left   %s", terminal ? "\r" : "", done, of,
                    left, terminal && done != of ? "" : "\n");
        std::fflush(stdout);
    };
}

void run(const Arguments& a, Importer import) {
    set_threads(a.threads);
    ImportOptions options = a.options;
    const bool terminal = is_terminal(Stream::output);
    options.progress = [&](int done, int of) {
        if (a.quiet || (!terminal && done != of && done % 50 != 0)) return;
        std::printf("%sframe %d of %d%s", terminal ? "\r" : "", done, of,
                    terminal && done != of ? "" : "\n");
        std::fflush(stdout);
    };
    options.video.progress = tracking_progress(a.quiet, terminal);
    const ImportSummary summary = import(options);
    if (!a.quiet) std::cout << summary.text();
    if (summary.has_head) {
        if (!print_verdict(options.out, a.quiet)) throw CLI::RuntimeError(1);
    } else if (!a.quiet) {
        const std::string cameras = (options.out / "transforms.json").string();
        std::cout << "verdict   pictures and cameras of a still scene, without a head to train\n"
                  << "next      `rye render GAUSSIANS.ply --cameras " << cameras
                  << " --view 0 --out view.png`\n";
    }
}

CLI::App* add_kind(CLI::App& command, const std::shared_ptr<Arguments>& a, const char* name,
                   const char* help, Importer import) {
    CLI::App* kind = command.add_subcommand(name, help);
    if (import == import_video)
        add_video_options(*kind, a->options.video);
    else
        kind->add_option("SOURCE", a->options.source, "Folder or file to read")->required();
    kind->add_option("--out", a->options.out,
                     "Folder of the capture: a new one, or one that this command began")
        ->required();
    add_memory(*kind);
    add_threads(*kind, a->threads, "Threads; the files do not depend on it (0: all)");
    kind->add_flag("--quiet", a->quiet, "No progress lines and no summary");
    kind->callback([a, import] { run(*a, import); });
    return kind;
}

void add_allow_outside(CLI::App* kind, const std::shared_ptr<Arguments>& a) {
    kind->add_flag("--allow-outside", a->options.allow_outside,
                   "Take also files that the source names outside its folder (../x.png, /x.png)");
}

void add_video(CLI::App& command, const std::shared_ptr<Arguments>& a) {
    CLI::App* video = add_kind(command, a, "video",
                               "Videos of a head, tracked by MediaPipe in a browser (docs/video.md)",
                               import_video);
    video->add_option("--size", a->options.video.size, "Most pixels of a side of the capture's pictures")
        ->check(from_to(64, 4096))
        ->capture_default_str();
}

} // namespace

void add_import(CLI::App& app) {
    CLI::App* command = app.add_subcommand(
        "import", "Make a capture of other programs' data; an interrupted import is continued");
    const auto a = std::make_shared<Arguments>();
    CLI::App* vhap = add_kind(*command, a, "vhap", "FLAME tracking that VHAP exported, with meshes",
                              import_vhap);
    vhap->add_option("--eyeballs", a->options.eyeballs,
                     "First and last vertex of the left and of the right eyeball, for another "
                     "topology than FLAME's (3931 4476 4477 5022)");
    vhap->add_option("--landmarks", a->options.landmarks,
                     "File of 68 vertices in the order of iBUG, for another topology");
    add_allow_outside(vhap, a);
    CLI::App* gha = add_kind(*command, a, "gha",
                             "A folder of Gaussian Head Avatar, or a capture that lacks gaze or "
                             "eye masks",
                             import_gha);
    gha->add_option(
        "--gaze", a->options.gaze,
        "Gazes: CSV `frame,left_pitch,left_yaw,right_pitch,right_yaw` [degrees, head "
        "frame], or npz with gaze_left and gaze_right; without it the iris is searched");
    CLI::App* xgaze = add_kind(*command, a, "xgaze",
                               "An HDF5 file of one subject of ETH-XGaze, normalised, or of "
                               "GazeNeRF",
                               import_xgaze);
    xgaze->add_option("--calibration", a->options.calibration,
                      "Folder of the cameras' calibration, cam00.xml to cam17.xml");
    xgaze->add_option("--normalization", a->options.normalization,
                      "Focal length [px], distance [mm] and side [px] of the normalisation; "
                      "ETH-XGaze's are 960 300 448");
    add_allow_outside(add_kind(*command, a, "colmap",
                               "Pictures of a COLMAP model (sparse/0 and images)", import_colmap),
                      a);
    add_allow_outside(add_kind(*command, a, "transforms",
                               "Photographs with a transforms.json (nerfstudio), or of Blender's "
                               "layout (transforms_train.json)",
                               import_transforms),
                      a);
    add_video(*command, a);
    // A word that is no kind is left over with all that follows, so that the error names it, not an
    // option after it. (Kinds added after this call would also leave over what they do not know.)
    command->allow_extras();
    command->require_subcommand(0, 1);
    command->parse_complete_callback([command] {
        const std::vector<std::string> words = command->remaining();
        if (words.empty() && !command->get_subcommands().empty()) return;
        const std::string expected = ", expected " + kinds_of(*command);
        require(!words.empty(), "rye import", "a kind of source is missing", expected);
        throw Error("rye import: got '" + words.front() + "' for the kind of source" + expected);
    });
}

} // namespace rye::trainer
