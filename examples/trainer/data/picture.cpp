// SPDX-License-Identifier: Apache-2.0
#include "data/picture.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <string_view>

#include <rye/io/atomic_file.hpp>
#include <rye/io/bytes.hpp>
#include <rye/core/error.hpp>
#include <rye/core/memory.hpp>

#include "data/memory_limit.hpp"
#include "data/picture_codecs.hpp"

namespace rye::trainer {
namespace {

constexpr std::uint64_t max_image_bytes = 1ULL << 30U;
constexpr std::string_view png_magic = "\x89PNG\r\n\x1a\n";
constexpr std::string_view jpeg_magic = "\xff\xd8\xff";

bool is_png(ByteSpan bytes) { return as_text(bytes).starts_with(png_magic); }

void check_magic(ByteSpan bytes, const std::string& who) {
    require(!bytes.empty(), who, "got 0 bytes, expected a PNG or JPEG");
    require(is_png(bytes) || as_text(bytes).starts_with(jpeg_magic), who,
            "neither a PNG nor a JPEG by its first bytes");
}

ImageHeader parse_header(ByteSpan bytes, const std::string& who) {
    check_magic(bytes, who);
    return is_png(bytes) ? png_header(bytes, who) : jpeg_header(bytes, who);
}

void check_pixels(const std::filesystem::path& path, const Image8& image) {
    require(image.width > 0 && image.height > 0 && image.channels >= 1 && image.channels <= 4,
            path.string(), "got an image of ", image.width, " x ", image.height, " x ",
            image.channels, ", expected pixels in 1 to 4 channels");
    RYE_ASSERT(image.values.size() == std::size_t(image.width) * std::size_t(image.height) *
                                          std::size_t(image.channels),
               "check_pixels: values do not match the size");
}

} // namespace

ImageHeader read_image_header(const std::filesystem::path& path) {
    // The size is near the beginning, unless a camera wrote pages of metadata before it.
    constexpr std::size_t beginning = 65536;
    const Bytes bytes = read_beginning(path, beginning);
    try {
        return parse_header(bytes, path.string());
    } catch (const Error&) {
        if (bytes.size() < beginning) throw;
    }
    return parse_header(read_file(path, max_image_bytes), path.string());
}

Image8 decode_image(ByteSpan bytes, const std::string& who, int channels) {
    RYE_ASSERT(channels == 0 || channels == 1 || channels == 3, "decode_image: bad channels");
    const ImageHeader h = parse_header(bytes, who);
    // Memory of the file's pixels, of the requested ones, and of the floats made of them.
    const auto pixels = static_cast<std::uint64_t>(h.width) * static_cast<std::uint64_t>(h.height);
    const auto asked = static_cast<std::uint64_t>(channels == 0 ? h.channels : channels);
    require_memory(pixels * (static_cast<std::uint64_t>(h.channels) + 5 * asked), memory_limit(), who,
                   "its " + std::to_string(h.width) + " x " + std::to_string(h.height) + " pixels");
    return with_channels(is_png(bytes) ? decode_png(bytes, who) : decode_jpeg(bytes, who),
                         channels);
}

Image8 read_image8(const std::filesystem::path& path, int channels) {
    return decode_image(read_file(path, max_image_bytes), path.string(), channels);
}

Image8 to_8bit(const Image<float>& image) {
    Image8 out{image.width, image.height, image.channels(), {}};
    out.values.resize(static_cast<std::size_t>(image.pixels.size()));
    for (std::size_t i = 0; i < out.values.size(); ++i) {
        const float v = image.pixels.data()[i];
        if (std::isnan(v))
            throw Error("to_8bit: got NaN in value " + std::to_string(i) + " of the image");
        out.values[i] = static_cast<std::uint8_t>(std::lround(std::clamp(v, 0.0f, 1.0f) * 255.0f));
    }
    return out;
}

void write_png(const std::filesystem::path& path, const Image8& image) {
    check_pixels(path, image);
    // Pictures number in thousands and can be rendered again.
    write_atomic(path, encode_png(image, path.string()), Durability::atomic_only);
}

void write_png(const std::filesystem::path& path, const Image<float>& image) {
    write_png(path, to_8bit(image));
}

void write_jpeg(const std::filesystem::path& path, const Image8& image, int quality) {
    check_pixels(path, image);
    write_atomic(path, encode_jpeg(image, quality, path.string()), Durability::atomic_only);
}

} // namespace rye::trainer
