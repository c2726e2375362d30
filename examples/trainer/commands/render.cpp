// SPDX-License-Identifier: Apache-2.0
/// `rye render`: an image of a splat file of any program, as its viewer would render it.
/// The file's own axes and units; for an upright capture in OpenCV's axes, up is -y.
#include <chrono>
#include <cstdio>
#include <iostream>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include <rye/capture/splats.hpp>
#include <rye/gaussian/activate.hpp>
#include <rye/splat/lanes.hpp>
#include <rye/splat/select_accuracy.hpp>

#include "commands/commands.hpp"
#include "commands/options.hpp"
#include "data/photographs.hpp"
#include "data/picture.hpp"
#include "data/threads.hpp"
#include "training/types.hpp"

namespace rye::trainer {
namespace {

/// Near plane of the first 3DGS implementation and of viewers after it. [world units]
constexpr double viewer_near_depth = 0.2;

struct RenderOptions {
    std::string ply, out, size = "512x512", accuracy = "3dgs", max_error;
    std::string cameras;
    int view = 0;
    std::vector<double> eye, target, up{0, -1, 0}, background{0, 0, 0};
    double fov_deg = 40;
    double alpha_floor = 0;
    double near_depth = viewer_near_depth;
    int threads = 0;
};

Vec3<double> vector_of(const std::vector<double>& v) { return {v[0], v[1], v[2]}; }

/// WxH.
std::pair<int, int> parsed_size(const std::string& text) {
    int width = 0, height = 0, read = 0;
    const int found = std::sscanf(text.c_str(), "%5dx%5d%n", &width, &height, &read);
    require(found == 2 && static_cast<std::size_t>(read) == text.size() && width > 0 &&
                height > 0 && width <= max_image_edge && height <= max_image_edge,
            "rye render", "--size: got " + text + ", expected WxH, each 1 to " +
                              std::to_string(max_image_edge) + " pixels");
    return {width, height};
}

template <Backend B, Real T, AccuracyPolicy A, Distortion D>
Image<float> picture(const B& backend, const A& accuracy, const Gaussians<T>& g,
                     const Pinhole<T, D>& camera, const VecX<T>& background) {
    const auto raster = Rasterizer<A>{accuracy}.forward(backend, g, camera, background);
    if (raster.trace.non_finite > 0)
        std::cerr << "rye render: skipped " << raster.trace.non_finite
                  << " Gaussians with numbers that are not finite\n";
    Image<float> image(camera.width, camera.height, 3);
    image.pixels = raster.feature.pixels.template cast<float>();
    return image;
}

/// The image at the named accuracy. Only "exact" is in double.
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
                                       parsed_error(o.max_error, "rye render", "--max-error"));
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

/// The camera of the options: from the file of cameras, or from --eye.
Photograph view_of(const RenderOptions& o) {
    if (!o.cameras.empty()) {
        const std::vector<Photograph> all = read_photographs(o.cameras);
        require(o.view >= 0 && static_cast<std::size_t>(o.view) < all.size(), "rye render",
                "--view: got " + std::to_string(o.view) + ", expected 0 to below " +
                    std::to_string(all.size()) + ", the frames of " + o.cameras);
        return all[static_cast<std::size_t>(o.view)];
    }
    require(!o.eye.empty() && !o.target.empty(), "rye render",
            "no view given, expected --eye and --target, or --cameras");
    const auto [width, height] = parsed_size(o.size);
    const double fov = o.fov_deg * 3.14159265358979323846 / 180;
    return {"", look_at<double>(vector_of(o.eye), vector_of(o.target), vector_of(o.up), fov,
                                {width, height}), {}};
}

void render(const RenderOptions& o) {
    set_threads(o.threads);
    require(o.alpha_floor == 0 || o.accuracy == "3dgs", "rye render",
            "--alpha-floor needs --accuracy 3dgs, got --accuracy " + o.accuracy);
    Photograph view = view_of(o);
    view.camera.near_depth = o.near_depth;
    const GaussianCloud<float> cloud = read_splats<float>(o.ply);

    const auto begin = std::chrono::steady_clock::now();
    const Image<float> image = view.bent()
                                   ? picture(o, cloud, with_lens(view.camera, view.lens))
                                   : picture(o, cloud, view.camera);
    const double seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    write_png(o.out, image);
    std::printf("%s: %td Gaussians, %d x %d pixels%s, %.3f s\n", o.out.c_str(), cloud.count(),
                image.width, image.height, view.bent() ? " through a lens that bends" : "", seconds);
}

} // namespace

void add_render(CLI::App& app) {
    auto o = std::make_shared<RenderOptions>();
    CLI::App* c = app.add_subcommand("render", "Render a splat file to an image");
    const auto finite = CLI::Range(-1e9, 1e9);
    const auto vector = [&](const char* name, std::vector<double>& v, const char* help) {
        return c->add_option(name, v, help)->delimiter(',')->expected(3)->check(finite);
    };
    c->add_option("splats", o->ply, "Splat file: PLY in the standard form, .splat or SPZ")
        ->required();
    vector("--eye", o->eye, "Position of the camera: X,Y,Z");
    vector("--target", o->target, "Point in the image centre: X,Y,Z");
    c->add_option("--cameras", o->cameras,
                  "Instead of --eye: a transforms.json; its lens (k1, k2, k3, p1, p2) is drawn through")
        ->excludes("--eye")->excludes("--target");
    c->add_option("--view", o->view, "Index of a frame of --cameras, from 0")->needs("--cameras");
    vector("--up", o->up, "Up direction of the image: X,Y,Z")->capture_default_str();
    c->add_option("--fov", o->fov_deg, "Vertical field of view in degrees")
        ->check(CLI::Range(0.01, 179.0))->capture_default_str();
    c->add_option("--size", o->size, "Pixels: WxH")->capture_default_str();
    vector("--background", o->background, "R,G,B in 0 to 1")->check(CLI::Range(0.0, 1.0))
        ->capture_default_str();
    c->add_option("--accuracy", o->accuracy, "3dgs (as viewers draw), fast, balanced, tight or "
                                             "exact (every Gaussian, in double: slow)")
        ->check(CLI::IsMember({"3dgs", "fast", "balanced", "tight", "exact"}))
        ->capture_default_str();
    c->add_option("--max-error", o->max_error,
                  "Instead of --accuracy: the cheapest whose largest error in any channel stays below "
                  "this, by sampled tiles; 0.004 or 1/255")->excludes("--accuracy");
    c->add_option("--alpha-floor", o->alpha_floor,
                  "Taken from the falloff, so that it ends at 0; viewers that do so take 0.0111")
        ->check(CLI::Range(0.0, 0.99))->capture_default_str();
    c->add_option("--near", o->near_depth, "Closest depth that is drawn, in the file's units")
        ->check(CLI::Range(1e-9, 1e9))->capture_default_str();
    c->add_option("--out", o->out, "PNG file to write")->required();
    add_threads(*c, o->threads);
    c->callback([o] { render(*o); });
}

} // namespace rye::trainer
