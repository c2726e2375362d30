// SPDX-License-Identifier: Apache-2.0
/// rye/io/ply.hpp: the PLY file of trained Gaussians, the format of 3DGS viewers.
/// Little-endian floats: mean, normal (zeros), f_dc, f_rest channel by channel, logit opacity, log
/// scale, quaternion w x y z. The reader accepts properties in any order, extra ones, ascii,
/// double, and files without normals, f_rest or the third scale. An infinite opacity, as writers
/// store for exactly 0 or 1, is read as the nearest one with a finite logit. A quaternion of zeros
/// is kept: it is the identity wherever quaternions are normalised (math/rotation.hpp).
/// The writer states a checksum in a comment, which covers header and numbers; the reader rejects a
/// binary file with a wrong one, and accepts a file without one.
/// Neither the program's locale nor the stream's changes a byte or a number.
/// Source: the writer of "3D Gaussian Splatting" (Kerbl et al., 2023).
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <ostream>
#include <span>
#include <sstream>
#include <string>
#include <string_view>
#include <vector>

#include <rye/core/bit_cast.hpp>
#include <rye/core/checksum.hpp>
#include <rye/core/format.hpp>
#include <rye/core/memory.hpp>
#include <rye/core/parse.hpp>
#include <rye/gaussian/cloud.hpp>
#include <rye/io/ply_header.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

namespace detail {

/// Log scale of the axis that flat Gaussians (2DGS) do not store: negligibly thin.
inline constexpr double flat_log_scale = -20;

} // namespace detail

/// Settings of write_ply.
struct PlyOptions {
    int degree = -1;           ///< degree of the harmonics, padded with zeros; -1: the cloud's
    std::string comment = {};  ///< a single line
};

namespace detail {

/// Returns the logit of an opacity in 0..1, finite at both ends, where it is the logit of the
/// largest number below 1, or its negative.
template <Real T>
T bounded_logit(T opacity) {
    constexpr T u = std::numeric_limits<T>::epsilon() / 2;
    return logit(std::clamp(opacity, u, T(1) - u));
}

/// Destination of a property in a cloud: an array and its row.
template <class T>
struct PlyTarget {
    Columns<T>* array = nullptr;
    Index row = 0;
};

/// Returns destinations of the properties of a vertex; throws an Error for a missing property.
template <class T>
std::vector<PlyTarget<T>> ply_targets(const PlyHeader& h, GaussianCloud<T>& cloud, bool flat,
                                      const std::string& who) {
    std::vector<PlyTarget<T>> targets(h.properties.size());
    const auto bind = [&](const std::string& name, Columns<T>& array, Index row) {
        const Index i = h.find(name);
        require(i >= 0, who, "the vertex has no property ", name);
        targets[static_cast<std::size_t>(i)] = {&array, row};
    };
    for (int k = 0; k < 3; ++k) {
        bind(std::string(1, static_cast<char>('x' + k)), cloud.mean, k);
        bind("f_dc_" + std::to_string(k), cloud.sh_constant, k);
        if (k < 2 || !flat) bind("scale_" + std::to_string(k), cloud.log_scale, k);
    }
    for (int k = 0; k < 4; ++k) bind("rot_" + std::to_string(k), cloud.rotation, k);
    bind("opacity", cloud.logit_opacity, 0);
    for (Index k = 0; k < cloud.sh_rest.rows(); ++k)
        bind("f_rest_" + std::to_string(k), cloud.sh_rest, k);
    return targets;
}

template <class U>
U little_endian(const char* at) {
    std::array<char, sizeof(U)> bytes;
    std::memcpy(bytes.data(), at, sizeof(U));
    if constexpr (std::endian::native == std::endian::big) std::reverse(bytes.begin(), bytes.end());
    return rye::bit_cast<U>(bytes);
}

template <class T>
T ply_number(const char* at, PlyType type) {
    switch (type) {
    case PlyType::i8: return static_cast<T>(little_endian<std::int8_t>(at));
    case PlyType::u8: return static_cast<T>(little_endian<std::uint8_t>(at));
    case PlyType::i16: return static_cast<T>(little_endian<std::int16_t>(at));
    case PlyType::u16: return static_cast<T>(little_endian<std::uint16_t>(at));
    case PlyType::i32: return static_cast<T>(little_endian<std::int32_t>(at));
    case PlyType::u32: return static_cast<T>(little_endian<std::uint32_t>(at));
    case PlyType::f32: return static_cast<T>(little_endian<float>(at));
    case PlyType::f64: return static_cast<T>(little_endian<double>(at));
    }
    return T(0);
}

/// Returns the bytes left in a stream, or -1 if it cannot seek, such as a pipe.
inline std::int64_t bytes_left(std::istream& in) {
    const auto here = in.tellg();
    if (here == std::istream::pos_type(-1)) {
        in.clear();
        return -1;
    }
    in.seekg(0, std::ios::end);
    const auto end = in.tellg();
    in.seekg(here);
    return static_cast<std::int64_t>(end - here);
}

/// Returns the rest of a stream of unknown length, at most the size that a binary header states.
/// Throws an Error beyond the limit.
inline std::string drained(std::istream& in, const PlyHeader& h, std::uint64_t memory,
                           const std::string& who) {
    const std::uint64_t want =
        h.ascii ? std::numeric_limits<std::uint64_t>::max()
                : saturated_sum(saturated_product(static_cast<std::uint64_t>(h.count),
                                                  static_cast<std::uint64_t>(h.stride)),
                                static_cast<std::uint64_t>(h.skip));
    std::string all;
    std::array<char, 4096> part;
    while (in && all.size() < want) {
        in.read(part.data(), static_cast<std::streamsize>(
                                 std::min<std::uint64_t>(part.size(), want - all.size())));
        all.append(part.data(), static_cast<std::size_t>(in.gcount()));
        require_memory(all.size(), memory, who, "the data of a pipe");
    }
    return all;
}

/// Reads the next word of a stream, whatever its locale; returns false at its end.
inline bool read_word(std::istream& in, std::string& word) {
    constexpr auto eof = std::istream::traits_type::eof();
    auto& bytes = *in.rdbuf();
    word.clear();
    int c = bytes.sbumpc();
    while (c != eof && ply_space(c)) c = bytes.sbumpc();
    for (; c != eof && !ply_space(c); c = bytes.sbumpc()) word.push_back(static_cast<char>(c));
    return !word.empty();
}

/// Reads the data after the header from a stream with `left` bytes left; the cloud takes at most
/// `memory` bytes.
template <Real T>
GaussianCloud<T> read_ply_body(std::istream& in, const PlyHeader& h, std::int64_t left,
                               std::uint64_t memory, const std::string& who) {
    int rest = 0;
    while (h.find("f_rest_" + std::to_string(rest)) >= 0) ++rest;
    require(rest == 0 || rest == 9 || rest == 24 || rest == 45 || rest == 72, who, "got ", rest,
            " f_rest properties, expected 0, 9, 24, 45 or 72");

    // The header is not trusted: memory is allocated after the file is known to hold that much. An
    // ascii number takes at least two bytes, the last one a byte, and a skipped line one.
    const std::int64_t stride =
        h.ascii ? 2 * static_cast<std::int64_t>(h.properties.size()) : h.stride;
    const std::int64_t skip = h.ascii ? h.skip_lines : h.skip;
    require(stride > 0 && skip <= left && h.count <= (left - skip + 1) / stride, who, left,
            " bytes of data are too few for ", h.count, " vertices and the elements before them");

    const bool flat = h.find("scale_2") < 0;
    const int degree = sh_degree(rest / 3 + 1);
    GaussianCloud<T> cloud(0, degree);   // allocated after all properties are found
    const auto targets = ply_targets(h, cloud, flat, who);
    require_memory(GaussianCloud<T>::memory(h.count, degree), memory, who, "its Gaussians");
    cloud = GaussianCloud<T>(h.count, degree);
    if (flat && h.count > 0) cloud.log_scale.row(2).setConstant(static_cast<T>(flat_log_scale));
    const auto finite = [&](T x, std::size_t property, Index vertex) {
        if (std::isinf(x) && targets[property].array == &cloud.logit_opacity)
            return bounded_logit(x > T(0) ? T(1) : T(0));
        if (!std::isfinite(x))
            throw Error(who + ": property " + h.properties[property].name + " of vertex " +
                        std::to_string(vertex) + " is " + number_text(x) + ", not finite");
        return x;
    };
    const auto missing = [&](Index i) {
        return Error(who + ": got " + std::to_string(i) + " whole vertices, expected " +
                     std::to_string(h.count));
    };
    if (h.ascii) {
        std::string word;
        for (Index i = 0; i < h.skip_lines && in; ++i) std::getline(in, word);
        for (Index i = 0; i < h.count; ++i)
            for (std::size_t p = 0; p < targets.size(); ++p) {
                if (!read_word(in, word)) throw missing(i);
                const auto x = parse_double(std::string_view(word).substr(word[0] == '+' ? 1 : 0));
                require(x.has_value(), who, "property ", h.properties[p].name, " of vertex ", i,
                        " is \"", word, "\", not a number");
                if (targets[p].array != nullptr)
                    (*targets[p].array)(targets[p].row, i) = finite(static_cast<T>(*x), p, i);
            }
        return cloud;
    }
    in.ignore(h.skip);
    std::vector<char> record(static_cast<std::size_t>(h.stride));
    std::uint32_t crc = h.crc;
    for (Index i = 0; i < h.count; ++i) {
        if (!in.read(record.data(), h.stride)) throw missing(i);
        if (!h.checksum.empty()) crc = crc32(std::as_bytes(std::span<const char>(record)), crc);
        for (std::size_t p = 0; p < targets.size(); ++p)
            if (targets[p].array != nullptr)
                (*targets[p].array)(targets[p].row, i) =
                    finite(ply_number<T>(record.data() + h.properties[p].offset,
                                         h.properties[p].type),
                           p, i);
    }
    require(
        h.checksum.empty() || h.checksum == checksum_text(crc), who, "the header's checksum: got '",
        h.checksum, "', expected '", [&] { return checksum_text(crc); },
        "': the file is damaged, or a program that changed it kept the line");
    return cloud;
}

} // namespace detail

/// Reads a cloud; messages begin with `name`. Buffers streams that cannot seek, such as a pipe.
/// Throws an Error for a malformed header, for missing, invalid or non-finite numbers, and for a
/// cloud, with the buffer of a pipe, of more bytes than `memory`.
template <Real T>
GaussianCloud<T> read_ply(std::istream& in, const std::string& name,
                          std::uint64_t memory = default_memory) {
    const std::string who = "read_ply: " + name;
    const detail::PlyHeader h = detail::read_ply_header(in, who);
    const std::int64_t left = detail::bytes_left(in);
    if (left >= 0) return detail::read_ply_body<T>(in, h, left, memory, who);
    std::istringstream held(detail::drained(in, h, memory, who));
    const std::int64_t size = detail::bytes_left(held);
    return detail::read_ply_body<T>(held, h, size, memory - static_cast<std::uint64_t>(size), who);
}

/// Reads a cloud from a file.
template <Real T>
GaussianCloud<T> read_ply(const std::string& path, std::uint64_t memory = default_memory) {
    std::ifstream in(path, std::ios::binary);
    require(in.good() && !std::filesystem::is_directory(path), "read_ply", path,
            " cannot be opened as a file");
    return read_ply<T>(in, path, memory);
}

/// Writes a cloud as floats, without the stream's formatting. Atomic replacement of a file is the
/// caller's task.
template <Real T>
void write_ply(std::ostream& out, const GaussianCloud<T>& cloud, const PlyOptions& options = {}) {
    const int own = cloud.degree(), degree = options.degree < 0 ? own : options.degree;
    require(degree >= own && degree <= 4, "write_ply", "got degree ", degree,
            ", expected from the cloud's, ", own, ", to 4");
    require(options.comment.find('\n') == std::string::npos, "write_ply", "the comment \"",
            options.comment, "\" has several lines");
    const int kept = sh_count(own) - 1, padded = sh_count(degree) - 1;
    std::string header = "ply\nformat binary_little_endian 1.0\n";
    if (!options.comment.empty()) header += "comment " + options.comment + "\n";
    header += detail::ply_checksum_line;
    const std::size_t digits = header.size();
    header += std::string(detail::checksum_digits, '0') + "\n";
    header += "element vertex " + number_text(cloud.count()) + "\n";
    const auto name = [&](const std::string& n) { header += "property float " + n + "\n"; };
    const auto names = [&](const std::string& stem, int count) {
        for (int k = 0; k < count; ++k) name(stem + number_text(k));
    };
    for (const char* n : {"x", "y", "z", "nx", "ny", "nz"}) name(n);
    names("f_dc_", 3);
    names("f_rest_", 3 * padded);
    name("opacity");
    names("scale_", 3);
    names("rot_", 4);
    header += "end_header\n";

    std::vector<char> record;
    const auto put = [&](float x) {
        std::array<char, 4> bytes = rye::bit_cast<std::array<char, 4>>(x);
        if constexpr (std::endian::native == std::endian::big)
            std::reverse(bytes.begin(), bytes.end());
        record.insert(record.end(), bytes.begin(), bytes.end());
    };
    const auto record_of = [&](Index i) {
        record.clear();
        const auto put_all = [&](const Columns<T>& a) {
            for (Index k = 0; k < a.rows(); ++k) put(static_cast<float>(a(k, i)));
        };
        put_all(cloud.mean);
        for (int k = 0; k < 3; ++k) put(0.0F);
        put_all(cloud.sh_constant);
        for (int c = 0; c < 3; ++c)
            for (int k = 0; k < padded; ++k)
                put(k < kept ? static_cast<float>(cloud.sh_rest(c * kept + k, i)) : 0.0F);
        put_all(cloud.logit_opacity);
        put_all(cloud.log_scale);
        put_all(cloud.rotation);
        return std::span<const char>(record);
    };
    std::uint32_t crc = crc32(std::as_bytes(std::span<const char>(header)));
    for (Index i = 0; i < cloud.count(); ++i) crc = crc32(std::as_bytes(record_of(i)), crc);
    header.replace(digits, detail::checksum_digits, checksum_text(crc));
    out.write(header.data(), static_cast<std::streamsize>(header.size()));
    for (Index i = 0; i < cloud.count(); ++i) {
        const std::span<const char> bytes = record_of(i);
        out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    }
    out.flush();
    require(out.good(), "write_ply", "writing to the stream failed");
}

} // namespace rye
