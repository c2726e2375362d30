// SPDX-License-Identifier: Apache-2.0
/// commands/camera_options.hpp: a camera of one's own as options: --eye, --look-at, --up, --fov and
/// --size, or --cameras FILE and --view.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "data/photographs.hpp"

namespace CLI {
class App;
}

namespace rye::trainer {

/// Options that were given; the command chooses the camera that the rest comes from.
struct CameraOptions {
    std::vector<double> eye, look_at, up; ///< world units; empty: not given
    double fov_deg = 0;                   ///< vertical; 0: not given
    std::string size;                     ///< WxH; empty: not given
    std::filesystem::path file;           ///< of --cameras
    int view = -1;                        ///< of --view; -1: not given

    bool given() const { return !eye.empty() || !file.empty(); }
};

/// What a command takes for an option that is not given, as its help says it: "0,-1,0".
struct CameraDefaults {
    std::string look_at, up, fov, size;
};

/// Adds the options, each with its own default in its help.
void add_camera_options(CLI::App& command, CameraOptions& options, const CameraDefaults& defaults);

/// The cameras that were given: one, or all of --cameras if --view was not. What is missing is that
/// of `usual`, and the point to look at `middle`; of none, `usual` itself, in the size of --size.
/// Throws Error for what is out of range. A lens that bends is left out, with a note on standard
/// error.
std::vector<Pinhole<double>> own_cameras(const CameraOptions& options, const Pinhole<double>& usual,
                                         const Vec3<double>& middle);

} // namespace rye::trainer
