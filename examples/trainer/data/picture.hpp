// SPDX-License-Identifier: Apache-2.0
/// data/picture.hpp: 8-bit images on disk: PNG and JPEG.
/// Values are the file's own (sRGB for colour, no linearisation); 255 becomes 1 in float images.
#pragma once

#include <filesystem>
#include <string>

#include <rye/io/bytes.hpp>
#include <rye/io/image8.hpp>
#include <rye/core/columns.hpp>

namespace rye::trainer {

using rye::Image8;
using rye::ImageHeader;
using rye::max_image_edge;
using rye::to_float;

/// Reads the header of a PNG or JPEG; throws an Error with the path, also for a pipe or device.
ImageHeader read_image_header(const std::filesystem::path& path);

/// Reads a PNG or JPEG, converted to `channels` (1 or 3; 0 keeps the file's own). Throws an Error
/// for a file that is damaged, truncated or too short for its size in pixels.
Image8 read_image8(const std::filesystem::path& path, int channels = 0);

/// Returns the image in the bytes of a file; errors begin with `who`.
Image8 decode_image(ByteSpan bytes, const std::string& who, int channels = 0);

/// Clamps to [0, 1] and rounds to nearest; throws an Error for NaN.
Image8 to_8bit(const Image<float>& image);

/// Writes a PNG of 1 to 4 channels, replacing an old file atomically.
void write_png(const std::filesystem::path& path, const Image8& image);
void write_png(const std::filesystem::path& path, const Image<float>& image);

/// Writes a JPEG of 1 or 3 channels, replacing an old file atomically; above a quality of 90 colour
/// has full resolution too.
void write_jpeg(const std::filesystem::path& path, const Image8& image, int quality);

} // namespace rye::trainer
