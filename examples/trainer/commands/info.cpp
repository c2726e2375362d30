// SPDX-License-Identifier: Apache-2.0
#include "commands/info.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include <rye/rig/gaze.hpp>

#include "commands/commands.hpp"
#include "commands/info_effects.hpp"
#include "commands/info_json.hpp"
#include "commands/number.hpp"
#include "commands/options.hpp"
#include "corrections/camera_colours.hpp"
#include "corrections/cameras.hpp"
#include "corrections/labels.hpp"
#include "corrections/lights.hpp"
#include "data/checksums.hpp"
#include "data/degrees.hpp"
#include "data/validate.hpp"
#include "device/device.hpp"
#include "model/run.hpp"

namespace rye::trainer {
namespace {

/// Returns a line "label   text".
std::string line(const std::string& label, const std::string& text) {
    return label + std::string(label.size() < 14 ? 14 - label.size() : 1, ' ') + text + "\n";
}

struct Range {
    double low = INFINITY, high = -INFINITY;
    void add(double x) {
        low = std::min(low, x);
        high = std::max(high, x);
    }
    std::string text(int decimals) const {
        return number(low, decimals) + " to " + number(high, decimals);
    }
};

/// Returns runs of consecutive frames: "0000 to 0031, 0040".
std::string frame_list(const Capture& c, std::vector<int> frames) {
    std::sort(frames.begin(), frames.end());
    std::string out = std::to_string(frames.size());
    if (frames.empty()) return out;
    out += " (";
    for (std::size_t i = 0; i < frames.size();) {
        std::size_t j = i;
        while (j + 1 < frames.size() && frames[j + 1] == frames[j] + 1) ++j;
        out += (i == 0 ? "" : ", ") + c.frames[static_cast<std::size_t>(frames[i])].id;
        if (j > i) out += " to " + c.frames[static_cast<std::size_t>(frames[j])].id;
        i = j + 1;
    }
    return out + ")";
}

std::string describe_cameras(const Capture& c) {
    std::string rows, missed;
    Range yaw, pitch, distance;
    for (int k = 0; k < c.camera_count(); ++k) {
        int frame = 0, absent = 0;
        for (int f = c.frame_count() - 1; f >= 0; --f) {
            if (c.view(f, k).present)
                frame = f;
            else
                ++absent;
        }
        const std::string& id = c.camera_ids[static_cast<std::size_t>(k)];
        if (absent > 0)
            missed += (missed.empty() ? "" : ", ") + id + " (" + std::to_string(absent) + ")";
        if (absent == c.frame_count()) continue;
        const Pinhole<double>& camera = c.camera(frame, k);
        const Vec3<double> head =
            c.frames[static_cast<std::size_t>(frame)].landmarks.rowwise().mean();
        const Vec3<double> from_head = camera.centre() - head;
        const Vec2<double> angles = degrees * pitch_yaw(from_head);
        const double away = norm(from_head);
        yaw.add(angles[1]);
        pitch.add(angles[0]);
        distance.add(away);
        char row[160];
        std::snprintf(row, sizeof row,
                      "  %-12s yaw %7.1f   pitch %6.1f   distance %6.2f   focal %8.1f px\n",
                      id.c_str(), angles[1], angles[0], away, camera.fx);
        rows += row;
    }
    std::string out =
        line("cameras", std::to_string(c.camera_count()) + ": yaw " + yaw.text(1) + ", pitch " +
                            pitch.text(1) + " degrees, distance " + distance.text(2));
    if (!missed.empty()) out += line("", "frames missed: " + missed);
    return out + rows;
}

std::string describe_gaze(const Capture& c) {
    std::string out;
    if (!c.has_gaze()) return line("gaze", "not of every frame: the eyes cannot be trained");
    for (std::size_t e = 0; e < 2; ++e) {
        Range yaw, pitch;
        for (const CaptureFrame& f : c.frames) {
            const Vec2<double> angles = degrees * pitch_yaw(f.eyes[e].optical);
            pitch.add(angles[0]);
            yaw.add(angles[1]);
        }
        const CaptureEye& eye = c.frames.front().eyes[e];
        std::string text = "yaw " + yaw.text(1) + ", pitch " + pitch.text(1) + " degrees";
        if (eye.kappa)
            text += ", kappa yaw " + number((*eye.kappa)[0], 2) + " pitch " +
                    number((*eye.kappa)[1], 2);
        if (eye.radius) text += ", radius " + number(*eye.radius, 3);
        if (eye.limbus_radius) text += ", limbus " + number(*eye.limbus_radius, 3);
        out += line(e == 0 ? "gaze left" : "gaze right", text);
    }
    return out + line("eye centres", c.has_centres() ? "measured" : "none: placed by the irises, or else by the lids") +
           line("eye masks", c.has_eye_masks ? "in every view" : "not in every view");
}

/// Returns the device that `rye train` would use, or why there is none; empty in a build without
/// kernels.
std::string describe_device(const DeviceFinding& device) {
    if (!device.built) return "";
    if (!device.found) return line("device", "none (" + device.reason + ")");
    return line("device", device.found->name + ", " + number(device.found->free / 1e9, 1) + " of " +
                              number(device.found->total / 1e9, 1) + " GB free");
}

/// Returns the errors of the labels of a trainable capture; `cameras` receives those of its
/// cameras, which come first. Corrects both in the capture.
LabelFindings judged_labels(Capture& capture, const Verdict& verdict, CameraFindings& cameras) {
    if (verdict.errors > 0 || capture.train.empty() || !capture.has_gaze()) return {};
    cameras = correct_cameras(capture, preset("cpu"));
    LabelFindings found = correct_labels(capture, preset("cpu"));
    for (LabelFinding& f : correct_colours(capture, preset("cpu"))) found.all.push_back(std::move(f));
    return found;
}

/// Prints the lights of a run's avatar.
void describe_run(const std::filesystem::path& run, bool json) {
    const FoundLights lights = lights_of(load_trained(run).avatar);
    if (json) {
        nlohmann::ordered_json about = {{"run", run.string()}};
        about["lights"] = lights.json().at("lights");
        std::cout << about.dump(2) << "\n";
        return;
    }
    std::cout << line("run", run.string());
    if (lights.lights.empty())
        std::cout << line("lights", "none: no highlights are drawn");
    else
        for (const std::string& words : lights.lines()) std::cout << line("lights", words);
}

/// Returns the lights that a capture's eyes show; none of one that cannot be trained on.
FoundLights lights_of(const Capture& capture) {
    if (capture.train.empty() || !capture.has_gaze()) return {};
    return find_lights(capture, describe_subject(capture, preset("cpu")));
}

} // namespace

std::string describe(const Capture& c) {
    const std::string subject = c.subject.empty() ? "" : " (subject " + c.subject + ")";
    std::string out = line("capture", c.folder.string() + subject);
    if (c.frames.empty())
        return out + line("frames", "none could be read") +
               line("cameras", std::to_string(c.camera_count()));
    const LandmarkFit fit = fit_landmarks(c);
    out += line("frames", std::to_string(c.frame_count()));
    out += line("  training", frame_list(c, c.train));
    out += line("  test", frame_list(c, c.test));
    out += line("  novel gaze", frame_list(c, c.novel_gaze));
    out += line("  eyes apart", frame_list(c, c.independent_gaze));
    out += line("images", std::to_string(c.width) + " x " + std::to_string(c.height) +
                              (c.images_over_black ? ", over black" : ", photographs with a mask"));
    out += describe_cameras(c);
    out += line("expression", std::to_string(c.expression_width()) + " numbers a frame");
    out += line("landmarks", std::to_string(c.frames.front().landmarks.cols()) + ", and " +
                                 std::to_string(c.frames.front().vertices.cols()) +
                                 " vertices; they span " + number(landmark_span(c), 2) +
                                 " units (a head has about 2 dm)");
    out +=
        line("", number(100 * fit.inside_mask, 1) + " % of the landmarks fall into the masks of " +
                     std::to_string(fit.views) + " views");
    return out + describe_gaze(c);
}

void add_info(CLI::App& app) {
    struct Arguments {
        std::string folder;
        bool all = false, json = false;
        EffectsOptions options;
    };
    CLI::App* command = app.add_subcommand("info", "Describe a capture and check it; or say which "
                                                   "effects a scene calls for");
    const auto arguments = std::make_shared<Arguments>();
    command->add_option("--capture,DIR", arguments->folder,
                        "Folder of the capture; with --effects also a PLY file of Gaussians, or a "
                        "folder of photographs with a transforms.json");
    command->add_flag("--all-images", arguments->all, "Decode every image, not a sample");
    command->add_flag("--json", arguments->json, "Print the description and all faults as JSON");
    auto* effects = command->add_flag("--effects{auto}", arguments->options.variant,
                                      "Say which effects the scene calls for, and why; with "
                                      "--run, --effects=NAMES draws the avatar by these effects, "
                                      "or by a variant");
    command->add_option("--run", arguments->options.run,
                        "Folder of a run: its lights are printed; with --effects its avatar is "
                        "judged, too");
    command->add_option("--bound", arguments->options.bound,
                        "With --effects: the least change of a colour that counts; 0.004 or 1/255")
        ->check(read_check(parsed_error))
        ->needs(effects)
        ->capture_default_str();
    add_memory(*command);
    command->callback([arguments, effects] {
        if (effects->count() > 0) {
            arguments->options.scene = arguments->folder;
            if (arguments->json)
                std::cout << effects_json(arguments->options).dump(2) << "\n";
            else
                std::cout << explain_effects(arguments->options);
            return;
        }
        if (!arguments->options.run.empty()) {
            require(arguments->folder.empty(), "rye info",
                    "got a capture and --run without --effects, expected one of them");
            describe_run(arguments->options.run, arguments->json);
            return;
        }
        require(!arguments->folder.empty(), "rye info",
                "--capture is missing, expected the folder of a capture");
        std::vector<Problem> problems;
        Capture capture = read_capture(arguments->folder, {}, &problems);
        const std::vector<Problem> more =
            validate(capture, arguments->all ? ImagesToDecode::all : ImagesToDecode::sample);
        problems.insert(problems.end(), more.begin(), more.end());
        for (const std::string& sentence : changed_files(arguments->folder))
            problems.push_back({Problem::Severity::warning, sentence});
        if (arguments->json) {
            nlohmann::ordered_json json = info_json(capture, problems);
            CameraFindings cameras;
            const LabelFindings labels =
                judged_labels(capture, judge(capture, problems), cameras);
            json["camera_findings"] = cameras.empty() ? nlohmann::ordered_json() : cameras.json();
            json["label_findings"] = labels.empty() ? nlohmann::ordered_json() : labels.json();
            json["lights"] =
                json.at("errors").empty() ? lights_of(capture).json() : nlohmann::ordered_json();
            json["device"] = nullptr;
            if (const auto device = find_device().found)
                json["device"] = {
                    {"name", device->name}, {"free", device->free}, {"total", device->total}};
            std::cout << json.dump(2) << "\n";
            if (!json.at("errors").empty()) throw CLI::RuntimeError(1);
            return;
        }
        std::cout << describe(capture) << describe_device(find_device());
        for (const Problem& p : problems) {
            const bool error = p.severity == Problem::Severity::error;
            std::cout << (error ? "error:   " : "warning: ") << p.message << "\n";
        }
        const Verdict verdict = judge(capture, problems);
        CameraFindings cameras;
        const LabelFindings labels = judged_labels(capture, verdict, cameras);
        for (const std::string& words : cameras.lines()) std::cout << line("calibration", words);
        for (const std::string& words : labels.lines()) std::cout << line("labels", words);
        if (verdict.errors == 0)
            for (const std::string& words : lights_of(capture).lines())
                std::cout << line("lights", words);
        for (const std::string& words : verdict.expect) std::cout << "warning: " << words << "\n";
        std::cout << line("verdict", verdict.text());
        if (verdict.errors > 0) throw CLI::RuntimeError(1);
    });
}

} // namespace rye::trainer
