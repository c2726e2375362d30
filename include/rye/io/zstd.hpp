// SPDX-License-Identifier: Apache-2.0
/// rye/io/zstd.hpp: zstd frames, by functions, so that a program may pass its own library's.
/// Without one the data are stored uncompressed, which every reader of zstd accepts, and frames
/// that others stored so are read.
/// Source: RFC 8878.
#pragma once

#include <algorithm>
#include <functional>
#include <string>

#include <rye/io/bytes.hpp>
#include <rye/core/error.hpp>

namespace rye {

/// Function from bytes to one zstd frame.
using ZstdCompress = std::function<Bytes(ByteSpan raw)>;
/// Function from one zstd frame to its data. Throws an Error that begins with `who` for a damaged
/// frame, and for data of another size than `size` [bytes], without allocating more than that.
using ZstdDecompress =
    std::function<Bytes(ByteSpan frame, std::size_t size, const std::string& who)>;

namespace detail {

inline constexpr std::uint32_t zstd_magic = 0xFD2FB528;
inline constexpr std::size_t zstd_longest_block = std::size_t(1) << 17U; // of data [bytes]

/// Returns the size of a frame's header [bytes]. Throws an Error unless it has no dictionary.
inline std::size_t zstd_header_size(ByteSpan frame, const std::string& who) {
    constexpr const char* what = "the header of a zstd frame";
    require(read_at<std::uint32_t>(frame, 0, who, what) == zstd_magic, who,
            "zstd: a frame does not begin with the bytes 28 b5 2f fd");
    const auto description = static_cast<unsigned>(read_at<std::uint8_t>(frame, 4, who, what));
    require((description & 11U) == 0, who, "zstd: got the frame header ", description,
            ", expected one without a dictionary");
    const bool single = (description & 32U) != 0;
    const std::size_t sizes[]{single ? std::size_t(1) : std::size_t(0), 2, 4, 8};
    return 5 + (single ? 0 : 1) + sizes[description >> 6U];
}

} // namespace detail

/// Returns a frame of stored blocks: no compression, 3 more bytes for every 131072.
inline Bytes stored_zstd(ByteSpan raw) {
    Bytes out;
    out.reserve(raw.size() + 3 * (raw.size() / detail::zstd_longest_block + 1) + 13);
    append(out, detail::zstd_magic);
    append(out, std::uint8_t(0xE0)); // a size of 8 bytes, which is the window's too
    append(out, std::uint64_t{raw.size()});
    do {
        const ByteSpan block = raw.first(std::min(raw.size(), detail::zstd_longest_block));
        raw = raw.subspan(block.size());
        const auto header =
            static_cast<std::uint32_t>(block.size() << 3U) | (raw.empty() ? 1U : 0U);
        for (const unsigned shift : {0U, 8U, 16U})
            append(out, static_cast<std::uint8_t>(header >> shift));
        append(out, block);
    } while (!raw.empty());
    return out;
}

/// Returns the data of a frame of stored blocks, and of blocks of one byte repeated. Throws an
/// Error for a compressed block, which needs a library, and as ZstdDecompress does. A checksum is
/// not compared.
inline Bytes read_stored_zstd(ByteSpan frame, std::size_t size, const std::string& who) {
    std::size_t at = detail::zstd_header_size(frame, who);
    const bool checksum = (std::to_integer<unsigned>(frame[4]) & 4U) != 0;
    Bytes out;
    for (bool last = false; !last;) {
        const ByteSpan h = slice(frame, at, 3, who, "the header of a zstd block");
        const unsigned header = std::to_integer<unsigned>(h[0]) |
                                std::to_integer<unsigned>(h[1]) << 8U |
                                std::to_integer<unsigned>(h[2]) << 16U;
        const unsigned type = header >> 1U & 3U;
        const std::size_t length = header >> 3U;
        last = (header & 1U) != 0;
        at += 3;
        require(type < 2, who, "zstd: ",
                type == 2 ? "a block is compressed, and no decompressor was given"
                          : "a block has the reserved type 3");
        require(length <= size - out.size() && length <= detail::zstd_longest_block, who,
                "zstd: a block of ", length, " bytes, expected at most the ", size - out.size(),
                " that are left, and ", detail::zstd_longest_block);
        const ByteSpan block = slice(frame, at, type == 0 ? length : 1, who, "a zstd block");
        if (type == 0)
            append(out, block);
        else
            out.resize(out.size() + length, block[0]);
        at += block.size();
    }
    at += checksum ? 4 : 0;
    require(out.size() == size && at == frame.size(), who, "zstd: got ", out.size(),
            " bytes of data in ", at, ", expected ", size, " in ", frame.size());
    return out;
}

namespace detail {

/// Throws an Error if a frame is too short for data of a size: 4 bytes hold at most 131072.
inline void require_zstd_holds(std::size_t frame, std::uint64_t size, const std::string& who) {
    require(size / detail::zstd_longest_block <= frame / 4, who, "zstd: a frame of ", frame,
            " bytes cannot hold the declared ", size);
}

} // namespace detail

} // namespace rye
