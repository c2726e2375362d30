// SPDX-License-Identifier: Apache-2.0
/// rye/capture/splats.hpp: splat files of several kinds: reads PLY, .splat or SPZ, recognised by
/// content; writes PLY, .splat, SPZ or GLB by the name's extension. For known files of other
/// programs the error gives the command that converts them. Clouds have the axes of a PLY (x right,
/// y down, z forward for an upright subject), whatever the file's are; world units.
#pragma once

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>
#include <string>
#include <string_view>

#include <rye/capture/glb.hpp>
#include <rye/capture/splat_file.hpp>
#include <rye/capture/spz.hpp>
#include <rye/gaussian/ply.hpp>

namespace rye {

/// Kinds of splat files that are read, written, or only recognised.
enum class SplatKind {
    ply,
    splat,
    spz,
    glb, ///< written only
    compressed_ply,
    spz4,
    sog,
    ksplat,
    lcc,
    gltf, ///< recognised, neither read nor written
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
    if (begins("NGSP")) return SplatKind::spz4;
    if (begins("glTF")) return SplatKind::glb;
    const std::pair<std::string_view, SplatKind> by_name[]{
        {".splat", SplatKind::splat},  {".ksplat", SplatKind::ksplat}, {".sog", SplatKind::sog},
        {"meta.json", SplatKind::sog}, {".lcc", SplatKind::lcc},       {".lcc2", SplatKind::lcc},
        {".gltf", SplatKind::gltf},    {".glb", SplatKind::glb},       {".spz", SplatKind::spz},
        {".ply", SplatKind::ply}};
    for (const auto& [end, kind] : by_name)
        if (name.ends_with(end)) return kind;
    return begins("PK\x03\x04") ? SplatKind::sog : SplatKind::unknown;
}

/// Returns advice for a file of a kind that is not read; empty for kinds that are.
inline std::string splat_advice(SplatKind kind, const std::string& path) {
    const char* name = "";
    switch (kind) {
        case SplatKind::ply:
        case SplatKind::splat:
        case SplatKind::spz:
            return "";
        case SplatKind::compressed_ply:
            name = "a compressed PLY (PlayCanvas)";
            break;
        case SplatKind::spz4:
            name = "SPZ version 4";
            break;
        case SplatKind::sog:
            name = "SOG (PlayCanvas)";
            break;
        case SplatKind::ksplat:
            name = "KSPLAT (GaussianSplats3D)";
            break;
        case SplatKind::lcc:
            name = "LCC (XGRIDS)";
            break;
        case SplatKind::glb:
        case SplatKind::gltf:
            return "glTF, which is not read; give the PLY, .splat or SPZ that it was made from";
        case SplatKind::unknown:
            return "no splat file that is known: expected a PLY, .splat or SPZ (version 2 or 3)";
    }
    return std::string(name) +
           ", which is not read; convert it with: npx "
           "@playcanvas/splat-transform " +
           path + " converted.ply";
}

/// Reads a PLY, .splat or SPZ file, or a PLY from a pipe. Throws an Error, with the path, if it
/// cannot be opened, is of another kind (with the converting command, if any), or as read_ply,
/// parse_splat and parse_spz do; `memory` is theirs.
template <Real T>
GaussianCloud<T> read_splats(const std::filesystem::path& path,
                             std::uint64_t memory = default_memory) {
    const std::string who = "read_splats: " + path.string();
    std::error_code status;
    const bool folder = std::filesystem::is_directory(path, status);
    require(!folder, who, "a folder, expected a file: PLY, .splat or SPZ");
    if (std::filesystem::exists(path, status) && !std::filesystem::is_regular_file(path, status))
        return read_ply<T>(path.string(), memory);
    const SplatKind kind = splat_kind(path, read_beginning(path, 65536));
    const std::string advice = splat_advice(kind, path.string());
    require(advice.empty(), who, advice);
    if (kind == SplatKind::splat) return parse_splat<T>(read_file(path), who, memory);
    if (kind == SplatKind::spz) return parse_spz<T>(read_file(path), who, memory);
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
                                                           {".glb", SplatKind::glb}};
    for (const auto& [end, kind] : written)
        if (!packed && name.ends_with(end)) return kind;
    throw Error(who + ": got the name " + path.string() +
                ", expected one that ends in .ply, .splat, .spz" +
                (also.empty() ? " or .glb" : ", .glb or " + also));
}

/// Options of splat_file_bytes.
struct SplatFileOptions {
    SplatKind kind = SplatKind::ply;
    PlyOptions ply = {};              ///< for a PLY
    Deflate deflate = stored_deflate; ///< compressor for an SPZ
};

/// Returns the bytes of a file of the given kind. Throws an Error as write_ply, splat_bytes,
/// spz_bytes and glb_bytes do, and for kinds that are not written.
template <Real T>
Bytes splat_file_bytes(const GaussianCloud<T>& cloud, const SplatFileOptions& options) {
    switch (options.kind) {
        case SplatKind::splat:
            return splat_bytes(cloud);
        case SplatKind::spz:
            return spz_bytes(cloud, options.deflate);
        case SplatKind::glb:
            return glb_bytes(cloud);
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
                "SPZ or GLB");
    }
}

} // namespace rye
