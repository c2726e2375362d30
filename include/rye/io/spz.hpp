// SPDX-License-Identifier: Apache-2.0
/// rye/io/spz.hpp: the SPZ file, of about 20 bytes per Gaussian: reads versions 1 to 4, writes
/// version 3; spz4.hpp writes version 4. Stored axes are x right, y up, z toward the viewer; clouds
/// have those of a PLY, so reading and writing rotate by half a turn about x. The many writers that
/// do not rotate give files that are read upside down.
/// Up to version 3 it is a gzip file of a header of 16 bytes and the arrays of spz_arrays.hpp.
/// Largest differences after writing and reading: position 1/8192 [world units] (more where a cloud
/// reaches beyond 2048 units), opacity 0.5/255, f_dc 0.0131 within +-3.33, log scale 1/32 within
/// -10..5.94, rotation 0.28 degrees, harmonics 1/32 and 1/16 within +-0.9; beyond, clamped.
/// Source: the SPZ library and its format description (Niantic, 2024 to 2026).
#pragma once

#include <rye/io/gzip.hpp>
#include <rye/io/spz4.hpp>
#include <rye/io/spz_arrays.hpp>

namespace rye {

namespace detail {

inline constexpr std::size_t spz_header_size = 16;

} // namespace detail

/// Returns the header of the data inside an SPZ file in gzip, of which the first 16 bytes suffice;
/// `whole` is the size of all data [bytes]. Throws an Error for another kind of data, a version
/// other than 1 to 3, a degree above 4, and arrays of another size than the data's.
inline detail::SpzHeader parse_spz_header(ByteSpan data, std::uint64_t whole,
                                          const std::string& who) {
    const detail::SpzHeader h = detail::spz_common_header(data, who);
    require(h.version >= 1 && h.version <= 3, who, "got SPZ version ", h.version,
            ", expected 1 to 3 in gzip");
    std::uint64_t size = detail::spz_header_size;
    for (const std::uint64_t each : detail::spz_sizes(h)) size += each * h.count;
    require(h.extended ? whole >= size : whole == size, who, "got ", whole,
            " bytes of data, expected ", size, " for ", h.count, " Gaussians of degree ", h.degree);
    return h;
}

/// Returns the header of complete data.
inline detail::SpzHeader parse_spz_header(ByteSpan data, const std::string& who) {
    return parse_spz_header(data, data.size(), who);
}

/// Returns the cloud in the bytes of an SPZ file; messages begin with `who`. Throws an Error as
/// gunzip and parse_spz_header do, and, before they are allocated, for data and Gaussians of more
/// bytes than `memory`; for version 4 as parse_spz4 does. Every number returned is finite.
template <Real T>
GaussianCloud<T> parse_spz(ByteSpan file, const std::string& who,
                           std::uint64_t memory = default_memory,
                           const ZstdDecompress& decompress = read_stored_zstd) {
    if (is_spz4(file)) return parse_spz4<T>(file, who, memory, decompress);
    const detail::GzipContents contents = detail::gzip_contents(file, who);
    const Bytes beginning = detail::inflate_beginning(
        contents.deflated, std::min<std::size_t>(contents.size, detail::spz_header_size), who);
    const detail::SpzHeader h = parse_spz_header(beginning, contents.size, who);
    detail::require_inflatable(contents.deflated, contents.size, who);
    const std::uint64_t gaussians = GaussianCloud<T>::memory(static_cast<Index>(h.count), h.degree);
    require_memory(detail::saturated_sum(contents.size, gaussians), memory, who,
                   "its " + std::to_string(h.count) + " Gaussians");
    const Bytes data = gunzip(contents, who, memory);
    ByteSpan rest = ByteSpan(data).subspan(detail::spz_header_size);
    detail::SpzArrays arrays;
    for (std::size_t k = 0; k < arrays.size(); ++k) {
        arrays[k] =
            slice(rest, 0, detail::spz_sizes(h)[k] * h.count, who, detail::spz_array_names[k]);
        rest = rest.subspan(arrays[k].size());
    }
    if (h.extended) detail::require_spz_axes(rest, who);
    return detail::spz_cloud<T>(h, arrays, who);
}

/// Returns the bytes of an SPZ file of version 3. Rounds and clamps numbers as stated above. Throws
/// an Error for a cloud of degree 4, numbers that are not finite, or means beyond 24 bits.
template <Real T>
Bytes spz_bytes(const GaussianCloud<T>& cloud, const Deflate& deflate = stored_deflate,
                bool antialiased = false) {
    const std::string who = "spz_bytes";
    require(cloud.degree() <= 3, who, "got harmonics of degree ", cloud.degree(),
            ", expected at most 3: see truncated()");
    const detail::SpzHeader h = detail::spz_header(cloud, 3, antialiased, who);
    Bytes data = detail::spz_header_bytes(h, 0);
    for (const Bytes& array : detail::spz_array_bytes(h, cloud)) append(data, ByteSpan(array));
    return gzip_bytes(data, deflate);
}

} // namespace rye
