// SPDX-License-Identifier: Apache-2.0
/// rye/io/spz4.hpp: the SPZ file of version 4: a header of 32 bytes, records of extensions, a
/// table with the compressed and the uncompressed size of each array, and each array as a zstd
/// frame. Arrays without bytes have none. Numbers are as in spz_arrays.hpp.
/// Source: the SPZ library and its format description (Niantic, 2026).
#pragma once

#include <rye/io/spz_arrays.hpp>
#include <rye/io/zstd.hpp>
#include <rye/core/memory.hpp>

namespace rye {

namespace detail {

inline constexpr std::size_t spz4_header_size = 32, spz4_table_row = 16;

/// Returns the frames of a file of version 4, in the order of its arrays; empty for arrays without
/// bytes. Throws an Error unless table and frames fill the file behind the table's offset, and the
/// sizes are those of the header's Gaussians.
inline SpzArrays spz4_frames(ByteSpan file, const SpzHeader& h, const std::string& who) {
    const auto streams = static_cast<int>(read_at<std::uint8_t>(file, 15, who, "the SPZ header"));
    const auto table = read_at<std::uint32_t>(file, 16, who, "the SPZ header");
    const std::array<std::uint64_t, 6> each = spz_sizes(h);
    const int expected = h.count == 0 ? 0 : h.degree == 0 ? 5 : 6;
    require(streams == expected, who, "got ", streams, " streams, expected ", expected, " for ",
            h.count, " Gaussians of degree ", h.degree);
    require(table >= spz4_header_size, who, "the table begins at byte ", table,
            ", expected at least ", spz4_header_size);
    const auto rows = static_cast<std::size_t>(streams) * spz4_table_row;
    ByteSpan rest = file.subspan(table + slice(file, table, rows, who, "the table").size());
    if (h.extended) require_spz_axes(slice(file, 32, table - 32, who, "its extensions"), who);
    SpzArrays frames;
    for (std::size_t k = 0; k < static_cast<std::size_t>(streams); ++k) {
        const std::uint64_t row = table + spz4_table_row * k;
        const auto packed = read_at<std::uint64_t>(file, row, who, "the table");
        const auto size = read_at<std::uint64_t>(file, row + 8, who, "the table");
        require(size == each[k] * h.count, who, spz_array_names[k], " of ", size,
                " bytes, expected ", each[k] * h.count, " for ", h.count, " Gaussians of degree ",
                h.degree);
        frames[k] = slice(rest, 0, packed, who, spz_array_names[k]);
        require_zstd_holds(frames[k].size(), size, who);
        rest = rest.subspan(frames[k].size());
    }
    require(rest.empty(), who, "got ", rest.size(), " bytes after the last stream, expected none");
    return frames;
}

} // namespace detail

/// Returns true if bytes begin as an SPZ file of version 4 or later.
inline bool is_spz4(ByteSpan bytes) {
    return bytes.size() >= 4 && as_text(bytes.first(4)) == "NGSP";
}

/// Returns the header of a file of version 4, of which the first 32 bytes suffice. Throws an Error
/// for another kind of data, another version, and a degree above 4.
inline detail::SpzHeader parse_spz4_header(ByteSpan file, const std::string& who) {
    slice(file, 0, detail::spz4_header_size, who, "the SPZ header");
    const detail::SpzHeader h = detail::spz_common_header(file, who);
    require(h.version == 4, who, "got SPZ version ", h.version, ", expected 4, or 1 to 3 in gzip");
    return h;
}

/// Returns the cloud in the bytes of an SPZ file of version 4; messages begin with `who`. Throws an
/// Error as parse_spz4_header does, for a table that does not fit header and file, what
/// `decompress` throws, and, before they are allocated, for data and Gaussians of more bytes than
/// `memory`. Every number returned is finite.
template <Real T>
GaussianCloud<T> parse_spz4(ByteSpan file, const std::string& who,
                            std::uint64_t memory = default_memory,
                            const ZstdDecompress& decompress = read_stored_zstd) {
    const detail::SpzHeader h = parse_spz4_header(file, who);
    const detail::SpzArrays frames = detail::spz4_frames(file, h, who);
    const std::array<std::uint64_t, 6> each = detail::spz_sizes(h);
    std::uint64_t need = GaussianCloud<T>::memory(static_cast<Index>(h.count), h.degree);
    for (const std::uint64_t size : each) need = detail::saturated_sum(need, size * h.count);
    require_memory(need, memory, who, "its " + std::to_string(h.count) + " Gaussians");
    std::array<Bytes, 6> data;
    detail::SpzArrays arrays;
    for (std::size_t k = 0; k < data.size(); ++k) {
        const auto size = static_cast<std::size_t>(each[k] * h.count);
        if (size == 0) continue;
        const std::string stream = who + ": " + detail::spz_array_names[k];
        data[k] = decompress(frames[k], size, stream);
        require(data[k].size() == size, stream, "got ", data[k].size(), " bytes, expected ", size);
        arrays[k] = data[k];
    }
    return detail::spz_cloud<T>(h, arrays, who);
}

/// Returns the bytes of an SPZ file of version 4, each array by `compress`. Rounds and clamps
/// numbers as spz_bytes does; throws an Error for numbers that are not finite, or means beyond 24
/// bits.
template <Real T>
Bytes spz4_bytes(const GaussianCloud<T>& cloud, const ZstdCompress& compress = stored_zstd,
                 bool antialiased = false) {
    const detail::SpzHeader h = detail::spz_header(cloud, 4, antialiased, "spz4_bytes");
    Bytes table, frames;
    for (const Bytes& array : detail::spz_array_bytes(h, cloud)) {
        if (array.empty()) continue;
        const Bytes frame = compress(array);
        append(table, std::uint64_t{frame.size()});
        append(table, std::uint64_t{array.size()});
        append(frames, ByteSpan(frame));
    }
    const auto streams = static_cast<int>(table.size() / detail::spz4_table_row);
    Bytes out = detail::spz_header_bytes(h, streams);
    append(out, static_cast<std::uint32_t>(detail::spz4_header_size));
    out.resize(detail::spz4_header_size); // 12 reserved bytes
    append(out, ByteSpan(table));
    append(out, ByteSpan(frames));
    return out;
}

} // namespace rye
