// SPDX-License-Identifier: Apache-2.0
/// data/picture_codecs.hpp: PNG by libpng and JPEG by libjpeg-turbo, between bytes and
/// 8-bit images. `who` names the source in errors. Memory is bounded by what the bytes can hold: a
/// header that claims more pixels than they can is an Error before anything is allocated for it.
#pragma once

#include <string>

#include <rye/capture/bytes.hpp>

#include "data/picture.hpp"

namespace rye::trainer {

/// Palettes become colours, samples of 1, 2 and 4 bits 8, of 16 bits are rounded to 8, and a
/// transparent colour becomes alpha. Damage anywhere is an Error, by the checksums of the file.
Image8 decode_png(ByteSpan bytes, const std::string& who);
ImageHeader png_header(ByteSpan bytes, const std::string& who);
/// 1 to 4 channels.
Bytes encode_png(const Image8& image, const std::string& who);

/// Grey or colour of 8 bits, baseline or progressive. CMYK, arithmetic coding, 12 bits and data
/// that are damaged or end early are Errors.
Image8 decode_jpeg(ByteSpan bytes, const std::string& who);
ImageHeader jpeg_header(ByteSpan bytes, const std::string& who);
/// 1 or 3 channels; above a quality of 90 colour has full resolution.
Bytes encode_jpeg(const Image8& image, int quality, const std::string& who);

/// Error unless a side has 1 to max_image_edge pixels.
void check_image_size(const ImageHeader& h, const std::string& who);

} // namespace rye::trainer
