// SPDX-License-Identifier: Apache-2.0
/// importers/colmap_model.hpp: cameras and pictures of a COLMAP model, binary or text. World to
/// camera, quaternions (w, x, y, z), corner-based pixels: as in rye, so only the lens is converted.
/// Source of the layout: COLMAP's documentation, "Output Format".
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <rye/io/bytes.hpp>
#include <rye/geometry/rigid.hpp>

#include "data/photographs.hpp"

namespace rye::trainer {

enum class ColmapFormat { binary, text }; ///< .bin, .txt

/// Picture of a model.
struct ColmapPicture {
    std::string name;
    std::uint32_t camera = 0; ///< id in ColmapCameras
    Rigid<double> camera_from_world;
};

/// Cameras by their ids, with their lenses.
using ColmapCameras = std::map<std::uint32_t, Photograph>;

/// Returns the cameras in a file cameras.bin or cameras.txt. Throws an Error that begins with `who`
/// for models beyond OPENCV, for numbers that are not finite or in range, and for truncation.
ColmapCameras parse_colmap_cameras(ByteSpan bytes, ColmapFormat format, const std::string& who);

/// Returns the pictures in a file images.bin or images.txt; throws an Error likewise.
std::vector<ColmapPicture> parse_colmap_pictures(ByteSpan bytes, ColmapFormat format,
                                                 const std::string& who);

} // namespace rye::trainer
