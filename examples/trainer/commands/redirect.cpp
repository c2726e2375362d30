// SPDX-License-Identifier: Apache-2.0
/// `rye redirect`: renders a trained head with another gaze for each eye.
#include <array>
#include <iostream>
#include <memory>

#include <CLI/CLI.hpp>

#include <rye/math/rotation.hpp>

#include "commands/commands.hpp"
#include "commands/options.hpp"
#include "data/panel.hpp"
#include "data/threads.hpp"
#include "data/validate.hpp"
#include "training/variants.hpp"

namespace rye::trainer {
namespace {

struct RedirectOptions {
    std::filesystem::path run, capture, out;
    std::string frame, camera, effects;
    std::vector<double> left, right;  ///< pitch, yaw [deg]
    bool sweep = false, compare = false;
    int threads = 0;
};

/// (pitch, yaw) of the left eye, of the right one [deg].
struct Look {
    double left[2], right[2];
};

/// Pitch down the rows, yaw across; then single eyes, then converging and diverging ones.
const std::vector<std::vector<Look>>& sheet_of_heads() {
    static const std::vector<std::vector<Look>> rows = [] {
        std::vector<std::vector<Look>> r;
        for (const double pitch : {15.0, 0.0, -15.0}) {
            r.emplace_back();
            for (const double yaw : {-24.0, -12.0, 0.0, 12.0, 24.0})
                r.back().push_back({{pitch, yaw}, {pitch, yaw}});
        }
        r.push_back({{{0, -12}, {0, 12}}, {{0, 12}, {0, -12}}, {{12, 0}, {-12, 0}},
                     {{0, 20}, {0, 0}}, {{0, 0}, {0, -20}}});
        return r;
    }();
    return rows;
}

/// Gazes that are shown enlarged around the eyes, to make the lids visible.
const std::vector<std::vector<Look>>& sheet_of_eyes() {
    static const std::vector<std::vector<Look>> rows = [] {
        std::vector<std::vector<Look>> r(2);
        for (const double yaw : {-24.0, -12.0, 0.0, 12.0, 24.0})
            r[0].push_back({{0, yaw}, {0, yaw}});
        for (const double pitch : {-20.0, -10.0, 0.0, 8.0, 16.0})
            r[1].push_back({{pitch, 0}, {pitch, 0}});
        return r;
    }();
    return rows;
}

DrawnFrame looking(const DrawnFrame& frame, const Look& look) {
    DrawnFrame f = frame;
    f.drivers.gaze = {gaze_option({look.left[0], look.left[1]}, "--sweep"),
                      gaze_option({look.right[0], look.right[1]}, "--sweep")};
    return f;
}

/// Crop of an image around the eyes, as wide as the image.
Image<float> around_eyes(const Image<float>& whole, const TrainState& state,
                         const DrawnFrame& frame) {
    const Mat3<float> r = so3_exp(Vec3<float>(frame.drivers.pose.head<3>()));
    Vec2<float> middle = Vec2<float>::Zero();
    std::array<Vec3<float>, 2> p;
    for (std::size_t e = 0; e < 2; ++e) {
        const Vec3<float> head = frame.drivers.scale * state.subject.eye_centre[e].cast<float>();
        p[e] = frame.camera.project_point(r * head + frame.drivers.pose.tail<3>());
        middle += 0.5f * p[e].head<2>();
    }
    const float apart = std::max(8.0f, (p[0] - p[1]).head<2>().norm());
    const int w = static_cast<int>(2.0f * apart), h = w / 2;
    return enlarged(cropped(whole, static_cast<int>(middle.x()) - w / 2,
                            static_cast<int>(middle.y()) - h / 2, w, h), whole.width);
}

/// A contact sheet of many gazes of one frame.
Image<float> contact_sheet(const TrainState& state, const DrawnFrame& frame,
                           const std::string& effects) {
    std::vector<DrawnFrame> all;
    for (const auto* rows : {&sheet_of_heads(), &sheet_of_eyes()})
        for (const std::vector<Look>& row : *rows)
            for (const Look& look : row) all.push_back(looking(frame, look));
    const FrameDrawer drawer(state, all, effects, "--effects", 1.0 / 255);
    std::cout << drawer.explanation();
    std::vector<Image<float>> stack;
    for (const auto* rows : {&sheet_of_heads(), &sheet_of_eyes()})
        for (const std::vector<Look>& row : *rows) {
            std::vector<Image<float>> pictures;
            for (const Look& look : row) {
                const Image<float> whole = drawer.picture(looking(frame, look));
                pictures.push_back(rows == &sheet_of_heads() ? whole
                                                             : around_eyes(whole, state, frame));
            }
            stack.push_back(side_by_side(pictures));
        }
    return stacked(stack);
}

void redirect(const RedirectOptions& o) {
    set_threads(o.threads);
    require(!o.out.empty(), "rye redirect", "--out is missing, expected a PNG file");
    const TrainState state = load_trained(o.run);
    const CaptureContents contents =
        read_contents(o.capture.empty() ? std::filesystem::path(state.capture) : o.capture);
    const Capture capture = read_valid_frame(contents, frame_id(contents, o.frame),
                                             camera_choices(contents, o.camera));
    require_same_subject(state, capture);
    const int frame = 0, cam = camera_index(capture, o.camera, frame);
    DrawnFrame shown{frame_drivers(capture, frame, state.config.gaze_axis),
                     capture.camera(frame, cam).cast<float>()};
    if (o.sweep) {
        write_png(o.out, contact_sheet(state, shown, o.effects));
    } else {
        if (!o.left.empty()) shown.drivers.gaze[0] = gaze_option(o.left, "--gaze-left");
        if (!o.right.empty()) shown.drivers.gaze[1] = gaze_option(o.right, "--gaze-right");
        const FrameDrawer drawer(state, {shown}, o.effects, "--effects", 1.0 / 255);
        if (!o.effects.empty()) std::cout << drawer.explanation();
        const Image<float> picture = drawer.picture(shown);
        write_png(o.out, o.compare ? side_by_side({on_background(capture.image(frame, cam),
                                                                 capture.mask(frame, cam), 1.0f),
                                                   picture})
                                   : picture);
    }
    std::cout << o.out.string() << "\n";
}

} // namespace

void add_redirect(CLI::App& app) {
    auto o = std::make_shared<RedirectOptions>();
    CLI::App* c = app.add_subcommand("redirect", "Render a trained head with another gaze");
    c->add_option("--run", o->run, "Folder of the run")->required();
    c->add_option("--capture", o->capture, "Folder of the capture (default: the one trained on)");
    c->add_option("--frame", o->frame, "Frame whose expression and head pose are used "
                                       "(default: the first test frame)");
    c->add_option("--camera", o->camera, "Camera (default: the most frontal)");
    c->add_option("--gaze-left", o->left, "Subject's left eye: PITCH,YAW in degrees, head frame; "
                                          "+ is up and toward the subject's left")->delimiter(',');
    c->add_option("--gaze-right", o->right, "Subject's right eye: PITCH,YAW in degrees")->delimiter(',');
    c->add_flag("--sweep", o->sweep, "A contact sheet of many gazes instead");
    c->add_flag("--compare", o->compare, "Put the photograph of that frame beside it");
    c->add_option("--effects", o->effects, "Draw by these effects, or by a variant: paper, talk, gaze "
                                           "or still (default: the fewest that the pictures call for)");
    c->add_option("--out", o->out, "PNG file to write")->required();
    add_threads(*c, o->threads);
    c->callback([o] { redirect(*o); });
}

} // namespace rye::trainer
