// SPDX-License-Identifier: Apache-2.0
/// rye/io/npz.hpp: NumPy's .npz: a zip file of .npy arrays, stored or deflated.
/// Reads the central directory (NumPy's local headers may have zip64 fields), and verifies every
/// array's checksum. Written files are stored, as by np.savez.
/// Source: PKWARE APPNOTE 6.3.
#pragma once

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <rye/io/atomic_file.hpp>
#include <rye/io/bytes.hpp>
#include <rye/io/inflate.hpp>
#include <rye/io/npy.hpp>
#include <rye/core/error.hpp>
#include <rye/core/memory.hpp>

namespace rye {

/// Arrays by name, without ".npy".
using NpzArrays = std::map<std::string, NpyArray>;

namespace detail {

struct ZipMember {
    std::string name;
    int method = 0;
    std::uint32_t crc = 0;
    std::uint64_t packed = 0;    // [bytes]
    std::uint64_t unpacked = 0;  // [bytes]
    std::uint64_t header = 0;    // offset of its local header
};

struct ZipDirectory {
    std::uint64_t offset = 0, count = 0, size = 0;
};

inline ZipDirectory find_zip_directory(ByteSpan zip, const std::string& who) {
    // The end record has 22 bytes, then a comment of up to 65535.
    require(zip.size() >= 22, who, "truncated: got ", zip.size(),
            " bytes, expected a zip file (npz) of at least 22");
    std::uint64_t end = zip.size() - 22;
    const std::uint64_t lowest = end > 65535 ? end - 65535 : 0;
    while (read_at<std::uint32_t>(zip, end, who, "zip end") != 0x06054b50U)
        if (end-- == lowest)
            throw Error(who + ": truncated or not a zip file (npz): it has no end of directory");
    ZipDirectory directory{read_at<std::uint32_t>(zip, end + 16, who, "zip end"),
                           read_at<std::uint16_t>(zip, end + 10, who, "zip end"),
                           read_at<std::uint32_t>(zip, end + 12, who, "zip end")};
    if (directory.offset != 0xFFFFFFFFU && directory.count != 0xFFFFU) return directory;
    require(end >= 20 && read_at<std::uint32_t>(zip, end - 20, who, "zip64 locator") == 0x07064b50U,
            who, "its zip64 locator is missing");
    const auto end64 = read_at<std::uint64_t>(zip, end - 12, who, "zip64 locator");
    require(read_at<std::uint32_t>(zip, end64, who, "zip64 end") == 0x06064b50U, who,
            "its zip64 end of directory is missing");
    return {read_at<std::uint64_t>(zip, end64 + 48, who, "zip64 end"),
            read_at<std::uint64_t>(zip, end64 + 32, who, "zip64 end"),
            read_at<std::uint64_t>(zip, end64 + 40, who, "zip64 end")};
}

/// Sizes and offsets of 2^32 - 1 are stored in the zip64 field, in this order, 8 bytes each.
inline void read_zip64_field(ByteSpan extra, ZipMember& m, const std::string& who) {
    constexpr std::uint64_t absent = 0xFFFFFFFFU;
    if (m.unpacked != absent && m.packed != absent && m.header != absent) return;
    for (std::uint64_t at = 0; at < extra.size();) {
        const auto id = read_at<std::uint16_t>(extra, at, who, "a zip extra field");
        const auto size = read_at<std::uint16_t>(extra, at + 2, who, "a zip extra field");
        const ByteSpan field = slice(extra, at + 4, size, who, "a zip extra field");
        at += 4 + std::uint64_t(size);
        if (id != 1) continue;
        std::uint64_t next = 0;
        for (std::uint64_t* value : {&m.unpacked, &m.packed, &m.header})
            if (*value == absent) {
                *value = read_at<std::uint64_t>(field, next, who, "a zip64 field");
                next += 8;
            }
        return;
    }
    throw Error(who + ": the zip64 field of '" + m.name + "' is missing");
}

inline std::vector<ZipMember> read_zip_directory(ByteSpan zip, const std::string& who) {
    const ZipDirectory directory = find_zip_directory(zip, who);
    std::uint64_t at = directory.offset;
    std::vector<ZipMember> members;
    for (std::uint64_t i = 0; i < directory.count; ++i) {
        const char* what = "the zip directory";
        require(read_at<std::uint32_t>(zip, at, who, what) == 0x02014b50U, who, "entry ", i,
                " of its zip directory is damaged");
        const auto flags = read_at<std::uint16_t>(zip, at + 8, who, what);
        ZipMember m;
        m.method = read_at<std::uint16_t>(zip, at + 10, who, what);
        m.crc = read_at<std::uint32_t>(zip, at + 16, who, what);
        m.packed = read_at<std::uint32_t>(zip, at + 20, who, what);
        m.unpacked = read_at<std::uint32_t>(zip, at + 24, who, what);
        const auto name = read_at<std::uint16_t>(zip, at + 28, who, what);
        const auto extra = read_at<std::uint16_t>(zip, at + 30, who, what);
        const auto comment = read_at<std::uint16_t>(zip, at + 32, who, what);
        m.header = read_at<std::uint32_t>(zip, at + 42, who, what);
        m.name = as_text(slice(zip, at + 46, name, who, what));
        require((flags & 1U) == 0, who, "'", m.name, "' is encrypted");
        read_zip64_field(slice(zip, at + 46 + name, extra, who, what), m, who);
        at += 46 + std::uint64_t(name) + extra + comment;
        members.push_back(std::move(m));
    }
    // No checksum covers the directory, but the number of its entries and their names are stored
    // twice.
    require(at - directory.offset == directory.size, who, "its zip directory has ",
            at - directory.offset, " bytes, expected ", directory.size);
    return members;
}

/// Byte range of a member's data, from its local header.
struct ZipExtent {
    std::uint64_t begin = 0, data = 0, end = 0;
};

inline ZipExtent zip_extent(ByteSpan zip, const ZipMember& m, const std::string& who) {
    const char* what = "a zip local header";
    require(read_at<std::uint32_t>(zip, m.header, who, what) == 0x04034b50U, who,
            "its zip local header is damaged");
    const auto name = read_at<std::uint16_t>(zip, m.header + 26, who, what);
    const auto extra = read_at<std::uint16_t>(zip, m.header + 28, who, what);
    const std::uint64_t data = m.header + 30 + name + extra;
    slice(zip, data, m.packed, who, "its data");
    return {m.header, data, data + m.packed};
}

/// Throws an Error unless the local header, which no checksum covers, has the directory's name.
inline void require_same_name(ByteSpan zip, const ZipMember& m, const std::string& who) {
    const char* what = "a zip local header";
    const auto length = read_at<std::uint16_t>(zip, m.header + 26, who, what);
    require(as_text(slice(zip, m.header + 30, length, who, what)) == m.name, who,
            "its zip local header has another name: the file is damaged");
}

/// Throws an Error if members share bytes: a small file could then unpack to any size.
inline void require_apart(const std::vector<ZipMember>& members, std::vector<ZipExtent> extents,
                          const std::string& who) {
    std::sort(extents.begin(), extents.end(),
              [](const ZipExtent& a, const ZipExtent& b) { return a.begin < b.begin; });
    for (std::size_t i = 1; i < extents.size(); ++i)
        require(extents[i - 1].end <= extents[i].begin, who, "two of its ", members.size(),
                " members overlap at byte ", extents[i].begin);
}

/// Memory of a file's arrays read so far, and its limit [bytes].
struct NpzMemory {
    std::uint64_t held = 0, most = 0;
};

inline NpyArray unpack_npy(ByteSpan packed, const ZipMember& m, NpzMemory& memory,
                           const std::string& who) {
    require(m.method == 0 || m.method == 8, who, "got zip method ", m.method,
            ", expected 0 (stored) or 8 (deflate)");
    require(m.method == 8 || m.packed == m.unpacked, who, "its two sizes differ though stored");
    if (m.method == 8) require_inflatable(packed, m.unpacked, who);
    memory.held = saturated_sum(memory.held, m.unpacked);
    require_memory(saturated_sum(memory.held, m.method == 8 ? m.unpacked : 0), memory.most, who,
                   "the file's arrays to here");
    Bytes unpacked;
    ByteSpan bytes = packed;
    if (m.method == 8) bytes = unpacked = inflate(packed, m.unpacked, who);
    require(crc32(bytes) == m.crc, who, "its checksum (CRC-32) is wrong: the file is damaged");
    return parse_npy(bytes, who);
}

} // namespace detail

/// Parses the bytes of a .npz file; errors begin with `who`. Throws an Error before its arrays,
/// including the one being unpacked, take more bytes than `memory`.
inline NpzArrays parse_npz(ByteSpan zip, const std::string& who,
                           std::uint64_t memory = default_memory) {
    NpzArrays arrays;
    detail::NpzMemory held{0, memory};
    const std::vector<detail::ZipMember> members = detail::read_zip_directory(zip, who);
    std::vector<detail::ZipExtent> extents;
    for (const detail::ZipMember& m : members)
        extents.push_back(detail::zip_extent(zip, m, who + ": '" + m.name + "'"));
    detail::require_apart(members, extents, who);
    for (std::size_t i = 0; i < members.size(); ++i) {
        const detail::ZipMember& m = members[i];
        const std::string label = who + ": '" + m.name + "'";
        const ByteSpan packed = zip.subspan(static_cast<std::size_t>(extents[i].data),
                                            static_cast<std::size_t>(m.packed));
        detail::require_same_name(zip, m, label);
        require(m.name.size() > 4 && m.name.ends_with(".npy"), label, "has no name ending in .npy");
        const bool first = arrays.emplace(m.name.substr(0, m.name.size() - 4),
                                          detail::unpack_npy(packed, m, held, label)).second;
        require(first, label, "appears twice");
    }
    return arrays;
}

/// Reads the arrays of an npz file. Throws an Error as parse_npz does, with the path.
inline NpzArrays read_npz(const std::filesystem::path& path,
                          std::uint64_t memory = default_memory) {
    return parse_npz(read_file(path), path.string(), memory);
}

/// Returns the bytes of a .npz file, stored, with a fixed date (1980-01-01), so that equal arrays
/// give equal files.
inline Bytes npz_bytes(const NpzArrays& arrays) {
    using U16 = std::uint16_t;
    using U32 = std::uint32_t;
    Bytes out, directory;
    for (const auto& [key, array] : arrays) {
        const Bytes data = npy_bytes(array);
        const std::string name = key + ".npy";
        require(out.size() + data.size() < std::numeric_limits<U32>::max() - 65536U, "npz_bytes",
                "the file would exceed 4 GiB");
        const auto offset = static_cast<U32>(out.size());
        const auto common = [&](Bytes& to) {
            append(to, U16(0));     // flags
            append(to, U16(0));     // stored
            append(to, U16(0));     // time
            append(to, U16(0x21));  // 1980-01-01
            append(to, crc32(data));
            append(to, static_cast<U32>(data.size()));
            append(to, static_cast<U32>(data.size()));
            append(to, static_cast<U16>(name.size()));
            append(to, U16(0));     // no extra field
        };
        append(out, U32(0x04034b50));
        append(out, U16(20));       // needs zip 2.0
        common(out);
        append(out, as_bytes(name));
        append(out, data);
        append(directory, U32(0x02014b50));
        append(directory, U16(20));
        append(directory, U16(20));
        common(directory);
        append(directory, U16(0));  // comment
        append(directory, U16(0));  // disk
        append(directory, U16(0));  // attributes
        append(directory, U32(0));
        append(directory, offset);
        append(directory, as_bytes(name));
    }
    const auto start = static_cast<U32>(out.size());
    append(out, directory);
    append(out, U32(0x06054b50));
    append(out, U32(0));  // disks
    append(out, static_cast<U16>(arrays.size()));
    append(out, static_cast<U16>(arrays.size()));
    append(out, static_cast<U32>(directory.size()));
    append(out, start);
    append(out, U16(0));  // comment
    return out;
}

/// Replaces an npz file; its members are stored uncompressed.
inline void write_npz(const std::filesystem::path& path, const NpzArrays& arrays) {
    write_atomic(path, npz_bytes(arrays));
}

} // namespace rye
