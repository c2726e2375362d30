// SPDX-License-Identifier: Apache-2.0
/// rye/io/png.hpp: decoding of PNG for programs that link no codec: 8 bits a channel, grey or
/// colour, with or without alpha, or a palette; not interlaced. All checksums are verified. Values
/// are the file's; its gamma and single transparent colours are not applied.
/// Source: PNG specification, third edition (W3C); RFC 1950 (zlib).
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <string_view>

#include <rye/io/bytes.hpp>
#include <rye/io/image8.hpp>
#include <rye/io/inflate.hpp>
#include <rye/core/error.hpp>
#include <rye/core/memory.hpp>

namespace rye {

namespace detail {

/// The chunks of a PNG that affect its pixels.
class PngChunks {
  public:
    ImageHeader header{};
    int stored = 0;        ///< channels in the file: 1 for a palette's indices
    bool indexed = false;  ///< by a palette
    ByteSpan palette;      ///< RGB of each index
    Bytes packed;          ///< the zlib stream

    /// Reads to the end, or of a file's beginning the header alone.
    PngChunks(ByteSpan file, const std::string& who, bool header_alone) : file_(file), who_(who) {
        require(as_text(file).starts_with("\x89PNG\r\n\x1a\n"), who,
                "not a PNG by its first bytes, the only pictures that are read here");
        require(next() == "IHDR", who, "PNG: does not begin with its header");
        read_header();
        if (header_alone) return;
        for (std::string_view kind = next(); kind != "IEND"; kind = next()) {
            if (kind == "PLTE") palette = data_;
            else if (kind == "IDAT") append(packed, data_);
            else
                require((kind[0] & 0x20) != 0, who, "PNG: got the unknown chunk '", kind,
                        "', which pixels depend on");
        }
    }

  private:
    std::uint32_t big_endian(std::uint64_t at) {
        const auto x = read_at<std::uint32_t>(file_, at, who_, "a chunk of the PNG");
        return x >> 24U | (x >> 8U & 0xFF00U) | (x << 8U & 0xFF0000U) | x << 24U;
    }
    /// Returns the next chunk's kind and sets its data.
    std::string_view next() {
        const std::uint64_t size = big_endian(at_);
        const ByteSpan checked = slice(file_, at_ + 4, 4 + size, who_, "a chunk of the PNG");
        const std::string_view kind = as_text(checked.first(4));
        require(big_endian(at_ + 8 + size) == crc32(checked), who_,
                "PNG: the checksum of the chunk at byte ", at_, " is wrong: the file is damaged");
        data_ = checked.subspan(4);
        at_ += 12 + size;
        return kind;
    }
    void read_header() {
        require(data_.size() == 13, who_, "PNG: got a header of ", data_.size(),
                " bytes, expected 13");
        const auto byte = [&](std::size_t i) { return std::to_integer<int>(data_[i]); };
        const std::uint32_t width = big_endian(16), height = big_endian(20);
        const int depth = byte(8), colour = byte(9), interlaced = byte(12);
        require(depth == 8, who_, "PNG: got ", depth, " bits a channel, expected 8");
        require(colour == 0 || colour == 2 || colour == 3 || colour == 4 || colour == 6, who_,
                "PNG: got colour type ", colour, ", expected 0, 2, 3, 4 or 6");
        require(byte(10) == 0 && byte(11) == 0 && interlaced == 0, who_, "PNG: got compression ",
                byte(10), ", filters ", byte(11), " and interlacing ", interlaced,
                ", expected 0, 0 and 0: store it without interlacing");
        indexed = colour == 3;
        stored = indexed ? 1 : (colour & 2) + 1 + (colour & 4) / 4;
        const std::uint32_t most = max_image_edge + 1;
        header = {static_cast<int>(std::min(width, most)), static_cast<int>(std::min(height, most)),
                  indexed ? 3 : stored};
        check_image_size(header, who_);
    }

    ByteSpan file_, data_;
    const std::string& who_;
    std::uint64_t at_ = 8;
};

inline std::uint32_t adler32(ByteSpan bytes) {
    std::uint32_t a = 1, b = 0;
    for (const std::byte byte : bytes) {
        a = (a + std::to_integer<std::uint32_t>(byte)) % 65521U;
        b = (b + a) % 65521U;
    }
    return b << 16U | a;
}

/// Returns the rows of a zlib stream, each with its filter before it.
inline Bytes png_rows(ByteSpan packed, std::uint64_t size, const std::string& who) {
    require(packed.size() >= 6, who, "PNG: truncated: has no pixels");
    const auto byte = [&](std::size_t i) { return std::to_integer<std::uint32_t>(packed[i]); };
    require((byte(0) & 15U) == 8 && (byte(0) * 256 + byte(1)) % 31 == 0 && (byte(1) & 32U) == 0,
            who, "PNG: its pixels are no zlib stream");
    const std::size_t end = packed.size() - 4;
    Bytes rows = inflate(packed.subspan(2, end - 2), size, who);
    require(adler32(rows) == (byte(end) << 24U | byte(end + 1) << 16U | byte(end + 2) << 8U |
                              byte(end + 3)),
            who, "PNG: the checksum of its pixels is wrong: the file is damaged");
    return rows;
}

/// Undoes the filter of a row: x is the value to the left, above it, above left of it.
inline int png_prediction(int filter, int left, int above, int corner) {
    const int p = left + above - corner;
    const int a = std::abs(p - left), b = std::abs(p - above), c = std::abs(p - corner);
    const int paeth = a <= b && a <= c ? left : b <= c ? above : corner;
    return filter == 0 ? 0 : filter == 1 ? left : filter == 2 ? above
         : filter == 3 ? (left + above) / 2 : paeth;
}

} // namespace detail

/// Decodes a PNG; errors begin with `who`. Throws an Error for one that is damaged, of a kind that
/// is not read here, or whose pixels would take more bytes than `memory`.
inline Image8 parse_png(ByteSpan file, const std::string& who,
                        std::uint64_t memory = default_memory) {
    const detail::PngChunks png(file, who, false);
    const ImageHeader& h = png.header;
    const std::size_t step = static_cast<std::size_t>(png.stored);
    const std::size_t row = static_cast<std::size_t>(h.width) * step;
    const std::uint64_t size = (row + 1) * static_cast<std::uint64_t>(h.height);
    require_memory(2 * size + (png.indexed ? 3 * size : 0), memory, who,
                   "its " + std::to_string(h.width) + " x " + std::to_string(h.height) + " pixels");
    const Bytes rows = detail::png_rows(png.packed, size, who);
    Image8 image{h.width, h.height, png.stored, {}};
    image.values.resize(row * static_cast<std::size_t>(h.height));
    std::uint8_t* const to = image.values.data();
    for (std::size_t y = 0; y < static_cast<std::size_t>(h.height); ++y) {
        const std::byte* const from = rows.data() + y * (row + 1);
        const int filter = std::to_integer<int>(*from);
        require(filter < 5, who, "PNG: row ", y, " has filter ", filter, ", expected 0 to 4");
        for (std::size_t i = 0; i < row; ++i) {
            const std::size_t at = y * row + i;
            const int left = i < step ? 0 : to[at - step], above = y == 0 ? 0 : to[at - row];
            const int corner = i < step || y == 0 ? 0 : to[at - row - step];
            to[at] = static_cast<std::uint8_t>(
                std::to_integer<int>(from[i + 1]) +
                detail::png_prediction(filter, left, above, corner));
        }
    }
    if (!png.indexed) return image;
    Image8 coloured{h.width, h.height, 3, {}};
    for (const std::size_t index : image.values) {
        require(3 * index + 3 <= png.palette.size(), who, "PNG: a pixel has colour ", index,
                " of a palette of ", png.palette.size() / 3);
        for (std::size_t c = 0; c < 3; ++c)
            coloured.values.push_back(std::to_integer<std::uint8_t>(png.palette[3 * index + c]));
    }
    return coloured;
}

/// A PictureReader of PNG files. Each call decodes its file again.
struct PngFiles {
    std::uint64_t memory = default_memory;  ///< limit of one picture [bytes]

    /// Returns size and channels, of the file's beginning.
    ImageHeader header(const std::filesystem::path& path) const {
        const std::string who = path.string();
        return detail::PngChunks(read_beginning(path, 64), who, true).header;
    }
    /// Returns the picture in 1 or 3 channels, or with 0 in the file's; `to_float(...)` has 0..1.
    Image8 read(const std::filesystem::path& path, int channels) const {
        return with_channels(parse_png(read_file(path), path.string(), memory), channels);
    }
};

} // namespace rye
