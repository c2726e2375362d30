// SPDX-License-Identifier: Apache-2.0
/// `rye render`: an image of a splat file of any program, as its viewer would render it; or of a
/// run's head. Uses the file's own axes and units; for an upright capture in OpenCV's axes, up
/// is -y.
#include <chrono>
#include <cstdio>
#include <iostream>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include <rye/io/splats.hpp>
#include <rye/gaussian/activate.hpp>
#include <rye/splat/lanes.hpp>
#include <rye/splat/select_accuracy.hpp>

#include "commands/camera_options.hpp"
#include "commands/commands.hpp"
#include "commands/gaze_at.hpp"
#include "commands/options.hpp"
#include "data/cameras_file.hpp"
#include "data/memory_limit.hpp"
#include "data/picture.hpp"
#include "data/threads.hpp"
#include "data/zstd.hpp"
#include "drawing/avatar_drawer.hpp"

namespace rye::trainer {
namespace {

/// Near plane of the first 3DGS implementation and of later viewers [world units].
constexpr double viewer_near_depth = 0.2;

struct RenderOptions {
    std::string ply, out, accuracy = "3dgs", max_error, device = "auto";
    CameraOptions own;
    GazeAtOptions at;
    std::vector<double> background{0, 0, 0};
    double alpha_floor = 0;
    double near_depth = viewer_near_depth;
    int threads = 0;
};

/// Formats of --out.
const std::vector<OutFormat> picture_formats{OutFormat::png, OutFormat::jpeg};

void write_picture(const std::string& out, const Image<float>& picture) {
    constexpr int quality = 95;
    if (out_format(out, picture_formats, "--out") == OutFormat::jpeg)
        write_jpeg(out, to_8bit(picture), quality);
    else
        write_png(out, picture);
}

template <Backend B, Real T, AccuracyPolicy A, Distortion D>
Image<float> picture(const B& backend, const A& accuracy, const Gaussians<T>& g,
                     const Pinhole<T, D>& camera, const VecX<T>& background) {
    const auto pixels =
        static_cast<std::uint64_t>(camera.width) * static_cast<std::uint64_t>(camera.height);
    require_memory(pixels * (4 * sizeof(T) + 3 * sizeof(float) + 3), memory_limit(), "rye render",
                   "a picture of " + std::to_string(camera.width) + " x " +
                       std::to_string(camera.height) + " pixels");
    A limited = accuracy;
    limited.max_memory = memory_limit();
    const auto raster = Rasterizer<A>{limited}.forward(backend, g, camera, background);
    if (raster.trace.non_finite > 0)
        std::cerr << "rye render: skipped " << raster.trace.non_finite
                  << " Gaussians with numbers that are not finite\n";
    Image<float> image(camera.width, camera.height, 3);
    image.pixels = raster.feature.pixels.template cast<float>();
    return image;
}

/// Returns the image at the named accuracy. Only "exact" is in double.
template <Distortion D>
Image<float> picture(const RenderOptions& o, const GaussianCloud<float>& cloud,
                     const Pinhole<double, D>& camera) {
    const auto in_float = camera.template cast<float>();
    using Draw = Image<float> (*)(const RenderOptions&, const Gaussians<float>&,
                                  const decltype(in_float)&, const VecX<float>&);
    static const std::map<std::string, Draw> by_name{
        {"3dgs",
         [](const RenderOptions& options, const auto& g, const auto& c, const auto& b) {
             if (options.alpha_floor == 0)
                 return picture(train_backend(), Compatible3dgs{}, g, c, b);
             Compatible3dgsFloor accuracy;
             accuracy.alpha_floor = options.alpha_floor;
             return picture(train_backend(), accuracy, g, c, b);
         }},
        {"fast", [](const RenderOptions&, const auto& g, const auto& c,
                    const auto& b) { return picture(train_backend(), Fast{}, g, c, b); }},
        {"balanced", [](const RenderOptions&, const auto& g, const auto& c,
                        const auto& b) { return picture(train_backend(), Balanced{}, g, c, b); }},
        {"tight", [](const RenderOptions&, const auto& g, const auto& c, const auto& b) {
             return picture(train_backend(), Tight{}, g, c, b);
         }}};
    const Vec3<double> background = vector_of(o.background);
    if (o.accuracy == "exact") {
        GaussianCloud<double> exact;
        convert_fields(exact, cloud, [](float x) { return static_cast<double>(x); });
        return picture(ScalarBackend{program_threads()}, Exact64{},
                       activate(exact, camera.centre()), camera, VecX<double>(background));
    }
    const Gaussians<float> g = activate(cloud, Vec3<float>(camera.centre().template cast<float>()));
    if (!o.max_error.empty()) {
        if constexpr (D::distorts) {
            throw Error("rye render: --max-error does not support a lens with distortion; use "
                        "--accuracy");
        } else {
            const VecX<float> behind = background.cast<float>();
            const SelectedAccuracy chosen =
                select_accuracy<float>(train_backend(), g, in_float, behind,
                                       parsed_error(o.max_error, "--max-error"));
            if (chosen.met)
                std::printf("accuracy %s: the coarsest of %zu whose error stays below %s; on %td tiles it "
                            "is at most %.2g, and at most %.1f %% of all tiles are worse (95 %% sure)\n",
                            chosen.name.c_str(), accuracy_ladder.size(), o.max_error.c_str(),
                            chosen.tiles, chosen.sampled_error, 100 * chosen.failing_share);
            else
                std::printf("accuracy %s: the finest there is in float; its own rounding of up to %.2g may "
                            "break %s (--accuracy exact is in double)\n",
                            chosen.name.c_str(), chosen.rounding, o.max_error.c_str());
            return picture(train_backend(), chosen.accuracy, g, in_float, behind);
        }
    }
    return by_name.at(o.accuracy)(o, g, in_float, background.cast<float>());
}

/// Returns the camera of the options: from the file of cameras, or from --eye.
Photograph view_of(const RenderOptions& o) {
    const auto [width, height] = parsed_size(o.own.size.empty() ? "512x512" : o.own.size, "--size");
    if (!o.own.file.empty()) {
        const std::vector<Photograph> all = read_cameras(o.own.file);
        const int view = std::max(0, o.own.view);
        require(static_cast<std::size_t>(view) < all.size(), "rye render", "--view: got ", view,
                ", expected 0 to below ", all.size(), ", the cameras of ", o.own.file.string());
        require(o.own.size.empty(), "rye render",
                "--size: the cameras of --cameras have their own");
        return all[static_cast<std::size_t>(view)];
    }
    require(!o.own.eye.empty() && !o.own.look_at.empty(), "rye render",
            "no view given, expected --eye and --look-at, or --cameras");
    const double fov = (o.own.fov_deg > 0 ? o.own.fov_deg : 40) * 3.14159265358979323846 / 180;
    return {"",
            look_at<double>(vector_of(o.own.eye), vector_of(o.own.look_at),
                            o.own.up.empty() ? Vec3<double>(0, -1, 0) : vector_of(o.own.up), fov,
                            {width, height}),
            {}};
}

/// Draws a run's head at its first test frame; `rye redirect` offers all other choices.
void render_run(const RenderOptions& o) {
    const TrainState state = load_trained(o.ply);
    const ShownView view = shown_view(o.ply, state, {}, "", "");
    CameraOptions own = o.own;
    own.view = std::max(0, own.view);
    const Vec3<double> middle =
        view.capture.frames[static_cast<std::size_t>(view.frame)].landmarks.rowwise().mean();
    const Pinhole<double> camera =
        own_cameras(own, view.capture.camera(view.frame, view.camera), middle).front();
    std::vector<DrawnFrame> frames{
        {frame_drivers(view.capture, view.frame, state.config.gaze_axis), camera.cast<float>()}};
    if (o.at.given()) aim_frames(o.at, state, frames);
    take_size(o.ply, state, view, frames);
    const AvatarDrawer drawer(state, device_wish(o.device));
    if (!drawer.words().empty()) std::printf("%s\n", drawer.words().c_str());
    const Image<float> image = drawer.picture(frames.front());
    write_picture(o.out, image);
    std::printf("%s: the head of %s, frame %s, %d x %d pixels\n", o.out.c_str(), o.ply.c_str(),
                view.capture.frames[static_cast<std::size_t>(view.frame)].id.c_str(), image.width,
                image.height);
}

void render(const RenderOptions& o) {
    set_threads(o.threads);
    require(o.alpha_floor == 0 || o.accuracy == "3dgs", "rye render",
            "--alpha-floor needs --accuracy 3dgs, got --accuracy ", o.accuracy);
    if (std::filesystem::is_directory(o.ply)) {
        render_run(o);
        return;
    }
    require(o.device != "cuda", "--device",
            "got cuda, but a splat file is drawn on the CPU, expected the folder of a run");
    require(!o.at.given(), "--gaze-at", "got ", o.at.target,
            ", but a splat file has no eyes that turn, expected the folder of a run");
    Photograph view = view_of(o);
    view.camera.near_depth = o.near_depth;
    const GaussianCloud<float> cloud = read_splats<float>(o.ply, memory_limit(), zstd_decompressor());

    const auto begin = std::chrono::steady_clock::now();
    const Image<float> image = view.bent()
                                   ? picture(o, cloud, with_lens(view.camera, view.lens))
                                   : picture(o, cloud, view.camera);
    const double seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    write_picture(o.out, image);
    std::printf("%s: %td Gaussians, %d x %d pixels%s, %.3f s\n", o.out.c_str(), cloud.count(),
                image.width, image.height, view.bent() ? " through a lens that bends" : "", seconds);
}

} // namespace

void add_render(CLI::App& app) {
    auto o = std::make_shared<RenderOptions>();
    CLI::App* c = app.add_subcommand("render", "Render a splat file to an image");
    const auto finite = from_to(-1e9, 1e9);
    const auto vector = [&](const char* name, std::vector<double>& v, const char* help) {
        return c->add_option(name, v, help)->delimiter(',')->expected(3)->check(finite);
    };
    c->add_option("splats", o->ply,
                  "Splat file: PLY in the standard form, .splat, SPZ or glTF; or the folder of a run, "
                  "whose head is drawn at its first test frame")
        ->required()
        ->check(CLI::ExistingPath);
    add_camera_options(*c, o->own, {"needed for a splat file; of a run, default: the middle of the face",
                        "0,-1,0; of a run, as its own camera", "40; of a run, as its own camera",
                        "512x512; of a run, as its own camera"});
    add_gaze_at_options(*c, o->at);
    vector("--background", o->background, "R,G,B in 0 to 1")->check(from_to(0.0, 1.0))
        ->capture_default_str();
    c->add_option("--accuracy", o->accuracy, "3dgs (as viewers draw), fast, balanced, tight or "
                                             "exact (every Gaussian, in double: slow)")
        ->check(CLI::IsMember({"3dgs", "fast", "balanced", "tight", "exact"}))
        ->capture_default_str();
    c->add_option("--max-error", o->max_error,
                  "Instead of --accuracy: the cheapest whose largest error in any channel stays below "
                  "this, by sampled tiles; 0.004 or 1/255")
        ->check(read_check(parsed_error))
        ->excludes("--accuracy");
    c->add_option("--alpha-floor", o->alpha_floor,
                  "Taken from the falloff, so that it ends at 0; viewers that do so take 0.0111")
        ->check(from_to(0.0, 0.99))->capture_default_str();
    c->add_option("--near", o->near_depth, "Closest depth that is drawn, in the file's units")
        ->check(from_to(1e-9, 1e9))->capture_default_str();
    c->add_option("--out", o->out, "Picture to write (.png or .jpg)")
        ->required()
        ->check(out_check(picture_formats));
    add_device(
        *c, o->device,
        "Where a run's head is drawn; auto: a CUDA device where this build has kernels and a "
        "device is there");
    add_memory(*c);
    add_threads(*c, o->threads);
    c->callback([o] { render(*o); });
}

} // namespace rye::trainer
