// SPDX-License-Identifier: Apache-2.0
/// rye/io/splats.hpp: splat files of several kinds: reads PLY, .splat, SPZ or glTF, recognised
/// by content; writes PLY, .splat, SPZ, GLB or USDA by the name's extension. For known files of
/// other programs the error gives the command that converts them. Clouds have the axes of a PLY (x
/// right, y down, z forward for an upright subject), whatever the file's are; world units.
#pragma once

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>
#include <string>
#include <string_view>

#include <rye/io/glb.hpp>
#include <rye/io/gltf.hpp>
#include <rye/io/splat_file.hpp>
#include <rye/io/spz.hpp>
#include <rye/io/usda.hpp>
#include <rye/io/ply.hpp>

namespace rye {

/// Kinds of splat files that are read, written, or only recognised.
enum class SplatKind {
    ply,
    splat,
    spz,
    glb,
    spz4, ///< SPZ of version 4, whose arrays are zstd
    gltf, ///< read only
    usda, ///< written only
    compressed_ply,
    sog,
    ksplat,
    lcc, ///< recognised, neither read nor written
    unknown
};

namespace detail {

inline std::string lower_name(const std::filesystem::path& path) {
    std::string name = path.filename().string();
    std::transform(name.begin(), name.end(), name.begin(),
                   [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; });
    return name;
}

inline bool begins(ByteSpan bytes, std::string_view text) {
    return as_text(bytes.first(std::min(bytes.size(), text.size()))) == text;
}

} // namespace detail

/// Returns the kind of a file from its name and first bytes. The content decides if it is
/// distinctive, else the extension (.splat and .ksplat have no signature). A few thousand bytes
/// suffice; kinds known by the name need none.
inline SplatKind splat_kind(const std::filesystem::path& path, ByteSpan beginning) {
    const std::string name = detail::lower_name(path);
    const auto begins = [&](std::string_view text) { return detail::begins(beginning, text); };
    if (begins("ply\n") || begins("ply\r\n")) {
        const std::string_view text = as_text(beginning);
        const bool packed = text.substr(0, text.find("end_header")).find("packed_position") !=
                            std::string_view::npos;
        return packed ? SplatKind::compressed_ply : SplatKind::ply;
    }
    if (is_gzip(beginning)) return SplatKind::spz;
    if (is_spz4(beginning)) return SplatKind::spz4;
    if (begins("glTF")) return SplatKind::glb;
    if (begins("#usda")) return SplatKind::usda;
    const std::pair<std::string_view, SplatKind> by_name[]{
        {".splat", SplatKind::splat},  {".ksplat", SplatKind::ksplat}, {".sog", SplatKind::sog},
        {"meta.json", SplatKind::sog}, {".lcc", SplatKind::lcc},       {".lcc2", SplatKind::lcc},
        {".gltf", SplatKind::gltf},    {".glb", SplatKind::glb},       {".spz", SplatKind::spz},
        {".ply", SplatKind::ply},      {".usda", SplatKind::usda}};
    for (const auto& [end, kind] : by_name)
        if (name.ends_with(end)) return kind;
    return begins("PK\x03\x04") ? SplatKind::sog : SplatKind::unknown;
}

namespace detail {

/// Returns advice for a file of a kind that is not read, or not without zstd; empty for kinds that
/// are.
inline std::string splat_advice(SplatKind kind, const std::string& path) {
    const char* name = "";
    switch (kind) {
        case SplatKind::ply:
        case SplatKind::splat:
        case SplatKind::spz:
        case SplatKind::glb:
        case SplatKind::gltf:
            return "";
        case SplatKind::compressed_ply:
            name = "a compressed PLY (PlayCanvas)";
            break;
        case SplatKind::spz4:
            // Its version 3.7 leaves the axes of an SPZ in a PLY.
            return "SPZ version 4, but this program was built without zstd; convert it with: npx "
                   "@playcanvas/splat-transform@2.7.1 " +
                   path + " converted.ply";
        case SplatKind::sog:
            name = "SOG (PlayCanvas)";
            break;
        case SplatKind::ksplat:
            name = "KSPLAT (GaussianSplats3D)";
            break;
        case SplatKind::lcc:
            name = "LCC (XGRIDS)";
            break;
        case SplatKind::usda:
            return "OpenUSD, which is not read; give the PLY, .splat, SPZ or glTF that it was made "
                   "from";
        case SplatKind::unknown:
            return "no splat file that is known: expected a PLY, .splat, SPZ or glTF";
    }
    return std::string(name) +
           ", which is not read; convert it with: npx "
           "@playcanvas/splat-transform " +
           path + " converted.ply";
}

} // namespace detail

/// Reads a PLY, .splat, SPZ or glTF file, or a PLY from a pipe; buffers of a glTF in files of their
/// own lie beside it. Throws an Error, with the path, if it cannot be opened, is of another kind
/// (with the converting command, if any), or as read_ply, parse_splat, parse_spz and parse_gltf do;
/// `memory` is theirs. SPZ of version 4 is read with `zstd` alone.
template <Real T>
GaussianCloud<T> read_splats(const std::filesystem::path& path,
                             std::uint64_t memory = default_memory,
                             const ZstdDecompress& zstd = {}) {
    const std::string who = "read_splats: " + path.string();
    std::error_code status;
    const bool folder = std::filesystem::is_directory(path, status);
    require(!folder, who, "a folder, expected a file: PLY, .splat, SPZ or glTF");
    if (std::filesystem::exists(path, status) && !std::filesystem::is_regular_file(path, status))
        return read_ply<T>(path.string(), memory);
    const SplatKind kind = splat_kind(path, read_beginning(path, 65536));
    if (kind == SplatKind::spz4 && zstd) return parse_spz<T>(read_file(path), who, memory, zstd);
    const std::string advice = detail::splat_advice(kind, path.string());
    require(advice.empty(), who, advice);
    if (kind == SplatKind::splat) return parse_splat<T>(read_file(path), who, memory);
    if (kind == SplatKind::spz) return parse_spz<T>(read_file(path), who, memory);
    if (kind == SplatKind::gltf || kind == SplatKind::glb) {
        const auto beside = [&](const std::string& uri, std::uint64_t size, const std::string&) {
            const std::u8string name(uri.begin(), uri.end()); // JSON is UTF-8
            return read_beginning(path.parent_path() / name, static_cast<std::size_t>(size));
        };
        return parse_gltf<T>(read_file(path), who, memory, beside);
    }
    return read_ply<T>(path.string(), memory);
}

/// Returns the kind that a name's extension asks for. Unless it is a kind that is written, throws
/// an Error that lists those kinds and `also`, the caller's own.
inline SplatKind written_splat_kind(const std::filesystem::path& path, const std::string& who,
                                    const std::string& also = "") {
    const std::string name = detail::lower_name(path);
    const bool packed = name.ends_with(".compressed.ply");
    const std::pair<std::string_view, SplatKind> written[]{{".ply", SplatKind::ply},
                                                           {".splat", SplatKind::splat},
                                                           {".spz", SplatKind::spz},
                                                           {".glb", SplatKind::glb},
                                                           {".usda", SplatKind::usda}};
    for (const auto& [end, kind] : written)
        if (!packed && name.ends_with(end)) return kind;
    throw Error(who + ": got the name " + path.string() +
                ", expected one that ends in .ply, .splat, .spz, .glb" +
                (also.empty() ? " or .usda" : ", .usda or " + also));
}

/// Options of splat_file_bytes.
struct SplatFileOptions {
    SplatKind kind = SplatKind::ply;
    PlyOptions ply = {};              ///< for a PLY
    Deflate deflate = stored_deflate; ///< compressor for an SPZ
    ZstdCompress zstd = stored_zstd;  ///< compressor for an SPZ of version 4
};

/// Returns the bytes of a file of the given kind. Throws an Error as write_ply, splat_bytes,
/// spz_bytes, spz4_bytes, glb_bytes and usda_text do, and for kinds that are not written.
template <Real T>
Bytes splat_file_bytes(const GaussianCloud<T>& cloud, const SplatFileOptions& options) {
    switch (options.kind) {
        case SplatKind::splat:
            return splat_bytes(cloud);
        case SplatKind::spz:
            return spz_bytes(cloud, options.deflate);
        case SplatKind::spz4:
            return spz4_bytes(cloud, options.zstd);
        case SplatKind::glb:
            return glb_bytes(cloud);
        case SplatKind::usda: {
            const std::string text = usda_text<T>({&cloud, 1});
            const ByteSpan span = as_bytes(text);
            return {span.begin(), span.end()};
        }
        case SplatKind::ply: {
            std::ostringstream text;
            write_ply(text, cloud, options.ply);
            const std::string bytes = text.str();
            const ByteSpan span = as_bytes(bytes);
            return {span.begin(), span.end()};
        }
        default:
            throw Error(
                "splat_file_bytes: got a kind that is not written, expected PLY, .splat, "
                "SPZ, GLB or USDA");
    }
}

} // namespace rye
