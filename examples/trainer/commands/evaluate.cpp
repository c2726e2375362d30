// SPDX-License-Identifier: Apache-2.0
/// `rye evaluate`: image quality over head, face and eyes, and the gaze error by the paper's
/// protocol, with two controls for scale; writes results.json and per_view.json.
#include <algorithm>
#include <cstdio>
#include <iostream>
#include <map>
#include <memory>

#include <CLI/CLI.hpp>

#include <rye/io/atomic_file.hpp>
#include <rye/core/checksum.hpp>

#include "commands/commands.hpp"
#include "commands/lights_option.hpp"
#include "commands/options.hpp"
#include "corrections/camera_colours.hpp"
#include "corrections/centre_errors.hpp"
#include "corrections/highlight_spots.hpp"
#include "corrections/lights.hpp"
#include "data/checksums.hpp"
#include "data/corrected_cameras.hpp"
#include "data/threads.hpp"
#include "data/validate.hpp"
#include "evaluation/closed_lids.hpp"
#include "evaluation/evaluation.hpp"
#include "evaluation/head_alignment.hpp"
#include "evaluation/kappa_errors.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;

struct EvaluateOptions {
    std::filesystem::path run, capture, out, perceptual_weights, lights;
    std::string split = "test", device = "auto";
    bool json = false, align_head = false;
    double dilation = 0; ///< [px^2]; 0: not given
    int threads = 0;
};

std::string cell(const Mean& m, const char* format) {
    if (m.count == 0) return "-";
    char text[32];
    std::snprintf(text, sizeof text, format, m.value());
    return text;
}

/// Name of a row and its results.
using Row = std::pair<std::string, ViewResult>;

void print_quality(const std::vector<Row>& rows) {
    std::printf("%-20s %7s %7s %7s %7s %7s %7s %7s %7s\n%-20s %7s %7s %7s %7s %7s %7s %7s %7s\n",
                "", "head", "head", "face", "eyes", "skin", "skin", "lids", "head", "", "PSNR",
                "SSIM", "PSNR", "PSNR", "PSNR", "SSIM", "PSNR", "LPIPS");
    for (const auto& [name, r] : rows)
        std::printf("%-20s %7s %7s %7s %7s %7s %7s %7s %7s\n", name.c_str(),
                    cell(r.head.psnr, "%.2f").c_str(), cell(r.head.ssim, "%.3f").c_str(),
                    cell(r.face.psnr, "%.2f").c_str(), cell(r.eyes.psnr, "%.2f").c_str(),
                    cell(r.eye_skin.psnr, "%.2f").c_str(), cell(r.eye_skin.ssim, "%.3f").c_str(),
                    cell(r.lid_margins.psnr, "%.2f").c_str(), cell(r.lpips, "%.3f").c_str());
    std::printf(
        "PSNR [dB] over the pixels of the area, SSIM over the area. Skin: the rectangles around "
        "the\n"
        "eyes with the capture's eyeballs painted white on both pictures. Lids: the lids' "
        "margins,\n"
        "%.1f mm to both sides of their lines.\n",
        lid_margin_mm);
    if (rows.front().second.lpips.count == 0)
        std::printf("not run: LPIPS, which needs --perceptual-weights\n");
}

void print_gaze(const std::vector<Row>& rows, GazeTable ViewResult::*table) {
    std::printf("%-20s %7s %7s %7s %7s %7s %7s   %s\n%-20s %7s %7s %7s %7s %7s %7s   %s\n", "",
                "gaze", "at", "nearest", "where", "to", "estim.", "iris found of those visible on",
                "", "error", "rest", "train", "found", "label", "label",
                "photograph, render, rest, nearest");
    for (const auto& [name, r] : rows) {
        const GazeTable& t = r.*table;
        std::printf("%-20s %7s %7s %7s %7s %7s %7s   %d, %d, %d, %d of %d (%d in view)\n",
                    name.c_str(), cell(t.render.to_photograph, "%.2f").c_str(),
                    cell(t.rest.to_photograph, "%.2f").c_str(),
                    cell(t.nearest.to_photograph, "%.2f").c_str(),
                    cell(t.render.where_found, "%.2f").c_str(),
                    cell(t.render.to_label, "%.2f").c_str(),
                    cell(t.photograph.to_label, "%.2f").c_str(), t.photograph.found,
                    t.render.found, t.rest.found, t.nearest.found, r.eyes_visible,
                    r.eyes_in_view);
    }
    const ViewResult& all = rows.front().second;
    const GazeErrors& photograph = (all.*table).photograph;
    std::printf("estimator on the photographs: %s degrees from the label, %s where found; %d of %d "
                "irises missed\n",
                cell(photograph.to_label, "%.2f").c_str(),
                cell(photograph.to_label_where_found, "%.2f").c_str(),
                all.eyes_visible - photograph.found, all.eyes_visible);
}

void print_reflections(const Json& r) {
    if (r.at("correlation").is_null()) return;
    std::printf("\nWhat the corneas mirror, over %d directions: photographs vary by %.4f, renders by "
                "%.4f, their\ncorrelation is %.3f.\n",
                r.at("directions").get<int>(), r.at("photographs").get<double>(),
                r.at("renders").get<double>(), r.at("correlation").get<double>());
}

void print_highlights(const HighlightMatch& m) {
    if (m.json().is_null() || m.photographs + m.renders == 0) return;
    std::printf("Highlights: %d of %d photographs of an eye show one on the iris. Renders show %d of "
                "these",
                m.photographs, m.pictures, m.found);
    if (m.found > 0) std::printf(", %.1f px off in the median", m.median_distance());
    std::printf(".\nOf the %d on renders, %d are in no photograph.\n", m.renders, m.unlike);
}

void print_tables(const std::vector<Row>& rows) {
    print_quality(rows);
    print_reflections(rows.front().second.reflections.json());
    print_highlights(match_highlights(rows.front().second.reflections));
    std::printf("\nGaze [deg]; the estimator is given the capture's eyeballs and eye masks:\n");
    print_gaze(rows, &ViewResult::measured);
    std::printf("\nGaze [deg]; the estimator is given no label, but the run's own eyeballs:\n");
    print_gaze(rows, &ViewResult::own);
    std::printf(
        "gaze error: estimator on the render against estimator on the photograph. at rest, nearest\n"
        "train: controls, the same head with the gaze at rest and with each eye at its nearest\n"
        "training gaze. to label: render against label. estim. label: photograph against label, what\n"
        "the estimator itself is off by. An eye is visible if the capture's eye mask leaves the\n"
        "estimator %d pixels or more on the photograph. Each visible eye counts in every mean but\n"
        "'where found'; without an iris on one of the two pictures its error is %.0f degrees.\n",
        min_eye_pixels, missed_degrees);
}

/// Returns the capture with the corrections that the run was trained with.
Capture read_corrected(const EvaluateOptions& o, const TrainState& state) {
    Capture capture = read_valid_capture(capture_folder(o.run, state, o.capture, "measuring"));
    require_same_subject(state, capture);
    if (take_corrected(capture, load_corrected_cameras(o.run)) > 0 && !o.json)
        std::printf("cameras with the numbers that were corrected before training are corrected\n");
    if (state.config.correct_colours && !capture.train.empty() && capture.has_gaze())
        correct_colours(capture, state.config);
    if (!capture.camera_gains.empty() && !o.json)
        std::printf("gains of cameras are taken out of the photographs\n");
    if (!capture.frame_exposures.empty() && !o.json)
        std::printf("exposures of frames are taken out of the photographs\n");
    return capture;
}

std::string picture_name(const Capture& capture, int frame) {
    return "frame_" + capture.frames[static_cast<std::size_t>(frame)].id + ".png";
}

/// Results of views, together, by kinds of frames, and as per_view.json lists them.
struct Results {
    ViewResult all;
    std::map<std::string, ViewResult> groups;
    Json per_view = Json::array();
};

/// Returns the results of views, which are sorted by frame.
Results results_of(const Capture& capture, const std::vector<MeasuredView>& views,
                   const std::vector<ViewResult>& found) {
    Results results;
    const auto groups_of = [&](int f) {
        std::vector<std::string> names;
        for (const auto& [name, list] : {std::pair("novel gaze", &capture.novel_gaze),
                                         std::pair("independent eyes", &capture.independent_gaze)})
            if (std::find(list->begin(), list->end(), f) != list->end()) names.emplace_back(name);
        return names;
    };
    for (std::size_t i = 0; i < views.size();) {
        const int f = views[i].frame;
        ViewResult frame;
        for (; i < views.size() && views[i].frame == f; ++i) {
            const ViewResult& r = found[i];
            frame.add(r);
            Json line = {{"frame", capture.frames[static_cast<std::size_t>(f)].id},
                         {"camera", capture.camera_ids[static_cast<std::size_t>(views[i].camera)]}};
            line.update(r.json());
            if (views[i].pictured) {
                line["picture"] = picture_name(capture, f);
                line["eyes_box"] = r.eyes_box;
                line["groups"] = groups_of(f);
            }
            results.per_view.push_back(line);
        }
        results.all.add(frame);
        for (const std::string& name : groups_of(f)) results.groups[name].add(frame);
    }
    return results;
}

void print_centres(const CentreErrors& c) {
    if (c.eyes == 0) return;
    std::printf("\n%-20s %7s %7s\n%-20s %7s %7s\n", "Eyeball centres", "with", "without", "",
                "offset", "offset");
    std::printf("%-20s %7.2f %7.2f\n%-20s %7.2f %7.2f\n", "error", c.with, c.without,
                "error of the motion", c.motion_with, c.motion_without);
    std::printf("Mean distance [mm] from %d measured centres, 1 unit taken as 100 mm; that of the "
                "motion is\nless each eye's mean difference.\n", c.eyes);
}

void print_kappa(const KappaErrors& k) {
    if (!k.eyes[0] && !k.eyes[1]) return;
    std::printf("\nKappa [deg]: yaw and pitch of the run, and of the capture; off by\n");
    for (std::size_t e = 0; e < 2; ++e)
        if (const auto& eye = k.eyes[e])
            std::printf("%-5s %6.2f %6.2f   %6.2f %6.2f   %5.2f\n", e == 0 ? "left" : "right",
                        eye->run[0], eye->run[1], eye->capture[0], eye->capture[1], eye->off());
}

void print_lids(const ClosedLids& lids) {
    if (!(lids.open > 0)) return;
    std::string names;
    for (const std::string& name : lids.names) names += (names.empty() ? "" : ", ") + name;
    std::printf("\nLids closed by %s at 1 leave %.1f %% of the eyes' pixels to be seen (%.0f of %.0f "
                "in a picture\nof the most frontal camera).\n",
                names.c_str(), 100 * lids.visible(), lids.closed / lids.pictures,
                lids.open / lids.pictures);
}

/// Returns each camera's gains, which are removed from the photographs; null without gains.
Json gains_json(const Capture& capture) {
    Json gains;
    for (std::size_t c = 0; c < capture.camera_gains.size(); ++c) {
        const Vec3<double>& g = capture.camera_gains[c];
        gains[capture.camera_ids[c]] = {g[0], g[1], g[2]};
    }
    return gains;
}

/// Returns the frames' exposures, which are removed from the photographs; null without.
Json exposures_json(const Capture& capture) {
    Json exposures;
    for (std::size_t f = 0; f < capture.frame_exposures.size(); ++f)
        exposures[capture.frames[f].id] = capture.frame_exposures[f];
    return exposures;
}

/// Returns the names of cameras that were corrected for the training; null without any.
Json corrected_json(const Capture& capture) {
    Json names;
    for (const CorrectedCamera& c : capture.corrected_cameras) names.push_back(c.camera);
    return names;
}

/// Takes the head frame of the run for all frames of the capture; returns its record.
Json align_head(const EvaluateOptions& o, Capture& capture, const std::vector<int>& frames) {
    const HeadAlignment a = head_alignment(load_checkpoint(o.run), capture, frames);
    take_head_frame(capture, a.capture_from_run);
    if (!o.json)
        std::printf("head frame of the run: %.2f deg and %.2f mm from the capture's; taken out, its "
                    "landmarks are %.2f mm\noff (rms), %.2f mm before; 1 unit taken as 100 mm\n",
                    a.turn_degrees(), a.shift_mm(), a.after_mm, a.before_mm);
    return a.json();
}

void evaluate(const EvaluateOptions& o) {
    set_threads(o.threads);
    TrainState state = load_trained(o.run);
    relight(state, o.run, o.lights);
    Capture capture = read_corrected(o, state);
    std::vector<int> frames = o.split == "train" ? capture.train : capture.test;
    if (o.split == "novel") frames = capture.novel_gaze;
    if (o.split == "independent") frames = capture.independent_gaze;
    require(!frames.empty(), capture.folder.string(), "split '", o.split, "' has no frames");
    const Json lights = o.lights.empty() ? Json() : lights_of(state.avatar).json().at("lights");
    const Json alignment = o.align_head ? align_head(o, capture, frames) : Json();
    const std::filesystem::path out = o.out.empty() ? o.run : o.out;
    const std::filesystem::path pictures = out / ("evaluate_" + o.split);
    std::filesystem::create_directories(pictures);
    std::filesystem::remove(out / "judge.json"); // of other pictures

    const AvatarDrawer drawer(state, device_wish(o.device), o.perceptual_weights);
    if (!o.json && !drawer.words().empty()) std::printf("%s\n", drawer.words().c_str());
    const double dilation = o.dilation > 0 ? o.dilation : dilation_of(o.run, state, capture);
    const Evaluation evaluation(drawer, capture, drawer.lpips(), dilation);
    std::vector<MeasuredView> views;
    for (const int f : frames) {
        const int frontal = camera_index(capture, "", f);
        for (int c = 0; c < capture.camera_count(); ++c)
            if (capture.view(f, c).present) views.push_back({f, c, c == frontal});
    }
    const std::vector<ViewResult> found =
        evaluation.views(views, [&](std::size_t i, const Image<float>& picture) {
            write_png(pictures / picture_name(capture, views[i].frame), picture);
        });

    const auto [all, groups, per_view] = results_of(capture, views, found);
    Json results = {{"split", o.split},         {"frames", frames.size()},
                    {"views", per_view.size()}, {"step", state.step},
                    {"dilation", dilation},
                    {"device", drawer.name()},  {"missed_degrees", missed_degrees},
                    {"camera_gains", gains_json(capture)},
                    {"frame_exposures", exposures_json(capture)},
                    {"corrected_cameras", corrected_json(capture)},
                    {"head_alignment", alignment},
                    {"lights", lights},
                    {"all", all.json()}};
    for (const auto& [name, r] : groups) results[name] = r.json();
    const CentreErrors centres = centre_errors(state, capture, frames);
    results["eyeball_centres"] = centres.json();
    const KappaErrors kappa = kappa_errors(state, capture, frames);
    results["kappa"] = kappa.json();
    const ClosedLids lids = closed_lids(drawer, capture, views, dilation);
    results["closed_lids"] = lids.json();
    const std::string each = per_view.dump(2) + "\n";
    write_atomic(out / "per_view.json", as_bytes(each));
    Json stated = results; // a list has no field for its checksum
    stated["per_view_checksum"] = checksum_text(crc32(as_bytes(each)));
    const std::string results_text = checked_text(stated, 2);
    write_atomic(out / "results.json", as_bytes(results_text));

    if (o.json) {
        std::cout << results_text;
        return;
    }
    std::vector<Row> rows{{"all " + o.split + " frames", all}};
    rows.insert(rows.end(), groups.begin(), groups.end());
    print_tables(rows);
    print_centres(centres);
    print_kappa(kappa);
    print_lids(lids);
    std::printf("%s\n%s\n%s\n", (out / "results.json").string().c_str(),
                (out / "per_view.json").string().c_str(),
                (pictures.string() + " (photograph, render, render with the gaze at rest)").c_str());
}

} // namespace

void add_evaluate(CLI::App& app) {
    auto o = std::make_shared<EvaluateOptions>();
    CLI::App* c = app.add_subcommand("evaluate", "Measure image quality and gaze error");
    c->add_option("--run", o->run, "Folder of the run")
        ->required()
        ->check(folder_check("the folder of a run with its checkpoint"));
    c->add_option("--capture", o->capture, "Folder of the capture (default: the one trained on)")
        ->check(folder_check("the folder of a capture"));
    c->add_option("--split", o->split, "Frames to measure")
        ->check(CLI::IsMember({"test", "train", "novel", "independent"}))
        ->capture_default_str();
    c->add_flag("--json", o->json,
                "Print the results as JSON (as in results.json) instead of tables");
    c->add_flag("--align-head", o->align_head,
                "Draw in the head frame of the run: take out what all its head poses are off by, "
                "by the landmarks of the measured frames");
    c->add_option("--dilation", o->dilation,
                  "Variance [px^2] that every Gaussian gets on the screen (default: as wide on the "
                  "head as training had it, which is 0.3 in pictures of the trained size)")
        ->check(from_to(1e-6, 1e6));
    c->add_option(
        "--perceptual-weights", o->perceptual_weights,
        "VGG16 + LPIPS weights for the LPIPS column, a safetensors file as for `rye train`");
    add_lights(*c, o->lights);
    c->add_option("--out", o->out, "Folder for results.json and per_view.json (default: the run's)");
    add_device(*c, o->device, drawing_device_help);
    add_memory(*c);
    add_threads(*c, o->threads);
    c->callback([o] { evaluate(*o); });
}

} // namespace rye::trainer
