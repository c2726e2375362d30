// SPDX-License-Identifier: Apache-2.0
#include "commands/camera_options.hpp"

#include <cmath>
#include <iostream>

#include <CLI/CLI.hpp>

#include <rye/core/error.hpp>
#include <rye/core/memory.hpp>

#include "commands/options.hpp"
#include "data/cameras_file.hpp"
#include "data/degrees.hpp"
#include "data/memory_limit.hpp"

namespace rye::trainer {
namespace {

/// Returns the same view in another size, with the vertical field of view and the principal point's
/// position relative to the height and to the middle column.
Pinhole<double> resized(Pinhole<double> camera, const ImageSize& size) {
    const double factor = static_cast<double>(size.height) / camera.height;
    camera.cx = 0.5 * size.width + factor * (camera.cx - 0.5 * camera.width);
    camera.cy *= factor;
    camera.fx *= factor;
    camera.fy *= factor;
    camera.width = size.width;
    camera.height = size.height;
    return camera;
}

Pinhole<double> placed(const CameraOptions& o, const Pinhole<double>& usual,
                       const Vec3<double>& middle) {
    const Vec3<double> usual_up = -usual.camera_from_world.rotation.row(1).transpose();
    const double fov =
        o.fov_deg > 0 ? o.fov_deg * degree : 2 * std::atan(0.5 * usual.height / usual.fy);
    const ImageSize size =
        o.size.empty() ? ImageSize{usual.width, usual.height} : parsed_size(o.size, "--size");
    Pinhole<double> c =
        look_at<double>(vector_of(o.eye), o.look_at.empty() ? middle : vector_of(o.look_at),
                        o.up.empty() ? usual_up : vector_of(o.up), fov, size);
    c.near_depth = usual.near_depth;
    return c;
}

/// Throws an Error for a picture that takes more than memory_limit() as floats and as bytes: a
/// small list of cameras can state any size.
void require_room(const CameraOptions& o, const Pinhole<double>& c) {
    const auto pixels = static_cast<std::uint64_t>(c.width) * static_cast<std::uint64_t>(c.height);
    require_memory(pixels * 3 * (sizeof(float) + 1), memory_limit(),
                   o.size.empty() && !o.file.empty() ? o.file.string() : "--size",
                   "a picture of " + std::to_string(c.width) + " x " + std::to_string(c.height) +
                       " pixels");
}

} // namespace

void add_camera_options(CLI::App& command, CameraOptions& o, const CameraDefaults& usual) {
    const auto finite = from_to(-1e9, 1e9);
    const auto vector = [&](const char* name, std::vector<double>& v, const std::string& help) {
        return command.add_option(name, v, help)->delimiter(',')->expected(3)->check(finite);
    };
    CLI::Option* const eye = vector("--eye", o.eye, "A camera of one's own: its position X,Y,Z");
    vector("--look-at,--target", o.look_at,
           "Point in the middle of its picture: X,Y,Z (" + usual.look_at + ")")
        ->needs(eye);
    vector("--up", o.up, "Up direction of its picture: X,Y,Z (default: " + usual.up + ")")->needs(eye);
    command
        .add_option("--fov", o.fov_deg,
                    "Its vertical field of view in degrees (default: " + usual.fov + ")")
        ->check(from_to(0.01, 179.0))
        ->needs(eye);
    command
        .add_option("--size", o.size, "Size of the picture in pixels: WxH (default: " + usual.size + ")")
        ->check(read_check(parsed_size));
    CLI::Option* const file =
        command
            .add_option("--cameras", o.file,
                        "Cameras of a JSON file (rye's, or a transforms.json): the one of --view, "
                        "or all of them in their order, as a video")
            ->excludes(eye)
            ->check(CLI::ExistingFile);
    command.add_option("--view", o.view, "Index of a camera of --cameras, from 0")
        ->needs(file)
        ->check(from_to(0, 999999));
}

std::vector<Pinhole<double>> own_cameras(const CameraOptions& o, const Pinhole<double>& usual,
                                         const Vec3<double>& middle) {
    std::vector<Pinhole<double>> all;
    if (!o.eye.empty()) {
        all.push_back(placed(o, usual, middle));
    } else if (o.file.empty()) {
        all.push_back(usual);
    } else {
        std::vector<Photograph> read = read_cameras(o.file);
        if (o.view >= 0) {
            require(static_cast<std::size_t>(o.view) < read.size(), "--view", "got ", o.view,
                    ", expected 0 to below ", read.size(), ", the cameras of ", o.file.string());
            read = {read[static_cast<std::size_t>(o.view)]};
        }
        bool bent = false;
        for (const Photograph& p : read) {
            bent = bent || p.bent();
            all.push_back(p.camera);
            all.back().near_depth = usual.near_depth;
        }
        if (bent)
            std::cerr
                << "rye: note: " << o.file.string()
                << ": a lens bends (k1, k2, k3, p1 or p2 is not 0); a head is drawn without it\n";
    }
    if (!o.size.empty() && o.eye.empty())
        for (Pinhole<double>& c : all) c = resized(c, parsed_size(o.size, "--size"));
    for (const Pinhole<double>& c : all) require_room(o, c);
    return all;
}

} // namespace rye::trainer
