// SPDX-License-Identifier: Apache-2.0
/// `rye refine`: writes a capture with labels corrected by its photographs and a trained avatar, or
/// by each other and the irises in its photographs.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>

#include <CLI/CLI.hpp>

#include "commands/commands.hpp"
#include "commands/options.hpp"
#include "corrections/cameras.hpp"
#include "corrections/labels.hpp"
#include "data/corrected_cameras.hpp"
#include "data/degrees.hpp"
#include "data/samples.hpp"
#include "data/threads.hpp"
#include "data/validate.hpp"
#include "device/choice.hpp"
#include "training/refine.hpp"

namespace rye::trainer {
namespace {

struct RefineCommand {
    std::filesystem::path run, capture, out;
    std::string frames = "train", expression = "none", points = "auto", device = "auto";
    double gaze_sigma = 4, rotation_sigma = 1; ///< [deg]
    bool no_gaze = false, no_pose = false;
    int threads = 0;
    RefineOptions options;
};

/// Returns the root mean square of some of the unknowns.
double rms(const VecX<double>& v) {
    return v.size() == 0 ? 0 : std::sqrt(v.squaredNorm() / static_cast<double>(v.size()));
}

void print_head(const LabelUnknowns& u) {
    std::printf("%td unknowns a frame: gaze %td, head pose %td, expression %zu\n", u.count(),
                u.gaze_count(), u.pose_count(), u.expression.size());
    std::printf("%-12s %8s %8s %6s %9s %9s %9s %9s\n%-12s %8s %8s %6s %9s %9s %9s %9s\n", "frame",
                "residual", "refined", "steps", "gaze", "sigma", "rotation", "transl.", "", "[1/255]",
                "[1/255]", "", "[deg]", "[deg]", "[deg]", "[unit]");
}

void print_frame(const Capture& capture, const LabelUnknowns& u, const RefinedFrame& f) {
    const RefinedLabels& r = f.found;
    const Index g = u.gaze_count(), p = u.pose_count() / 2;
    std::printf("%-12s %8.2f %8.2f %6d %9.2f %9.2f %9.2f %9.4f%s\n",
                capture.frames[static_cast<std::size_t>(f.frame)].id.c_str(),
                255 * r.first_residual, 255 * r.residual, r.steps, rms(r.change.head(g)) / degree,
                rms(r.sigma.head(g)) / degree, rms(r.change.segment(g, p)) / degree,
                rms(r.change.segment(g + p, p)), r.settled ? "" : "  not settled");
    std::fflush(stdout);
}

/// Refines without a run: corrects labels by each other and by irises, as `rye train` does.
void refine_by_labels(const RefineCommand& o) {
    require(!o.capture.empty(), "rye refine", "--capture is missing, expected the folder of a "
                                              "capture where no run is named");
    require(o.frames == "train", "rye refine", "--frames all needs a run, expected train: without "
                                               "one the labels of training frames are corrected");
    Capture capture = read_valid_capture(o.capture);
    check_new_capture(capture.folder, o.out);
    require(capture.has_gaze(), capture.folder.string(),
            "a frame has no params/<frame>/gaze.npz, expected a gaze to begin from");
    const std::vector<CaptureFrame> before = capture.frames;
    const CameraFindings cameras = correct_cameras(capture, preset("cpu"));
    const LabelFindings found = correct_labels(capture, preset("cpu"));
    std::vector<LabelChange> changes;
    nlohmann::ordered_json frames = nlohmann::ordered_json::object();
    for (const int f : capture.train) {
        const auto i = static_cast<std::size_t>(f);
        changes.push_back(change_between(before[i], capture.frames[i]));
        if (!found.moved.empty()) changes.back().points = found.moved[changes.size() - 1];
        const LabelChange& c = changes.back();
        const auto angles = [&](std::size_t e) {
            return std::vector<double>{c.gaze[e][0] / degree, c.gaze[e][1] / degree};
        };
        frames[c.frame] = {{"gaze_left", angles(0)},
                           {"gaze_right", angles(1)},
                           {"pose", std::vector<double>(c.pose.data(), c.pose.data() + 6)}};
    }
    // Eyeballs that were not measured are placed in all frames.
    for (std::size_t i = 0; i < before.size(); ++i)
        if (!std::count(capture.train.begin(), capture.train.end(), static_cast<int>(i)) &&
            before[i].has_centres != capture.frames[i].has_centres)
            changes.push_back(change_between(before[i], capture.frames[i]));
    nlohmann::ordered_json record = {{"capture", capture.folder.string()}};
    record["cameras"] = cameras.json();
    record.update(found.json());
    record["changes"] = frames;
    write_changed_capture(capture.folder, o.out, changes, HeadPoints::kept,
                          {{{"refine.json", record}}, capture.corrected_cameras});
    for (const std::string& line : cameras.lines()) std::printf("%s\n", line.c_str());
    for (const std::string& line : found.lines()) std::printf("%s\n", line.c_str());
    std::printf("%s\n%s\n", o.out.string().c_str(), (o.out / "refine.json").string().c_str());
}

/// Returns the device that draws, or null for the CPU, and says why where that is no wish.
std::unique_ptr<DeviceLabels> device_of(const RefineCommand& o, const TrainState& state,
                                        const PlayableAvatar<float>& avatar) {
    const DeviceWish wish = device_wish(o.device);
    DeviceDecision decision = decided(wish, state.config, find_device());
    if (decision.device) try {
            return device_labels(avatar.avatar, avatar.config, avatar.roles);
        } catch (const Error& e) { // too little memory
            require(wish == DeviceWish::automatic, "--device",
                    std::string("got cuda, but ") + e.what());
            decision.reason = e.what();
        }
    if (!decision.reason.empty())
        std::printf("pictures are drawn on the CPU: %s\n", decision.reason.c_str());
    return nullptr;
}

/// Returns whether landmarks, vertices and eyeball centres move with a head whose pose changes.
/// Returns how points of the head are taken. Those of a face model were fitted with the pose and
/// agree with it; those that do not were measured apart from it.
HeadPoints head_points(const RefineCommand& o, const std::filesystem::path& folder) {
    if (o.points != "auto") return o.points == "kept" ? HeadPoints::kept : HeadPoints::moved;
    if (o.no_pose) return HeadPoints::moved;
    Capture capture = read_valid_capture(folder); // of its own, which is corrected
    take_corrected(capture, load_corrected_cameras(o.run));
    for (const LabelFinding& f : correct_labels(capture, preset("cpu")).all)
        if (f.label == "head poses" && f.wrong) {
            std::printf("landmarks and eyeballs stay where they were measured: by them head poses "
                        "are %.2f %s off\n",
                        f.off, f.unit.c_str());
            return HeadPoints::kept;
        }
    return HeadPoints::moved;
}

void refine(RefineCommand o) {
    set_threads(o.threads);
    if (o.run.empty()) return refine_by_labels(o);
    const TrainState state = load_trained(o.run);
    Capture capture = read_valid_capture(capture_folder(o.run, state, o.capture, "refining"));
    check_new_capture(capture.folder, o.out);
    require_same_subject(state, capture);
    take_corrected(capture, load_corrected_cameras(o.run));
    require(capture.has_gaze(), capture.folder.string(),
            "a frame has no params/<frame>/gaze.npz, expected a gaze to begin from");
    require_gazes(capture, state.config.gaze_axis);
    LabelUnknowns& u = o.options.unknowns;
    u.gaze = !o.no_gaze;
    u.pose = !o.no_pose;
    u.gaze_sigma = o.gaze_sigma * degree;
    u.rotation_sigma = o.rotation_sigma * degree;
    o.options.expression = o.expression == "none"  ? RefinedExpression::none
                           : o.expression == "all" ? RefinedExpression::all
                                                   : RefinedExpression::active;
    std::vector<int> frames = capture.train;
    if (o.frames == "all") {
        frames.clear();
        for (int f = 0; f < capture.frame_count(); ++f) frames.push_back(f);
    }
    LabelUnknowns listed = u;
    listed.expression = refined_coefficients(capture, o.options.expression);
    require(listed.count() > 0, "rye refine",
            "--no-gaze, --no-pose and no expression leave nothing to refine");
    const PlayableAvatar<float> avatar = refined_avatar(state, capture);
    const std::unique_ptr<DeviceLabels> device = device_of(o, state, avatar);
    o.options.device = device.get();
    const HeadPoints points = head_points(o, capture.folder);
    print_head(listed);
    const RefinedCapture refined =
        refine_capture(avatar, state.config.gaze_axis, capture, frames, o.options,
                       [&](const RefinedFrame& f) { print_frame(capture, listed, f); });
    nlohmann::ordered_json record = {{"run", o.run.string()},
                                     {"capture", capture.folder.string()},
                                     {"step", state.step}};
    record.update(refine_record(refined, capture, o.options));
    write_changed_capture(capture.folder, o.out, label_changes(refined, capture),
                          points,
                          {{{"refine.json", record}}, capture.corrected_cameras});
    const VecX<double>& mean = refined.mean;
    if (u.gaze)
        std::printf("mean change taken off the gazes: left %.2f, %.2f, right %.2f, %.2f deg of "
                    "pitch and yaw\n",
                    mean[0] / degree, mean[1] / degree, mean[2] / degree, mean[3] / degree);
    for (const RefinedFrame& f : refined.frames)
        if (f.outlier)
            std::printf("frame %s: its residual of %.2f/255 is far from the others': look at its "
                        "photographs\n",
                        capture.frames[static_cast<std::size_t>(f.frame)].id.c_str(),
                        255 * f.found.residual);
    std::printf("%s\n%s\n", o.out.string().c_str(), (o.out / "refine.json").string().c_str());
}

} // namespace

void add_refine(CLI::App& app) {
    auto o = std::make_shared<RefineCommand>();
    CLI::App* c = app.add_subcommand(
        "refine", "Correct a capture's gazes, head poses and expressions");
    c->add_option("run", o->run, "Folder of the run (default: none, labels are corrected by each "
                                 "other and by irises, as `rye train` does)")
        ->check(folder_check("the folder of a run with its checkpoint"));
    c->add_option("--capture", o->capture, "Folder of the capture (default: the one trained on)")
        ->check(folder_check("the folder of a capture"));
    c->add_option("--out", o->out, "Folder of the new capture")->required();
    c->add_option("--frames", o->frames, "Frames that are refined; the others keep their labels")
        ->check(CLI::IsMember({"train", "all"}))
        ->capture_default_str();
    c->add_option("--size", o->options.size, "Largest side of the pictures that are compared [px]")
        ->check(from_to(16, 4096))
        ->capture_default_str();
    c->add_flag("--no-gaze", o->no_gaze, "Gazes keep their labels");
    c->add_flag("--no-pose", o->no_pose, "Head poses keep their labels");
    c->add_option("--expression", o->expression,
                  "Coefficients that are refined; active: those that differ between frames")
        ->check(CLI::IsMember({"none", "active", "all"}))
        ->capture_default_str();
    c->add_option("--gaze-sigma", o->gaze_sigma, "How far off an angle of a gaze may be [deg]")
        ->check(from_to(1e-6, 60.0))
        ->capture_default_str();
    c->add_option("--rotation-sigma", o->rotation_sigma,
                  "How far off an angle of the head may be [deg]")
        ->check(from_to(1e-6, 60.0))
        ->capture_default_str();
    c->add_option("--translation-sigma", o->options.unknowns.translation_sigma,
                  "How far off a coordinate of the head may be [world units]")
        ->check(from_to(1e-9, 1e9))
        ->capture_default_str();
    c->add_option("--expression-sigma", o->options.unknowns.expression_sigma,
                  "How far off a coefficient may be")
        ->check(from_to(1e-9, 1e9))
        ->capture_default_str();
    c->add_option("--steps", o->options.settings.levenberg.steps,
                  "Most steps of a frame in each of two rounds")
        ->check(from_to(1, 1000))
        ->capture_default_str();
    c->add_flag("--keep-gaze-mean", o->options.keep_gaze_mean,
                "The mean change of the gazes stays; else it is left to the avatar's kappa");
    c->add_flag("--keep-pose-mean", o->options.keep_pose_mean,
                "The mean change of the head poses stays");
    c->add_option("--points", o->points,
                  "Landmarks, vertices and eyeball centres move with the head, or are kept in the "
                  "world; auto: kept where they say that head poses are off")
        ->check(CLI::IsMember({"auto", "moved", "kept"}))
        ->capture_default_str();
    add_device(*c, o->device, drawing_device_help);
    add_memory(*c);
    add_threads(*c, o->threads);
    c->callback([o] { refine(*o); });
}

} // namespace rye::trainer
