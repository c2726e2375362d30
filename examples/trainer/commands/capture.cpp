// SPDX-License-Identifier: Apache-2.0
/// `rye capture`: renders a calibrated multi-view capture of a procedural head or a model.

#include <chrono>
#include <cstdio>
#include <memory>

#include <CLI/CLI.hpp>

#include <rye/core/error.hpp>

#include "commands/commands.hpp"
#include "commands/film.hpp"
#include "commands/options.hpp"
#include "commands/progress.hpp"
#include "corrections/lights.hpp"
#include "data/gaze_dots.hpp"
#include "data/system.hpp"
#include "data/threads.hpp"
#include "synthetic_capture/video_scene.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

struct CaptureCommand {
    CaptureSettings settings;
    VideoSettings film;
    fs::path out, model, video, dots, lights;
    std::vector<double> gazes; ///< pitch and yaw of each [deg]
    double dots_begin = 0;
    int threads = 0;
    bool auto_exposure = false; ///< of the video
    bool overwrite = false, quiet = false;
};

fs::path beside(const fs::path& out, const char* suffix) {
    fs::path path = out.has_filename() ? out : out.parent_path();
    path += suffix;
    return path;
}

/// Throws an Error if --out exists, unless --overwrite is given and it is a capture.
void check_out(const CaptureCommand& o) {
    const std::string who = o.out.string();
    require(!o.out.empty() && (o.out.has_filename() || o.out.has_parent_path()), "capture",
            "--out is missing, expected a folder to write");
    if (!fs::exists(o.out) || (fs::is_directory(o.out) && fs::is_empty(o.out))) return;
    require(o.overwrite, who, "exists already; --overwrite replaces it");
    require(fs::exists(o.out / "capture.json"), who,
            "is not a capture (no capture.json), so --overwrite does not replace it");
}

/// Returns the lights of a file as the renderer has them.
std::vector<Softbox> read_softboxes(const fs::path& path) {
    std::vector<Softbox> boxes;
    for (const FoundLight& l : read_lights(path).lights) {
        const std::string who = path.string() + ": lights[" + std::to_string(boxes.size()) + "]";
        require(l.width <= most_light_width, who + ": width", "got ", l.width,
                " rad, expected at most ", most_light_width);
        for (const double x : l.intensity)
            require(x >= 0 && x <= most_highlight, who + ": intensity", "got ", x,
                    ", expected 0 to ", most_highlight);
        boxes.push_back(softbox_of(l.to, l.width, l.intensity));
    }
    return boxes;
}

/// Moves the finished folder to its place.
void publish(const fs::path& finished, const fs::path& out) {
    const fs::path old = beside(out, ".old");
    fs::remove_all(old);
    if (fs::exists(out)) fs::rename(out, old);
    fs::rename(finished, out);
    fs::remove_all(old);
}

void run(const CaptureCommand& o) {
    check_out(o);
    CaptureSettings settings = o.settings;
    if (!o.lights.empty()) settings.softboxes = read_softboxes(o.lights);
    require(o.gazes.size() % 2 == 0, "--gazes", "got ", o.gazes.size(),
            " numbers, expected a pitch and a yaw of each frame");
    for (std::size_t i = 0; i < o.gazes.size(); i += 2)
        settings.gazes.emplace_back(o.gazes[i + 1], o.gazes[i]);
    if (!o.video.empty()) check_film(o.video);
    set_threads(o.threads);
    const auto start = std::chrono::steady_clock::now();
    const auto seconds = [&] {
        return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    };
    const HeadModel model =
        o.model.empty() ? procedural_head(o.settings.seed, albedo_width_for(o.settings.size))
                        : ict_head(o.model, o.settings.seed);
    VideoSettings film = o.film;
    film.frames = o.settings.train_frames;
    if (!o.dots.empty()) {
        // Eyes take a fifth of a second to follow.
        constexpr double reaction = 0.2;
        film.dot = [dots = read_gaze_dots(o.dots), begin = o.dots_begin + reaction](double time) {
            const std::optional<GazeDot> dot = dot_at(dots, time - begin);
            return dot ? std::optional(dot->right_up) : std::nullopt;
        };
    }
    const CaptureScene scene =
        o.video.empty() ? capture_scene(model, settings) : video_scene(model, settings, film);
    // Written under another name, so that an interrupted capture cannot pass for a complete one.
    const fs::path unfinished = beside(o.out, ".tmp");
    fs::remove_all(unfinished);
    const bool terminal = is_terminal(Stream::output);
    try {
        write_capture(model, scene, unfinished, [&](int done, int of) {
            if (o.quiet || (!terminal && done != of && done % 8 != 0)) return;
            std::printf("%sframe %d of %d, %.0f s%s%s", terminal ? "\r\033[K" : "", done, of, seconds(),
                        left_words(seconds(), done, of).c_str(), terminal && done != of ? "" : "\n");
            std::fflush(stdout);
        });
        if (!o.video.empty()) write_film(unfinished, scene, {film.rate, o.auto_exposure}, o.video);
        publish(unfinished, o.out);
    } catch (...) {
        std::error_code ignored;
        fs::remove_all(unfinished, ignored);
        throw;
    }
    if (!o.quiet)
        std::printf("%s: %zu frames x %zu cameras, %d x %d pixels\n", o.out.string().c_str(),
                    scene.frames.size(), scene.cameras.size(), o.settings.size, o.settings.size);
}

} // namespace

void add_capture(CLI::App& app) {
    const auto o = std::make_shared<CaptureCommand>();
    CLI::App* c = app.add_subcommand(
        "capture", "Render a calibrated multi-view capture of a made-up head, with gaze labels");
    CaptureSettings& s = o->settings;
    c->add_option("--out", o->out, "Folder to write; it must not be there")->required();
    c->add_option("--frames", s.train_frames, "Training frames; with --video all of its pictures")
        ->capture_default_str();
    CLI::Option* const tests =
        c->add_option("--test-frames", s.novel_frames, "Test frames with gazes kept out of training")
            ->capture_default_str();
    CLI::Option* const apart = c->add_option("--apart-frames", s.independent_frames,
                                             "Test frames whose eyes look in directions of their own")
                                   ->capture_default_str();
    CLI::Option* const gazes =
        c->add_option(
             "--gazes", o->gazes,
             "PITCH,YAW,PITCH,YAW,...: further test frames of the head at rest, and where they "
             "look [deg]")
            ->delimiter(',');
    c->add_option("--size", s.size, "Edge of the images [px]")->capture_default_str();
    CLI::Option* const cameras =
        c->add_option("--cameras", s.cameras, "Cameras, 1 to 18")->capture_default_str();
    c->add_option("--samples", s.samples, "Rays a pixel")->capture_default_str();
    c->add_option("--seed", s.seed, "Seed of the subject and of all frames")->capture_default_str();
    c->add_option("--eye-translation", s.eye_translation_mm,
                  "Expression and head pose displace the eyeballs in the head, by less than this [mm]")
        ->capture_default_str();
    c->add_flag("--png", s.png, "Images as PNG without loss, which rye's headers read; else JPEG");
    c->add_option("--model", o->model,
                  "A head model as an npz with names.json beside it, instead of rye's own head: the "
                  "ICT face model (light), or what `rye pack` writes");
    c->add_option("--lights", o->lights,
                  "JSON file of lights beside the sky, instead of the usual two: what `rye info "
                  "--json` prints of a capture, or a list of {\"to\": [X, Y, Z], \"intensity\": "
                  "[R, G, B], \"width\": RADIANS}; frames and cameras stay as they are");
    c->add_flag("--refraction", s.refraction,
                "Irises are seen through corneas that refract (index 1.376); labels say where they "
                "are, not where they are seen");
    CLI::Option* const video =
        c->add_option(
             "--video", o->video,
             "Video of the same pictures to write, before a wall (.y4m, else by ffmpeg): one "
             "camera films the head while it turns, speaks and looks around")
            ->excludes(tests, apart, gazes, cameras);
    c->add_option("--rate", o->film.rate, "Pictures a second of the video")
        ->needs(video)
        ->capture_default_str();
    c->add_option("--turn", o->film.turn_deg, "Angle by which the head turns to both sides [deg]")
        ->needs(video)
        ->capture_default_str();
    c->add_flag("--hand-held", o->film.hand_held, "The camera sways as in a hand")->needs(video);
    c->add_flag("--auto-exposure", o->auto_exposure,
                "The video's brightness follows the picture, as a phone's does")
        ->needs(video);
    c->add_option("--dots", o->dots,
                  "CSV of dots on a screen that the eyes look at (docs/gaze_dots.html)")
        ->needs(video);
    c->add_option("--dots-begin", o->dots_begin, "When the dots' clock begins in the video [s]")
        ->needs(video)
        ->capture_default_str();
    add_threads(*c, o->threads, "Threads; the files do not depend on it (0: all)");
    c->add_flag("--overwrite", o->overwrite, "Replace a capture that is in --out");
    c->add_flag("--quiet", o->quiet, "No progress lines");
    c->callback([o] { run(*o); });
}

} // namespace rye::trainer
