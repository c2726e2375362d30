// SPDX-License-Identifier: Apache-2.0
/// `rye redirect`: a trained head looks where it is told, each eye on its own.
#include <iostream>
#include <memory>

#include <CLI/CLI.hpp>

#include <rye/math/rotation.hpp>

#include "commands.hpp"
#include "options.hpp"
#include "panel.hpp"
#include "steps.hpp"
#include "validate.hpp"

namespace rye::trainer {
namespace {

struct RedirectOptions {
    std::filesystem::path run, capture, out;
    std::string frame, camera;
    std::vector<double> left, right;  ///< pitch, yaw [deg]
    bool sweep = false, compare = false;
    int threads = 0;
};

/// A contact sheet: pitch down the rows, yaw across; then each eye alone, then squint and its
/// opposite. The crop around the eyes below each head makes the lids visible.
Image<float> contact_sheet(const TrainState& state, Drivers<float> drivers,
                           const Pinhole<float>& camera) {
    const auto picture = [&](double pl, double yl, double pr, double yr) {
        drivers.gaze = {gaze_option({pl, yl}, "--sweep"), gaze_option({pr, yr}, "--sweep")};
        return render_avatar(state, drivers, camera).high;
    };
    std::vector<Image<float>> rows;
    for (const double pitch : {15.0, 0.0, -15.0}) {
        std::vector<Image<float>> row;
        for (const double yaw : {-24.0, -12.0, 0.0, 12.0, 24.0})
            row.push_back(picture(pitch, yaw, pitch, yaw));
        rows.push_back(side_by_side(row));
    }
    rows.push_back(side_by_side({picture(0, -12, 0, 12), picture(0, 12, 0, -12), picture(12, 0, -12, 0),
                                 picture(0, 20, 0, 0), picture(0, 0, 0, -20)}));
    // The same head larger around the eyes.
    const auto eyes = [&](double pitch, double yaw) {
        const Image<float> whole = picture(pitch, yaw, pitch, yaw);
        const Mat3<float> r = so3_exp(Vec3<float>(drivers.pose.head<3>()));
        Vec2<float> middle = Vec2<float>::Zero();
        float apart = 0;
        std::array<Vec3<float>, 2> p;
        for (std::size_t e = 0; e < 2; ++e) {
            const Vec3<float> head = drivers.scale * state.subject.eye_centre[e].cast<float>();
            p[e] = camera.project_point(r * head + drivers.pose.tail<3>());
            middle += 0.5f * p[e].head<2>();
        }
        apart = std::max(8.0f, (p[0] - p[1]).head<2>().norm());
        const int w = static_cast<int>(2.0f * apart), h = w / 2;
        return enlarged(cropped(whole, static_cast<int>(middle.x()) - w / 2,
                                static_cast<int>(middle.y()) - h / 2, w, h), whole.width);
    };
    std::vector<Image<float>> close;
    for (const double yaw : {-24.0, -12.0, 0.0, 12.0, 24.0}) close.push_back(eyes(0, yaw));
    rows.push_back(side_by_side(close));
    close.clear();
    for (const double pitch : {-20.0, -10.0, 0.0, 8.0, 16.0}) close.push_back(eyes(pitch, 0));
    rows.push_back(side_by_side(close));
    return stacked(rows);
}

void redirect(const RedirectOptions& o) {
    set_threads(o.threads);
    require(!o.out.empty(), "rye redirect", "--out is missing, expected a PNG file");
    const TrainState state = load_trained(o.run);
    const Capture capture = read_valid_capture(o.capture.empty() ? std::filesystem::path(state.capture) : o.capture);
    require_same_subject(state, capture);
    const int frame = frame_index(capture, o.frame);
    const int cam = camera_index(capture, o.camera, frame);
    const Pinhole<float> camera = capture.camera(frame, cam).cast<float>();
    Drivers<float> drivers = frame_drivers(capture, frame);
    if (o.sweep) {
        write_png(o.out, contact_sheet(state, drivers, camera));
    } else {
        if (!o.left.empty()) drivers.gaze[0] = gaze_option(o.left, "--gaze-left");
        if (!o.right.empty()) drivers.gaze[1] = gaze_option(o.right, "--gaze-right");
        const Image<float> picture = render_avatar(state, drivers, camera).high;
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
    c->add_option("--out", o->out, "PNG file to write")->required();
    c->add_option("--threads", o->threads, "Threads (0: all)");
    c->callback([o] { redirect(*o); });
}

} // namespace rye::trainer
