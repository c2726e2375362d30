// SPDX-License-Identifier: Apache-2.0
/// data/cameras_file.hpp: user-defined cameras from a JSON file: rye's list "cameras"
/// (docs/formats.md), or the "frames" of a transforms.json (photographs.hpp).
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "data/photographs.hpp"

namespace rye::trainer {

/// Largest deviation of a number of R R' from the identity, of a camera's rotation R in a file.
inline constexpr double most_off_rotation = 1e-3;

/// Parses WxH, each 1 to max_image_edge pixels; throws an Error that begins with `who` for anything
/// else.
ImageSize parsed_size(const std::string& text, const std::string& who);

/// Returns all cameras, at least one; throws an Error with file, camera and field for anything
/// missing, unknown or out of range. parse_cameras takes the text of the file; its errors begin
/// with `name`.
std::vector<Photograph> parse_cameras(std::string_view text, const std::string& name);
std::vector<Photograph> read_cameras(const std::filesystem::path& path);

} // namespace rye::trainer
