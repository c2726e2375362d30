// SPDX-License-Identifier: Apache-2.0
/// rye/io/gzip.hpp: gzip files of one member. Reading needs no library (inflate.hpp). Writing
/// takes the compressor as a function, so that a program may pass its own library's; without one
/// the data are stored uncompressed, which every reader of gzip accepts.
/// Source: RFC 1952 (gzip), RFC 1951 (stored blocks).
#pragma once

#include <algorithm>
#include <functional>
#include <string>

#include <rye/io/inflate.hpp>
#include <rye/core/memory.hpp>

namespace rye {

/// Function from bytes to a raw deflate stream (RFC 1951, without zlib's header).
using Deflate = std::function<Bytes(ByteSpan)>;

/// Returns a deflate stream of stored blocks: no compression, 5 more bytes for every 65535.
inline Bytes stored_deflate(ByteSpan raw) {
    constexpr std::size_t longest = 65535;
    Bytes out;
    out.reserve(raw.size() + 5 * (raw.size() / longest + 1));
    do {
        const ByteSpan block = raw.first(std::min(raw.size(), longest));
        raw = raw.subspan(block.size());
        const auto length = static_cast<std::uint16_t>(block.size());
        append(out, static_cast<std::uint8_t>(raw.empty() ? 1 : 0)); // last block, type 0
        append(out, length);
        append(out, static_cast<std::uint16_t>(~length));
        append(out, block);
    } while (!raw.empty());
    return out;
}

/// Returns true if bytes begin as a gzip file.
inline bool is_gzip(ByteSpan bytes) {
    return bytes.size() >= 2 && bytes[0] == std::byte(0x1F) && bytes[1] == std::byte(0x8B);
}

/// Returns a gzip file of `raw`; throws an Error from 4 GiB on, whose size the format cannot hold.
inline Bytes gzip_bytes(ByteSpan raw, const Deflate& deflate = stored_deflate) {
    require(std::uint64_t{raw.size()} < (std::uint64_t(1) << 32U), "gzip_bytes", "got ", raw.size(),
            " bytes, expected fewer than 2^32");
    Bytes out;
    for (const unsigned b : {0x1FU, 0x8BU, 8U, 0U, 0U, 0U, 0U, 0U, 0U, 255U})
        append(out, static_cast<std::uint8_t>(b)); // deflate, no name, no time, unknown system
    append(out, ByteSpan(deflate(raw)));
    append(out, crc32(raw));
    append(out, static_cast<std::uint32_t>(raw.size()));
    return out;
}

namespace detail {

/// Packed contents of a gzip file of one member.
struct GzipContents {
    ByteSpan deflated;
    std::uint32_t crc = 0;  ///< of the data
    std::uint32_t size = 0; ///< of the data, as the file states it [bytes]
};

/// Finds the data of a gzip file; messages begin with `who`. Throws an Error for another format or
/// truncation.
inline GzipContents gzip_contents(ByteSpan file, const std::string& who) {
    require(is_gzip(file), who, "not a gzip file: it does not begin with the bytes 1f 8b");
    const auto method = read_at<std::uint8_t>(file, 2, who, "the gzip header");
    const auto flags = read_at<std::uint8_t>(file, 3, who, "the gzip header");
    require(method == 8, who, "gzip: got method ", method, ", expected 8 (deflate)");
    require((flags & 0xE0U) == 0, who, "gzip: got flags ", flags, ", expected below 32");
    std::uint64_t at = 10;
    if ((flags & 4U) != 0) at += 2U + read_at<std::uint16_t>(file, at, who, "gzip's extra field");
    for (const unsigned text : {8U, 16U}) { // name, comment
        if ((flags & text) == 0) continue;
        while (read_at<std::uint8_t>(file, at++, who, "gzip's name or comment") != 0) {}
    }
    if ((flags & 2U) != 0) at += 2;
    require(at + 8 <= file.size(), who, "truncated: got ", file.size(),
            " bytes, expected at least the ", at + 8, " of a gzip header and trailer");
    const auto crc = read_at<std::uint32_t>(file, file.size() - 8, who, "gzip's checksum");
    const auto size = read_at<std::uint32_t>(file, file.size() - 4, who, "gzip's size");
    return {
        file.subspan(static_cast<std::size_t>(at), static_cast<std::size_t>(file.size() - 8 - at)),
        crc, size};
}

} // namespace detail

/// Returns the unpacked data of gzip_contents. Throws an Error for a wrong size or checksum, and,
/// before they are allocated, for data of more than `memory` bytes.
inline Bytes gunzip(const detail::GzipContents& contents, const std::string& who,
                    std::uint64_t memory = default_memory) {
    detail::require_inflatable(contents.deflated, contents.size, who);
    require_memory(contents.size, memory, who, "its data");
    Bytes raw = inflate(contents.deflated, contents.size, who);
    require(crc32(raw) == contents.crc, who,
            "gzip: the checksum of the data is wrong: a damaged file");
    return raw;
}

/// Returns the data of a gzip file of one member; throws an Error as gzip_contents and the other
/// overload do.
inline Bytes gunzip(ByteSpan file, const std::string& who, std::uint64_t memory = default_memory) {
    return gunzip(detail::gzip_contents(file, who), who, memory);
}

} // namespace rye
