// SPDX-License-Identifier: Apache-2.0
/// data/picture_codecs.hpp: PNG by libpng and JPEG by libjpeg-turbo: bytes to 8-bit images and
/// back. Errors begin with `who`. Memory is bounded by the size of the bytes: a header with more
/// pixels than they can encode is an Error before anything is allocated.
#pragma once

#include <string>

#include <rye/io/bytes.hpp>

#include "data/picture.hpp"

namespace rye::trainer {

/// Decodes a PNG. Expands palettes to colours, 1, 2 and 4 bits to 8, and transparent colours to
/// alpha; rounds 16 bits to 8. Throws an Error for any damage that the file's checksums show.
Image8 decode_png(ByteSpan bytes, const std::string& who);
ImageHeader png_header(ByteSpan bytes, const std::string& who);
/// Encodes 1 to 4 channels.
Bytes encode_png(const Image8& image, const std::string& who);

/// Decodes grey or colour of 8 bits, baseline or progressive. Throws an Error for CMYK, arithmetic
/// coding, 12 bits, and damaged or truncated data.
Image8 decode_jpeg(ByteSpan bytes, const std::string& who);
ImageHeader jpeg_header(ByteSpan bytes, const std::string& who);
/// Encodes 1 or 3 channels; above a quality of 90 colour has full resolution.
Bytes encode_jpeg(const Image8& image, int quality, const std::string& who);

} // namespace rye::trainer
