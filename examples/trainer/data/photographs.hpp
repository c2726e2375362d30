// SPDX-License-Identifier: Apache-2.0
/// data/photographs.hpp: cameras of a folder of photographs, from its transforms.json (as written
/// by nerfstudio and others): intrinsics in pixels, per file or frame, OPENCV's distortion
/// coefficients, and camera-to-world matrices in OpenGL axes.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <rye/geometry/camera.hpp>

namespace rye::trainer {

struct Photograph {
    std::string file;                ///< path as in transforms.json
    Pinhole<double> camera;          ///< without the lens
    BrownConrady<double> lens;

    /// Returns true if a distortion coefficient is not 0.
    bool bent() const;
};

/// Returns all photographs; throws an Error with file and frame for other camera models.
/// parse_photographs takes the text of the file; its errors begin with `name`.
std::vector<Photograph> parse_photographs(std::string_view text, const std::string& name);
std::vector<Photograph> read_photographs(const std::filesystem::path& transforms_json);

/// Returns the distortion coefficients of the file and of its frames, of any model; empty without
/// any.
std::vector<double> lens_coefficients(const std::filesystem::path& transforms_json);

} // namespace rye::trainer
