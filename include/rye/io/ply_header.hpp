// SPDX-License-Identifier: Apache-2.0
/// rye/io/ply_header.hpp: the header of a PLY file: type and offset of each property.
/// Source: Turk, "The PLY Polygon File Format", 1994.
#pragma once

#include <array>
#include <charconv>
#include <cstdint>
#include <functional>
#include <istream>
#include <limits>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <rye/core/checksum.hpp>
#include <rye/core/config.hpp>
#include <rye/core/error.hpp>

namespace rye::detail {

/// Number types of PLY.
enum class PlyType { i8, u8, i16, u16, i32, u32, f32, f64 };

/// A property of a vertex.
struct PlyProperty {
    std::string name;
    PlyType type = PlyType::f32;
    Index offset = 0;                    ///< in the record [bytes]
};

/// Description of the vertices in the header, and their beginning.
struct PlyHeader {
    bool ascii = false;
    Index count = 0;                     ///< number of vertices
    Index stride = 0;                    ///< size of a binary vertex [bytes]
    Index skip = 0;                      ///< binary data before the first vertex [bytes]
    Index skip_lines = 0;                ///< ascii lines before the first vertex
    std::vector<PlyProperty> properties; ///< properties of a vertex
    std::string checksum;                ///< checksum stated by the file, or empty
    std::uint32_t crc = 0;               ///< checksum of the header, with its own digits as 0
    std::map<std::string, Index, std::less<>> place;  ///< index of each name in `properties`

    /// Returns the index of a property, or -1.
    Index find(std::string_view name) const {
        const auto found = place.find(name);
        return found == place.end() ? -1 : found->second;
    }
};

/// Returns the bytes of a number in a binary file.
inline Index ply_size(PlyType type) {
    constexpr std::array<Index, 8> bytes{1, 1, 2, 2, 4, 4, 4, 8};
    return bytes[static_cast<std::size_t>(type)];
}

/// Beginning of the comment with the checksum: 8 hexadecimal digits of the CRC-32 of the header,
/// with these digits as 0 and lines that end with LF, and of the vertices.
inline constexpr std::string_view ply_checksum_line = "comment checksum crc32 ";
/// Returns true if a byte separates words, in any locale.
constexpr bool ply_space(int c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

/// Removes the next word from the beginning of a line and returns it; empty at the end.
inline std::string_view ply_word(std::string_view& line) {
    while (!line.empty() && ply_space(line.front())) line.remove_prefix(1);
    std::size_t end = 0;
    while (end < line.size() && !ply_space(line[end])) ++end;
    const std::string_view word = line.substr(0, end);
    line.remove_prefix(end);
    return word;
}

/// Returns a header line without its line end, LF or CRLF. Throws an Error for an overlong line.
inline std::string ply_line(std::istream& in, const std::string& who) {
    constexpr std::size_t longest = 4096;
    std::string line;
    for (;;) {
        const int c = in.get();
        require(c != std::istream::traits_type::eof(), who,
                "the file ends within the header, before end_header");
        if (c == '\n') break;
        line.push_back(static_cast<char>(c));
        require(line.size() <= longest, who, "a header line exceeds ", longest,
                " bytes: not a PLY file");
    }
    if (!line.empty() && line.back() == '\r') line.pop_back();
    return line;
}

inline PlyType ply_type(const std::string& name, const std::string& who) {
    constexpr std::array<std::array<std::string_view, 2>, 8> names{
        {{"char", "int8"}, {"uchar", "uint8"}, {"short", "int16"}, {"ushort", "uint16"},
         {"int", "int32"}, {"uint", "uint32"}, {"float", "float32"}, {"double", "float64"}}};
    for (std::size_t i = 0; i < names.size(); ++i)
        if (name == names[i][0] || name == names[i][1]) return static_cast<PlyType>(i);
    throw Error(who + ": got a property of type \"" + name + "\", expected a PLY number type");
}

inline Index ply_count(const std::string& text, const std::string& who) {
    Index n = -1;
    const auto [end, fault] = std::from_chars(text.data(), text.data() + text.size(), n);
    require(fault == std::errc() && end == text.data() + text.size() && n >= 0, who,
            "got element count \"", text, "\", expected a whole number of at most ",
            std::numeric_limits<Index>::max());
    return n;
}

/// Reads up to and including end_header; messages begin with `who`.
inline PlyHeader read_ply_header(std::istream& in, const std::string& who) {
    constexpr int most_lines = 65536;
    PlyHeader h;
    const auto next_line = [&] {
        std::string line = detail::ply_line(in, who), counted = line + "\n";
        const std::size_t digits = detail::ply_checksum_line.size();
        if (line.starts_with(detail::ply_checksum_line) && h.checksum.empty() &&
            line.size() == digits + checksum_digits) {
            h.checksum = line.substr(digits);
            counted.replace(digits, checksum_digits, checksum_digits, '0');
        }
        h.crc = crc32(std::as_bytes(std::span<const char>(counted)), h.crc);
        return line;
    };
    require(next_line() == "ply", who, "the first line is not \"ply\"");
    bool format_seen = false, vertex_seen = false, in_vertex = false;
    Index element_count = 0, element_stride = 0;
    const auto close = [&] {             // skips elements before the vertices
        if (vertex_seen || element_count == 0) return;
        constexpr Index most = std::numeric_limits<Index>::max();
        require(element_count <= most - h.skip_lines &&
                    (element_stride == 0 || element_count <= (most - h.skip) / element_stride),
                who, "an element before the vertices is too large to skip");
        h.skip += element_count * element_stride;
        h.skip_lines += element_count;
    };
    for (int lines = 0;; ++lines) {
        require(lines < most_lines, who, "no end_header in the first ", most_lines, " lines");
        const std::string line = next_line();
        std::string_view words = line;
        const std::string key(detail::ply_word(words)), a(detail::ply_word(words)),
            b(detail::ply_word(words));
        if (key == "end_header") break;
        if (key == "comment" || key == "obj_info" || key.empty()) continue;
        if (key == "format") {
            require(a != "binary_big_endian", who,
                    "the file is big-endian, expected ascii or binary_little_endian");
            require(a == "ascii" || a == "binary_little_endian", who, "got format \"", a,
                    "\", expected ascii or binary_little_endian");
            h.ascii = a == "ascii";
            format_seen = true;
        } else if (key == "element") {
            close();
            in_vertex = a == "vertex";
            require(!(in_vertex && vertex_seen), who, "the header has two vertex elements");
            element_count = detail::ply_count(b, who);
            element_stride = 0;
            if (in_vertex) {
                vertex_seen = true;
                h.count = element_count;
            }
        } else if (key == "property") {
            if (a == "list") {
                require(vertex_seen && !in_vertex, who,
                        "list properties in or before the vertices are not supported");
                continue;
            }
            const PlyType type = detail::ply_type(a, who);
            if (in_vertex) {
                require(!b.empty(), who, "a property has no name");
                const bool first =
                    h.place.emplace(b, static_cast<Index>(h.properties.size())).second;
                require(first, who, "property ", b, " occurs twice");
                h.properties.push_back({b, type, h.stride});
                h.stride += ply_size(type);
            }
            element_stride += ply_size(type);
        } else {
            throw Error(who + ": got the header line \"" + key + "\", expected a PLY keyword");
        }
    }
    require(format_seen, who, "the header has no format line");
    require(vertex_seen, who, "the header has no vertex element");
    return h;
}

} // namespace rye::detail
