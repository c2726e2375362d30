// SPDX-License-Identifier: Apache-2.0
/// `rye evaluate`: image quality over head, face and eyes, and the gaze error by the paper's
/// protocol, with two controls that say what the error is worth.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iostream>
#include <map>
#include <memory>

#include <CLI/CLI.hpp>

#include <rye/capture/atomic_file.hpp>
#include <rye/loss/photometric.hpp>
#include <rye/rig/gaze.hpp>

#include "commands.hpp"
#include "gaze_estimator.hpp"
#include "options.hpp"
#include "panel.hpp"
#include "steps.hpp"
#include "validate.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::ordered_json;
constexpr double degrees = 180 / 3.14159265358979323846;

struct EvaluateOptions {
    std::filesystem::path run, capture, out;
    std::string split = "test";
    int threads = 0;
    int pictures = 1;  ///< comparison pictures a frame
};

/// The three areas that image quality is measured over, as 1 x pixels masks of 0 and 1.
struct Areas {
    Columns<float> head;  ///< the subject's mask
    Columns<float> face;  ///< the head inside the convex hull of the projected landmarks
    Columns<float> eyes;  ///< rectangles around the visible eyeballs, half as wide again
};

/// Convex hull of points [px], counter-clockwise (Andrew's monotone chain).
std::vector<Vec2<double>> convex_hull(std::vector<Vec2<double>> p) {
    std::sort(p.begin(), p.end(), [](const auto& a, const auto& b) {
        return a.x() < b.x() || (a.x() == b.x() && a.y() < b.y());
    });
    std::vector<Vec2<double>> hull;
    const auto cross = [](const Vec2<double>& o, const Vec2<double>& a, const Vec2<double>& b) {
        return (a.x() - o.x()) * (b.y() - o.y()) - (a.y() - o.y()) * (b.x() - o.x());
    };
    for (int pass = 0; pass < 2; ++pass) {
        const std::size_t base = hull.size();
        for (const Vec2<double>& q : p) {
            while (hull.size() >= base + 2 && cross(hull[hull.size() - 2], hull.back(), q) <= 0)
                hull.pop_back();
            hull.push_back(q);
        }
        hull.pop_back();
        std::reverse(p.begin(), p.end());
    }
    return hull;
}

Areas areas_of(const Capture& capture, int frame, int camera) {
    const Image<float> mask = capture.mask(frame, camera), eyes = capture.eye_mask(frame, camera);
    const CaptureFrame& f = capture.frames[static_cast<std::size_t>(frame)];
    const Pinhole<double>& view = capture.camera(frame, camera);
    Areas a;
    a.head = (mask.pixels.array() >= 0.5f).cast<float>();
    std::vector<Vec2<double>> points;
    for (Index k = 0; k < f.landmarks.cols(); ++k)
        points.push_back(view.project_point(f.landmarks.col(k)).head<2>());
    const std::vector<Vec2<double>> hull = convex_hull(points);
    a.face = a.head;
    for (int y = 0; y < mask.height; ++y)
        for (int x = 0; x < mask.width; ++x)
            for (std::size_t k = 0; k < hull.size(); ++k) {
                const Vec2<double>&p = hull[k], &q = hull[(k + 1) % hull.size()];
                if ((q.x() - p.x()) * (y + 0.5 - p.y()) - (q.y() - p.y()) * (x + 0.5 - p.x()) < 0)
                    a.face(0, static_cast<Index>(y) * mask.width + x) = 0;
            }
    a.eyes = Columns<float>::Zero(1, mask.size());
    for (int eye = 0; eye < 2; ++eye) {
        int x0 = mask.width, x1 = -1, y0 = mask.height, y1 = -1;
        for (int y = 0; y < mask.height; ++y)
            for (int x = 0; x < mask.width; ++x)
                if (eyes.at(x, y)(eye) > 0.5f) {
                    x0 = std::min(x0, x), x1 = std::max(x1, x);
                    y0 = std::min(y0, y), y1 = std::max(y1, y);
                }
        if (x1 < 0) continue;
        const int dx = (x1 - x0 + 1) / 4 + 1, dy = (y1 - y0 + 1) / 4 + 1;
        for (int y = std::max(0, y0 - dy); y <= std::min(mask.height - 1, y1 + dy); ++y)
            for (int x = std::max(0, x0 - dx); x <= std::min(mask.width - 1, x1 + dx); ++x)
                a.eyes(0, static_cast<Index>(y) * mask.width + x) =
                    a.head(0, static_cast<Index>(y) * mask.width + x);
    }
    return a;
}

/// A mean of what could be measured.
struct Mean {
    double sum = 0;
    int count = 0;
    void add(double x) { sum += x, ++count; }
    void add(const Mean& m) { sum += m.sum, count += m.count; }
    double value() const { return count > 0 ? sum / count : std::nan(""); }
    Json json() const { return count > 0 ? Json(value()) : Json(nullptr); }
};

/// Image quality over one area.
struct Quality {
    Mean psnr, psnr_full, ssim;
    void add(const Quality& q) { psnr.add(q.psnr), psnr_full.add(q.psnr_full), ssim.add(q.ssim); }
    Json json() const {
        return {{"psnr", psnr.json()}, {"ssim", ssim.json()}, {"psnr_full_image", psnr_full.json()}};
    }
};

Image<float> white_outside(const Image<float>& image, const Columns<float>& area) {
    Image<float> out = image;
    for (Index p = 0; p < out.size(); ++p)
        if (area(0, p) < 0.5f) out.pixels.col(p).setOnes();
    return out;
}

/// PSNR over the area's own pixels; SSIM and a second PSNR over the whole image with both pictures
/// white outside the area, as the papers of this field compute them.
Quality quality(const Image<float>& shown, const Image<float>& truth, const Columns<float>& area) {
    Quality q;
    if (area.sum() < 1) return q;
    const Image<float> a = white_outside(shown, area), b = white_outside(truth, area);
    const auto finite = [](double db) { return std::min(db, 99.0); };  // equal pictures: infinity
    q.psnr.add(finite(psnr<float>(shown.pixels, truth.pixels, area)));
    q.psnr_full.add(finite(psnr<float>(a.pixels, b.pixels, Columns<float>())));
    q.ssim.add(masked_ssim(a, b, area));
    return q;
}

/// The gaze errors of one rendering [deg].
struct GazeErrors {
    Mean to_truth;  ///< estimate on the render against estimate on the photograph (the paper's)
    Mean to_label;  ///< estimate on the render against the label
    void add(const GazeErrors& g) { to_truth.add(g.to_truth), to_label.add(g.to_label); }
    Json json() const {
        return {{"degrees", to_truth.json()}, {"eyes", to_truth.count}, {"degrees_to_label", to_label.json()}};
    }
};

struct ViewResult {
    Quality head, face, eyes;
    GazeErrors avatar, rest, nearest;
    Mean estimator;  ///< estimate on the photograph against the label: the protocol's own error
    void add(const ViewResult& v) {
        head.add(v.head), face.add(v.face), eyes.add(v.eyes);
        avatar.add(v.avatar), rest.add(v.rest), nearest.add(v.nearest);
        estimator.add(v.estimator);
    }
    Json json() const {
        return {{"head", head.json()}, {"face", face.json()}, {"eyes", eyes.json()},
                {"gaze", avatar.json()}, {"gaze_at_rest", rest.json()},
                {"gaze_nearest_training", nearest.json()},
                {"estimator_to_label", estimator.json()}};
    }
};

class Evaluation {
  public:
    Evaluation(const TrainState& state, const Capture& capture) : state_(state), capture_(capture) {}

    /// One view; `picture` receives truth and render side by side.
    ViewResult view(int frame, int camera, Image<float>& picture) const {
        const Image<float> truth =
            on_background(capture_.image(frame, camera), capture_.mask(frame, camera), 1.0f);
        const Drivers<float> drivers = frame_drivers(capture_, frame, axis());
        const Image<float> shown = render(drivers, frame, camera);
        const Areas areas = areas_of(capture_, frame, camera);
        ViewResult r;
        r.head = quality(shown, truth, areas.head);
        r.face = quality(shown, truth, areas.face);
        r.eyes = quality(shown, truth, areas.eyes);

        Drivers<float> rest = drivers, nearest = drivers;
        for (std::size_t e = 0; e < 2; ++e) {
            rest.gaze[e] = Vec3<float>(0, 0, 1);
            nearest.gaze[e] = nearest_training_gaze(drivers.gaze[e], e);
        }
        const Image<float> at_rest = render(rest, frame, camera);
        const Image<float> at_nearest = render(nearest, frame, camera);
        const Image<float> mask = capture_.eye_mask(frame, camera);
        for (std::size_t e = 0; e < 2; ++e) {
            const Columns<float> eye = mask.pixels.row(static_cast<Index>(e));
            const Pinhole<double>& cam = capture_.camera(frame, camera);
            const EyeballGeometry ball = eyeball(frame, e);
            const auto on_truth = estimate_gaze(truth, eye, cam, ball);
            if (!on_truth) continue;  // the photograph itself does not tell
            // The iris is seen where the optical axis is.
            const Vec3<double> label =
                capture_.frames[static_cast<std::size_t>(frame)].eyes[e].optical;
            r.estimator.add(degrees * angular_error(on_truth->gaze, label));
            const auto measure = [&](const Image<float>& image, GazeErrors& errors) {
                const auto found = estimate_gaze(image, eye, cam, ball);
                if (!found) return;
                errors.to_truth.add(degrees * angular_error(found->gaze, on_truth->gaze));
                errors.to_label.add(degrees * angular_error(found->gaze, label));
            };
            measure(shown, r.avatar);
            measure(at_rest, r.rest);
            measure(at_nearest, r.nearest);
        }
        picture = side_by_side({truth, shown, at_rest});
        return r;
    }

  private:
    GazeAxis axis() const { return state_.config.gaze_axis; }
    Image<float> render(const Drivers<float>& drivers, int frame, int camera) const {
        return render_avatar(state_, drivers, capture_.camera(frame, camera).cast<float>()).high;
    }

    Vec3<float> nearest_training_gaze(const Vec3<float>& gaze, std::size_t eye) const {
        Vec3<float> best(0, 0, 1);
        float least = 10;
        for (const int f : capture_.train) {
            const Vec3<float> g =
                gaze_of(capture_.frames[static_cast<std::size_t>(f)].eyes[eye], axis())
                    .cast<float>();
            const float angle = angular_error(g, gaze);
            if (angle < least) least = angle, best = g;
        }
        return best;
    }

    /// The measured eyeball of the frame, or the rig's.
    EyeballGeometry eyeball(int frame, std::size_t eye) const {
        const CaptureFrame& f = capture_.frames[static_cast<std::size_t>(frame)];
        const Subject& s = state_.subject;
        EyeballGeometry g;
        g.head_rotation = so3_exp(Vec3<double>(f.pose.head<3>()));
        g.radius = s.eye_radius[eye] * f.scale;
        g.limbus_radius = s.limbus_radius[eye] * f.scale;
        if (f.eyes[eye].centre) {
            g.centre = *f.eyes[eye].centre;
        } else {
            const Vec3<double> t = f.pose.tail<3>(), c = f.scale * s.eye_centre[eye];
            g.centre = g.head_rotation * c + t;
        }
        return g;
    }

    const TrainState& state_;
    const Capture& capture_;
};

std::string cell(const Mean& m, const char* format) {
    if (m.count == 0) return "-";
    char text[32];
    std::snprintf(text, sizeof text, format, m.value());
    return text;
}

void print_row(const std::string& name, const ViewResult& r) {
    std::printf("%-22s %6s %6s %7s %7s | %7s %7s %7s | %7s %7s\n", name.c_str(),
                cell(r.head.psnr, "%.2f").c_str(), cell(r.head.ssim, "%.3f").c_str(),
                cell(r.face.psnr, "%.2f").c_str(), cell(r.eyes.psnr, "%.2f").c_str(),
                cell(r.avatar.to_truth, "%.2f").c_str(), cell(r.rest.to_truth, "%.2f").c_str(),
                cell(r.nearest.to_truth, "%.2f").c_str(), cell(r.avatar.to_label, "%.2f").c_str(),
                cell(r.estimator, "%.2f").c_str());
}

void write_json(const std::filesystem::path& path, const Json& json) {
    const std::string text = json.dump(2) + "\n";
    write_atomic(path, std::as_bytes(std::span(text)));
}

void evaluate(const EvaluateOptions& o) {
    set_threads(o.threads);
    const TrainState state = load_trained(o.run);
    const Capture capture = read_valid_capture(o.capture.empty() ? std::filesystem::path(state.capture) : o.capture);
    require_same_subject(state, capture);
    std::vector<int> frames = o.split == "train" ? capture.train : capture.test;
    if (o.split == "novel") frames = capture.novel_gaze;
    if (o.split == "independent") frames = capture.independent_gaze;
    require(!frames.empty(), capture.folder.string(),
            "split '" + o.split + "' is empty, expected at least one frame");
    const std::filesystem::path out = o.out.empty() ? o.run : o.out;
    const std::filesystem::path pictures = out / ("evaluate_" + o.split);
    std::filesystem::create_directories(pictures);

    const Evaluation evaluation(state, capture);
    std::map<std::string, ViewResult> groups;
    ViewResult all;
    Json per_view = Json::array();
    const auto in = [](const std::vector<int>& list, int f) {
        return std::find(list.begin(), list.end(), f) != list.end();
    };
    for (const int f : frames) {
        ViewResult frame;
        const int frontal = camera_index(capture, "", f);
        for (int c = 0; c < capture.camera_count(); ++c) {
            if (!capture.view(f, c).present) continue;
            Image<float> picture;
            const ViewResult r = evaluation.view(f, c, picture);
            frame.add(r);
            Json line = {{"frame", capture.frames[static_cast<std::size_t>(f)].id},
                         {"camera", capture.camera_ids[static_cast<std::size_t>(c)]}};
            line.update(r.json());
            per_view.push_back(line);
            if (c == frontal)
                write_png(pictures / ("frame_" + capture.frames[static_cast<std::size_t>(f)].id + ".png"),
                          picture);
        }
        all.add(frame);
        if (in(capture.novel_gaze, f)) groups["novel gaze"].add(frame);
        if (in(capture.independent_gaze, f)) groups["independent eyes"].add(frame);
    }
    Json results = {{"split", o.split}, {"frames", frames.size()}, {"views", per_view.size()},
                    {"step", state.step}, {"all", all.json()}};
    for (const auto& [name, r] : groups) results[name] = r.json();
    write_json(out / "results.json", results);
    write_json(out / "per_view.json", per_view);

    std::printf("%-22s %6s %6s %7s %7s | %7s %7s %7s | %7s %7s\n", "", "head", "head", "face",
                "eyes", "gaze", "rest", "nearest", "gaze", "estim.");
    std::printf("%-22s %6s %6s %7s %7s | %7s %7s %7s | %7s %7s\n", "", "PSNR", "SSIM", "PSNR", "PSNR",
                "error", "gaze", "train", "label", "label");
    print_row("all " + o.split + " frames", all);
    for (const auto& [name, r] : groups) print_row(name, r);
    std::printf(
        "PSNR [dB] over the pixels of the area, SSIM over the area; gaze errors in degrees.\n"
        "gaze error: estimator on the render against estimator on the photograph; the two columns\n"
        "after it are controls: the same head with the gaze at rest, and with each eye at its\n"
        "nearest training gaze. gaze label: against the label. estim. label: the estimator on the\n"
        "photograph against the label, what the estimator itself is off by.\n%s\n%s\n%s\n",
        (out / "results.json").string().c_str(), (out / "per_view.json").string().c_str(),
        (pictures.string() + " (photograph, render, render with the gaze at rest)").c_str());
}

} // namespace

void add_evaluate(CLI::App& app) {
    auto o = std::make_shared<EvaluateOptions>();
    CLI::App* c = app.add_subcommand("evaluate", "Measure image quality and gaze error");
    c->add_option("--run", o->run, "Folder of the run")->required();
    c->add_option("--capture", o->capture, "Folder of the capture (default: the one trained on)");
    c->add_option("--split", o->split, "Frames to measure")
        ->check(CLI::IsMember({"test", "train", "novel", "independent"}))
        ->capture_default_str();
    c->add_option("--out", o->out, "Folder for results.json and per_view.json (default: the run's)");
    add_threads(*c, o->threads);
    c->callback([o] { evaluate(*o); });
}

} // namespace rye::trainer
