// SPDX-License-Identifier: Apache-2.0
#include "image_io.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <memory>
#include <string>
#include <string_view>

#include <rye/capture/atomic_file.hpp>
#include <rye/capture/bytes.hpp>
#include <rye/capture/inflate.hpp>
#include <rye/core/error.hpp>

// The one place where stb is compiled. It reads from memory only: files are ours.
#define STBI_ONLY_PNG
#define STBI_ONLY_JPEG
#define STBI_NO_STDIO
#define STBI_MAX_DIMENSIONS 16384
#define STB_IMAGE_STATIC
#define STB_IMAGE_IMPLEMENTATION
#define STBI_WRITE_NO_STDIO
#define STB_IMAGE_WRITE_STATIC
#define STB_IMAGE_WRITE_IMPLEMENTATION
#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-function"
#endif
#include <stb_image.h>
#include <stb_image_write.h>
#if defined(__GNUC__)
#pragma GCC diagnostic pop
#endif

namespace rye::trainer {
namespace {

constexpr std::uint64_t max_image_bytes = 1ULL << 30U;
constexpr std::string_view png_magic = "\x89PNG\r\n\x1a\n";
constexpr std::string_view jpeg_magic = "\xff\xd8\xff";

/// stb neither verifies checksums nor minds a missing end; a damaged picture must not be learned.
void check_png(ByteSpan file, const std::string& who) {
    for (std::uint64_t at = png_magic.size();;) {
        const auto big_endian = [&](std::uint64_t offset) {
            const ByteSpan b = slice(file, offset, 4, who, "a PNG chunk");
            std::uint32_t value = 0;
            for (const std::byte next : b) value = value << 8U | static_cast<std::uint32_t>(next);
            return value;
        };
        const std::uint64_t length = big_endian(at);
        const ByteSpan body = slice(file, at + 4, length + 4, who, "a PNG chunk");
        const std::string name(as_text(body.first(4)));
        require(crc32(body) == big_endian(at + 8 + length), who,
                "the checksum of its PNG chunk " + name + " is wrong: the file is damaged");
        if (name == "IEND") return;
        at += 12 + length;
    }
}

void check_jpeg(ByteSpan file, const std::string& who) {
    const std::string_view text = as_text(file);
    const std::size_t scan = text.rfind("\xff\xda"), end = text.rfind("\xff\xd9");
    require(scan != std::string_view::npos && end != std::string_view::npos && end > scan, who,
            "truncated: the JPEG has no end (" + std::to_string(file.size()) + " bytes)");
}

const stbi_uc* stb_bytes(ByteSpan bytes) { return reinterpret_cast<const stbi_uc*>(bytes.data()); }

ImageHeader parse_header(ByteSpan bytes, bool& known) {
    ImageHeader h;
    known = stbi_info_from_memory(stb_bytes(bytes), static_cast<int>(bytes.size()), &h.width,
                                  &h.height, &h.channels) != 0;
    return h;
}

void check_header(const ImageHeader& h, const std::string& who) {
    require(h.width > 0 && h.height > 0 && h.width <= max_image_edge && h.height <= max_image_edge,
            who,
            "got an image of " + std::to_string(h.width) + " x " + std::to_string(h.height) +
                " pixels, expected 1 to " + std::to_string(max_image_edge) + " a side");
}

void check_magic(ByteSpan bytes, const std::string& who) {
    require(!bytes.empty(), who, "got 0 bytes, expected a PNG or JPEG");
    require(as_text(bytes).starts_with(png_magic) || as_text(bytes).starts_with(jpeg_magic), who,
            "neither a PNG nor a JPEG by its first bytes");
}

/// stb's callback: `to` is a Bytes.
void collect(void* to, void* data, int size) {
    append(*static_cast<Bytes*>(to),
           ByteSpan(static_cast<const std::byte*>(data), static_cast<std::size_t>(size)));
}

void check_pixels(const std::filesystem::path& path, const Image8& image) {
    require(image.width > 0 && image.height > 0 && image.channels >= 1 && image.channels <= 4,
            path.string(),
            "got an image of " + std::to_string(image.width) + " x " +
                std::to_string(image.height) + " x " + std::to_string(image.channels) +
                ", expected pixels in 1 to 4 channels");
    RYE_ASSERT(image.values.size() == std::size_t(image.width) * std::size_t(image.height) *
                                          std::size_t(image.channels),
               "check_pixels: size and values");
}

} // namespace

ImageHeader read_image_header(const std::filesystem::path& path) {
    const std::string who = path.string();
    // The size stands near the beginning, unless a camera put pages of notes before it.
    constexpr std::size_t beginning = 65536;
    Bytes bytes(beginning);
    std::ifstream in(path, std::ios::binary);
    if (in) {
        in.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(beginning));
    }
    bytes.resize(static_cast<std::size_t>(in.gcount()));
    bool known = false;
    ImageHeader header;
    if (!bytes.empty()) header = parse_header(bytes, known);
    if (!known) {
        bytes = read_file(path, max_image_bytes);
        check_magic(bytes, who);
        header = parse_header(bytes, known);
        if (!known)
            throw Error(who + ": its image header cannot be read: " + stbi_failure_reason());
    }
    check_header(header, who);
    return header;
}

Image8 read_image8(const std::filesystem::path& path, int channels) {
    const std::string who = path.string();
    RYE_ASSERT(channels == 0 || channels == 1 || channels == 3, "read_image8: channels");
    const Bytes bytes = read_file(path, max_image_bytes);
    check_magic(bytes, who);
    if (as_text(bytes).starts_with(png_magic))
        check_png(bytes, who);
    else
        check_jpeg(bytes, who);
    bool known = false;
    const ImageHeader header = parse_header(bytes, known);
    if (known) check_header(header, who);
    Image8 image;
    const std::unique_ptr<stbi_uc, decltype(&stbi_image_free)> pixels(
        stbi_load_from_memory(stb_bytes(bytes), static_cast<int>(bytes.size()), &image.width,
                              &image.height, &image.channels, channels),
        &stbi_image_free);
    if (!pixels) throw Error(who + ": cannot be decoded: " + stbi_failure_reason());
    if (channels != 0) image.channels = channels;
    const std::size_t count = static_cast<std::size_t>(image.width) *
                              static_cast<std::size_t>(image.height) *
                              static_cast<std::size_t>(image.channels);
    image.values.assign(pixels.get(), pixels.get() + count);
    return image;
}

Image<float> to_float(const Image8& image) {
    Image<float> out;
    out.width = image.width;
    out.height = image.height;
    out.pixels.resize(image.channels, out.size());
    for (std::size_t i = 0; i < image.values.size(); ++i)
        out.pixels.data()[i] = static_cast<float>(image.values[i]) / 255.0f;
    return out;
}

Image8 to_8bit(const Image<float>& image) {
    Image8 out{image.width, image.height, image.channels(), {}};
    out.values.resize(static_cast<std::size_t>(image.pixels.size()));
    for (std::size_t i = 0; i < out.values.size(); ++i) {
        const float v = image.pixels.data()[i];
        if (std::isnan(v))
            throw Error("to_8bit: got NaN in value " + std::to_string(i) +
                        " of the image, expected numbers");
        out.values[i] = static_cast<std::uint8_t>(std::lround(std::clamp(v, 0.0f, 1.0f) * 255.0f));
    }
    return out;
}

void write_png(const std::filesystem::path& path, const Image8& image) {
    check_pixels(path, image);
    Bytes png;
    const int written =
        stbi_write_png_to_func(collect, &png, image.width, image.height, image.channels,
                               image.values.data(), image.width * image.channels);
    require(written != 0, path.string(), "cannot be encoded as PNG");
    // Pictures come in thousands and can be drawn again.
    write_atomic(path, png, Durability::atomic_only);
}

void write_png(const std::filesystem::path& path, const Image<float>& image) {
    write_png(path, to_8bit(image));
}

void write_jpeg(const std::filesystem::path& path, const Image8& image, int quality) {
    check_pixels(path, image);
    Bytes jpeg;
    const int written = stbi_write_jpg_to_func(collect, &jpeg, image.width, image.height,
                                               image.channels, image.values.data(), quality);
    require(written != 0, path.string(), "cannot be encoded as JPEG");
    write_atomic(path, jpeg, Durability::atomic_only);
}

} // namespace rye::trainer
