// SPDX-License-Identifier: Apache-2.0
/// data/photographs.hpp: the cameras of a folder of photographs, from its
/// transforms.json (as nerfstudio and others write it): intrinsics in pixels, for the file or for a
/// frame, OPENCV's coefficients of the lens, and camera-to-world matrices of OpenGL's axes.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <rye/geometry/camera.hpp>

namespace rye::trainer {

struct Photograph {
    std::string file;                ///< as the file names it
    Pinhole<double> camera;          ///< without the lens
    BrownConrady<double> lens;

    /// Whether a coefficient is not 0.
    bool bent() const;
};

/// All of them; Error for a lens of another model, naming the file and the frame.
/// The first from the text of the file; `name` names it in errors.
std::vector<Photograph> parse_photographs(std::string_view text, const std::string& name);
std::vector<Photograph> read_photographs(const std::filesystem::path& transforms_json);

/// Coefficients of the lenses of the file and of its frames, whatever their model; {} for none.
std::vector<double> lens_coefficients(const std::filesystem::path& transforms_json);

} // namespace rye::trainer
