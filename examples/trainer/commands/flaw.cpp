// SPDX-License-Identifier: Apache-2.0
/// `rye flaw`: copies a capture with chosen errors.
#include <iostream>
#include <memory>
#include <vector>

#include <CLI/CLI.hpp>

#include "commands/commands.hpp"
#include "commands/options.hpp"
#include "data/flaws.hpp"
#include "data/threads.hpp"

namespace rye::trainer {
namespace {

struct FlawArguments {
    FlawOptions flaws;
    std::string seed = "0", labels = "train", pictures = "all";
    std::vector<double> pose; // [deg], [mm]
    int jpeg = 0, threads = 0;
    bool quiet = false;
};

FlawedFrames frames_of(const std::string& word) {
    return word == "all" ? FlawedFrames::all : FlawedFrames::train;
}

void write_copy(FlawArguments o) {
    set_threads(o.threads);
    FlawOptions& f = o.flaws;
    f.seed = parsed_seed(o.seed, "--seed");
    f.labels = frames_of(o.labels);
    f.pictures = frames_of(o.pictures);
    f.sizes[Flaw::jpeg] = o.jpeg;
    if (!o.pose.empty()) {
        f.sizes[Flaw::pose_rotation] = o.pose[0];
        f.sizes[Flaw::pose_position] = o.pose[1];
    }
    const FlawReport report = write_flawed(f);
    if (o.quiet) return;
    std::cout << report.text(f) << f.out.string() << ": flaws of labels in " << report.label_frames
              << " frames, of pictures in " << report.picture_frames << "; " << report.views
              << " views, " << report.views_left_out << " left out; " << report.verdict << "\n";
}

} // namespace

void add_flaw(CLI::App& app) {
    const auto o = std::make_shared<FlawArguments>();
    CLI::App* c = app.add_subcommand(
        "flaw", "Copy a capture with chosen errors of labels and pictures put in");
    FlawSizes& sizes = o->flaws.sizes;
    c->add_option("--capture", o->flaws.capture, "Folder of the capture to copy")
        ->required()
        ->check(folder_check("the folder of a capture (`rye info` checks one)"));
    c->add_option("--out", o->flaws.out, "Folder to write; it must not be there")->required();
    c->add_option("--seed", o->seed, "Seed of all errors: any whole number below 2^64")
        ->check(read_check(parsed_seed))
        ->capture_default_str();
    const auto size = [&](Flaw flaw, double most, const char* help) {
        return c->add_option(std::string("--") + kind_of(flaw).name, sizes[flaw], help)
            ->check(from_to(0.0, most));
    };
    size(Flaw::gaze_common, 45, "Yaw and pitch of a frame's gaze, both eyes alike [degrees]");
    size(Flaw::gaze_single, 45, "Yaw and pitch of each eye's gaze [degrees]");
    size(Flaw::centres, 50, "Each coordinate of an eyeball's centre in a frame [mm]");
    size(Flaw::expression, 10, "Expression coefficients of a frame");
    c->add_option("--expression-share", o->flaws.expression_share,
                  "Share of the coefficients that --expression changes")
        ->check(from_to(0.0, 1.0))
        ->needs("--expression")
        ->capture_default_str();
    c->add_option("--pose", o->pose, "Head pose of a frame: DEG,MM, each axis [degrees, mm]")
        ->delimiter(',')
        ->expected(2)
        ->check(from_to(0.0, 90.0));
    size(Flaw::landmarks, 50, "Each coordinate of a landmark or vertex [mm]");
    size(Flaw::camera_rotation, 45, "Rotation of a camera about each of its axes [degrees]");
    size(Flaw::camera_position, 1000, "Each coordinate of a camera's position [mm]");
    size(Flaw::focal, 50, "Focal length of a camera [percent]");
    size(Flaw::gain, 100, "Gain of a camera, linear light [percent]");
    size(Flaw::white_balance, 100, "Gain of each channel of a camera, linear light [percent]");
    size(Flaw::exposure, 100, "Gain of a frame, all cameras alike, linear light [percent]");
    size(Flaw::vignetting, 100, "Light lost in the corners of a camera's pictures [percent]");
    size(Flaw::blur, 50, "Blur of pictures, in linear light [px]");
    size(Flaw::noise, 128, "Noise of each channel of a pixel [of 255]");
    c->add_option("--jpeg", o->jpeg, "Pictures as JPEG of this quality, 1 to 100")
        ->check(from_to(1, 100));
    size(Flaw::soft_masks, 50, "Blur of masks [px]");
    size(Flaw::wrong_masks, 50, "Each coordinate of the displacement of a mask's outline [px]");
    size(Flaw::eye_mask_dilation, 50, "How far eye masks grow over the lids, exactly [px]");
    size(Flaw::drop_views, 1, "Share of the views that are left out, one a frame and camera stays");
    c->add_option("--one-camera", o->flaws.one_camera,
                  "The only camera of the copy, in all frames, by its name");
    c->add_option(
         "--labels", o->labels,
         "Frames whose labels get errors: gazes to landmarks, cameras, masks, views left out")
        ->check(CLI::IsMember({"train", "all"}))
        ->capture_default_str();
    c->add_option("--pictures", o->pictures,
                  "Frames whose pictures get errors: gains, vignetting, blur, noise, JPEG")
        ->check(CLI::IsMember({"all", "train"}))
        ->capture_default_str();
    add_memory(*c);
    add_threads(*c, o->threads, "Threads; the files do not depend on it (0: all)");
    c->add_flag("--quiet", o->quiet, "No summary");
    c->footer(
        "Sizes are standard deviations of normal distributions, of percents those of a logarithm; "
        "of blurs that of the kernel.\nEach kind of error has random numbers of its own. --out has "
        "flaws.json, which tells what was put in.");
    c->callback([o] { write_copy(*o); });
}

} // namespace rye::trainer
