// SPDX-License-Identifier: Apache-2.0
/// commands/camera_options.hpp: a user's camera as options: --eye, --look-at, --up, --fov and
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

/// Values of the options; the command chooses the camera for the rest.
struct CameraOptions {
    std::vector<double> eye, look_at, up; ///< world units; empty: not given
    double fov_deg = 0;                   ///< vertical; 0: not given
    std::string size;                     ///< WxH; empty: not given
    std::filesystem::path file;           ///< of --cameras
    int view = -1;                        ///< of --view; -1: not given

    bool given() const { return !eye.empty() || !file.empty(); }
};

/// Returns the three values of an option as a vector.
inline Vec3<double> vector_of(const std::vector<double>& v) { return {v[0], v[1], v[2]}; }

/// Default of each option in its help, such as "0,-1,0".
struct CameraDefaults {
    std::string look_at, up, fov, size;
};

/// Adds the options, each with its own default in its help.
void add_camera_options(CLI::App& command, CameraOptions& options, const CameraDefaults& defaults);

/// Returns the given cameras: one, or all of --cameras without --view. Missing values are those of
/// `usual`, and the point to look at `middle`; without any option it is `usual` itself, in the size
/// of --size. Throws an Error for values out of range. Ignores a lens with distortion, with a note
/// on standard error.
std::vector<Pinhole<double>> own_cameras(const CameraOptions& options, const Pinhole<double>& usual,
                                         const Vec3<double>& middle);

} // namespace rye::trainer
