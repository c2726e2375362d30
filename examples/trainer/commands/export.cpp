// SPDX-License-Identifier: Apache-2.0
/// `rye export`: the Gaussians of a trained head as a standard 3DGS PLY for splat viewers.
/// A PLY cannot store the upsampler: colours are those of the low-resolution render.
#include <algorithm>
#include <iostream>
#include <memory>
#include <sstream>

#include <CLI/CLI.hpp>

#include <rye/capture/atomic_file.hpp>
#include <rye/gaussian/ply.hpp>
#include <rye/math/harmonics.hpp>
#include <rye/math/rotation.hpp>
#include <rye/math/scalar.hpp>

#include "commands/commands.hpp"
#include "commands/options.hpp"
#include "data/threads.hpp"
#include "training/steps.hpp"

namespace rye::trainer {
namespace {

struct ExportOptions {
    std::filesystem::path run, capture, ply;
    std::string frame, stream = "both", axes = "ply";
    std::vector<double> left, right;  ///< pitch, yaw [deg]
    bool canonical = false;
    int sh = 0;
    int threads = 0;
};

/// The value of the constant harmonic: rgb = 0.5 + C0 f_dc.
constexpr float sh_constant_value = 0.28209479177387814f;

/// Stored form of activated Gaussians; `flip` turns y up, z toward the viewer into the PLY's y
/// down, z forward (half a turn about x).
GaussianCloud<float> cloud_of(const Gaussians<float>& g, bool flip) {
    GaussianCloud<float> c;
    c.mean = g.mean;
    c.rotation = g.rotation;
    if (flip) {
        c.mean.bottomRows(2) *= -1.0f;
        for (Index i = 0; i < c.rotation.cols(); ++i)
            c.rotation.col(i) = quat_product<float>(Quat<float>(0, 1, 0, 0), g.rotation.col(i));
    }
    for (Index i = 0; i < c.rotation.cols(); ++i)
        c.rotation.col(i) = quat_normalized<float>(c.rotation.col(i));
    c.log_scale = g.scale.unaryExpr([](float s) { return std::log(std::max(s, 1e-9f)); });
    // Clamped, so that opaque and invisible Gaussians stay finite: float has 24 bits.
    c.logit_opacity = g.opacity.unaryExpr(
        [](float a) { return logit(std::clamp(a, 6e-8f, 1 - 6e-8f)); });
    c.sh_constant = (g.feature.topRows(3).array() - 0.5f) / sh_constant_value;
    c.sh_rest.resize(0, g.mean.cols());
    return c;
}

void export_ply(const ExportOptions& o) {
    set_threads(o.threads);
    const TrainState state = load_trained(o.run);
    Drivers<float> drivers;
    if (o.canonical) {
        drivers = neutral_drivers<float>(state.config.avatar);
    } else {
        const Capture capture = driving_capture(o.run, state, o.capture);
        drivers = frame_drivers(capture, frame_index(capture, o.frame),
                                state.config.gaze_axis);
    }
    if (!o.left.empty()) drivers.gaze[0] = gaze_option(o.left, "--gaze-left");
    if (!o.right.empty()) drivers.gaze[1] = gaze_option(o.right, "--gaze-right");
    Gaussians<float> g = driven_gaussians(state, drivers);
    const Index face = state.avatar.face.position.cols();
    if (o.stream == "face") g = copy_of(view_of(g).columns(0, face));
    if (o.stream == "eyes") g = copy_of(view_of(g).columns(face, g.count() - face));
    PlyOptions options;
    options.degree = o.sh;
    options.comment = o.axes == "ply" ? "Vertical axis: y" : "axes: y up, z toward the viewer";
    std::ostringstream text;
    write_ply(text, cloud_of(g, o.axes == "ply"), options);
    const std::string bytes = text.str();
    write_atomic(o.ply, std::as_bytes(std::span(bytes)));
    std::cout << o.ply.string() << ": " << g.count() << " Gaussians\n";
}

} // namespace

void add_export(CLI::App& app) {
    auto o = std::make_shared<ExportOptions>();
    CLI::App* c = app.add_subcommand("export", "Write a trained head as a standard Gaussian PLY");
    c->add_option("--run", o->run, "Folder of the run")
        ->required()
        ->check(folder_check("the folder of a run with its checkpoint"));
    c->add_option("--capture", o->capture,
                  "Folder of a capture whose frames drive (default: the run's own)");
    c->add_option("--frame", o->frame, "Frame that drives the head (default: the first test frame)");
    c->add_flag("--canonical", o->canonical, "Neutral expression, no head pose, eyes ahead, instead");
    c->add_option("--gaze-left", o->left, "Subject's left eye: PITCH,YAW in degrees")->delimiter(',');
    c->add_option("--gaze-right", o->right, "Subject's right eye: PITCH,YAW in degrees")->delimiter(',');
    c->add_option("--stream", o->stream, "Which Gaussians")
        ->check(CLI::IsMember({"both", "face", "eyes"}))
        ->capture_default_str();
    c->add_option("--axes", o->axes, "ply: y down, z forward, as viewers expect; world: the capture's")
        ->check(CLI::IsMember({"ply", "world"}))
        ->capture_default_str();
    c->add_option("--sh", o->sh, "Degree of harmonics to pad with zeros, for readers that want 3")
        ->check(CLI::Range(0, 3))
        ->capture_default_str();
    c->add_option("--ply", o->ply, "File to write")->required();
    add_threads(*c, o->threads);
    c->callback([o] { export_ply(*o); });
}

} // namespace rye::trainer
