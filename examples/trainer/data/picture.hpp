// SPDX-License-Identifier: Apache-2.0
/// data/picture.hpp: 8-bit images on disk: PNG and JPEG.
/// Values are the file's own (sRGB for colour, no linearisation); 255 is 1 in the float images.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <rye/capture/bytes.hpp>
#include <rye/core/columns.hpp>

namespace rye::trainer {

/// An image as the file holds it: row by row, channels interleaved.
struct Image8 {
    int width = 0;                     ///< [px]
    int height = 0;                    ///< [px]
    int channels = 0;                  ///< 1 grey, 2 grey + alpha, 3 RGB, 4 RGBA
    std::vector<std::uint8_t> values;  ///< channels * width * height
};

/// Size and channels, from the header only.
struct ImageHeader {
    int width = 0, height = 0, channels = 0;
};

/// The widest or highest image that is read; a header that says more is refused unread.
inline constexpr int max_image_edge = 16384;

/// Reads the header of a PNG or JPEG; Error names the file. A pipe or device is an Error.
ImageHeader read_image_header(const std::filesystem::path& path);

/// Reads a PNG or JPEG, converted to `channels` (1 or 3; 0 keeps the file's own). A file that is
/// damaged, ends early or has too few bytes for its size in pixels is an Error.
Image8 read_image8(const std::filesystem::path& path, int channels = 0);

/// The same from the bytes of a file; `who` names it in errors.
Image8 decode_image(ByteSpan bytes, const std::string& who, int channels = 0);

/// channels x pixels in [0, 1].
Image<float> to_float(const Image8& image);

/// Clamped to [0, 1] and rounded to nearest; NaN is an Error.
Image8 to_8bit(const Image<float>& image);

/// Writes a PNG of 1 to 4 channels, replacing the old file only when the new one is complete.
void write_png(const std::filesystem::path& path, const Image8& image);
void write_png(const std::filesystem::path& path, const Image<float>& image);

/// The same as a JPEG of 1 or 3 channels; above a quality of 90 colour has full resolution too.
void write_jpeg(const std::filesystem::path& path, const Image8& image, int quality);

} // namespace rye::trainer
