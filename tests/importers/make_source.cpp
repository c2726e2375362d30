// SPDX-License-Identifier: Apache-2.0
/// make_import_source: sources for `rye import` with known truth, and what an import has of it. See
/// --help.
#include <iostream>
#include <string>

#include <CLI/CLI.hpp>

#include <rye/core/error.hpp>

#include "comparison.hpp"
#include "data/validate.hpp"
#include "sources.hpp"
#include "video_tracks_source.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

struct Options {
    std::string kind;
    fs::path folder, capture, model, out;
    int frames = 12, cameras = 6, size = 128;
    std::uint64_t errors = 0;
    bool gazes = false;
};

void make(const Options& o) {
    CaptureSettings s;
    s.train_frames = o.frames;
    s.cameras = o.cameras;
    s.size = o.size;
    s.novel_frames = 2;
    s.independent_frames = 1;
    TrueScene truth =
        o.capture.empty() ? true_scene(o.folder / "truth", s) : captured_scene(o.capture, o.model);
    const std::string& kind = o.kind;
    if (o.errors > 0) {
        const bool stills = kind == "colmap" || kind == "transforms" || kind == "blender";
        track(truth, o.folder / "tracked", tracker_errors(stills), o.errors);
    }
    const fs::path source = o.folder / "source";
    if (kind == "vhap") {
        write_vhap_source(truth, source);
    } else if (kind == "gha") {
        write_gha_source(truth, source, 0.1);
        write_gazes(truth, o.folder / "gaze.csv");
    } else if (kind == "blender") {
        write_blender_source(truth, source);
    } else if (kind == "transforms") {
        write_transforms_source(truth, source, true);
    } else if (kind == "colmap") {
        write_colmap_source(truth, source, ColmapFiles::binary, true);
    } else if (kind == "xgaze") {
        write_xgaze_source(truth, source, o.folder / "calibration", XgazeFields::normalization);
    } else {
        write_xgaze_source(truth, source, {}, XgazeFields::gazenerf);
    }
    std::cout << source.string() << "\n";
}

void print_comparison(const Options& o) {
    const Capture truth = read_capture(o.capture), got = read_capture(o.folder);
    std::cout << "training frames: " << compare(truth, got, truth.train).text() << "\n";
    if (!truth.test.empty())
        std::cout << "test frames: " << compare(truth, got, truth.test).text() << "\n";
}

int run(int argc, char** argv) {
    CLI::App app{"make_import_source: sources for `rye import` with known truth"};
    app.require_subcommand(1);
    Options o;
    for (const std::string kind :
         {"vhap", "gha", "xgaze", "gazenerf", "colmap", "transforms", "blender"}) {
        CLI::App* c = app.add_subcommand(
            kind, "Write FOLDER/truth, a synthetic capture, and FOLDER/source, made from it");
        c->add_option("FOLDER", o.folder)->required();
        c->add_option("FRAMES", o.frames, "Training frames; beside them there are 3 for tests")
            ->capture_default_str();
        c->add_option("CAMERAS", o.cameras)->capture_default_str();
        c->add_option("SIZE", o.size, "Edge of the pictures [px]")->capture_default_str();
        c->add_option("--capture", o.capture, "Truth instead: a folder of `rye capture`");
        c->add_option("--model", o.model, "Head model that this capture was made with");
        c->add_option("--errors", o.errors,
                      "Seed of the errors of a tracker, put into training frames (0: no errors)");
        c->callback([&o, kind] {
            o.kind = kind;
            make(o);
        });
    }
    CLI::App* v = app.add_subcommand(
        "video", "Write FOLDER, tracks of a video with plain pictures, for `rye import video`");
    v->add_option("FOLDER", o.folder)->required();
    v->add_option("FRAMES", o.frames, "Pictures of the video")->capture_default_str();
    v->add_option("SIZE", o.size, "Edge of the pictures [px]")->capture_default_str();
    v->callback([&o] {
        KnownVideo video;
        video.pictures = o.frames;
        video.size = o.size;
        video.focal = 1.1 * o.size;
        write_known_video(video, o.folder);
    });
    CLI::App* c =
        app.add_subcommand("compare", "Print the differences of an import from the truth");
    c->add_option("TRUTH", o.capture)->required();
    c->add_option("CAPTURE", o.folder)->required();
    c->callback([&o] { print_comparison(o); });
    CLI::App* t = app.add_subcommand(
        "tests", "Copy an import with true eyeballs and eye masks in its test frames");
    t->add_option("TRUTH", o.capture)->required();
    t->add_option("CAPTURE", o.folder)->required();
    t->add_option("OUT", o.out)->required();
    t->add_flag("--gazes", o.gazes,
                "With true optical axes, too: of an import that estimated them");
    t->callback([&o] {
        write_test_labels(read_capture(o.capture), read_capture(o.folder),
                          o.gazes ? TestGazes::true_axes : TestGazes::imported, o.out);
    });
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& e) {
        return app.exit(e);
    }
    return 0;
}

} // namespace
} // namespace rye::trainer

int main(int argc, char** argv) {
    try {
        return rye::trainer::run(argc, argv);
    } catch (const std::exception& e) {
        std::cerr << e.what() << "\n";
        return 1;
    }
}
