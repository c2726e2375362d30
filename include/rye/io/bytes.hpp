// SPDX-License-Identifier: Apache-2.0
/// rye/io/bytes.hpp: bounds-checked reading of untrusted little-endian bytes.
/// Every count is checked against the bytes left before anything is allocated or read.
#pragma once

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <span>
#include <string>
#include <string_view>
#include <system_error>
#include <type_traits>
#include <vector>

#include <rye/core/config.hpp>
#include <rye/core/error.hpp>

namespace rye {

static_assert(std::endian::native == std::endian::little, "rye's readers assume little-endian");

/// Contents of a file.
using Bytes = std::vector<std::byte>;
/// View of bytes.
using ByteSpan = std::span<const std::byte>;

namespace detail {

/// Returns the size of a regular file [bytes]. Throws an Error for pipes, devices and folders:
/// opening a pipe without a writer would block.
inline std::uint64_t regular_file_size(const std::filesystem::path& path) {
    const std::string who = path.string();
    std::error_code status;
    if (!std::filesystem::exists(path, status)) throw Error(who + ": no such file");
    if (!std::filesystem::is_regular_file(path, status))
        throw Error(who + ": not a file but a folder, pipe or device");
    const std::uintmax_t size = std::filesystem::file_size(path, status);
    if (status) throw Error(who + ": cannot read its size: " + status.message());
    return size;
}

} // namespace detail

/// Returns the first bytes of a file, at most `most`; throws an Error with its path.
inline Bytes read_beginning(const std::filesystem::path& path, std::size_t most) {
    const std::uint64_t size = detail::regular_file_size(path);
    Bytes bytes(static_cast<std::size_t>(std::min<std::uint64_t>(size, most)));
    std::ifstream in(path, std::ios::binary);
    if (!in) throw Error(path.string() + ": cannot be opened for reading");
    in.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    bytes.resize(static_cast<std::size_t>(in.gcount()));
    return bytes;
}

/// Returns the whole file; throws an Error with its path. Rejects files above `max_bytes` without
/// reading them.
inline Bytes read_file(const std::filesystem::path& path, std::uint64_t max_bytes = 1ULL << 34U) {
    const std::string who = path.string();
    const std::uint64_t size = detail::regular_file_size(path);
    require(size <= max_bytes, who, "got ", size, " bytes, expected at most ", max_bytes);
    std::ifstream in(path, std::ios::binary);
    if (!in) throw Error(who + ": cannot be opened for reading");
    Bytes bytes(static_cast<std::size_t>(size));
    in.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(size));
    require(static_cast<std::uint64_t>(in.gcount()) == size, who, "got ", in.gcount(),
            " bytes, expected ", size);
    return bytes;
}

/// Returns the bytes of a text, without a copy.
inline ByteSpan as_bytes(std::string_view text) {
    return {reinterpret_cast<const std::byte*>(text.data()), text.size()};
}
/// Returns bytes as text, without a copy.
inline std::string_view as_text(ByteSpan bytes) {
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

/// Returns bytes[offset, offset + count); throws an Error with `what` if the range exceeds the
/// bytes.
inline ByteSpan slice(ByteSpan bytes, std::uint64_t offset, std::uint64_t count,
                      const std::string& who, const char* what) {
    if (offset > bytes.size() || count > bytes.size() - offset)
        throw Error(who + ": truncated: " + what + " needs bytes " + std::to_string(offset) +
                    " to " + std::to_string(offset) + " + " + std::to_string(count) + " of " +
                    std::to_string(bytes.size()));
    return bytes.subspan(static_cast<std::size_t>(offset), static_cast<std::size_t>(count));
}

/// Returns the little-endian integer at an offset; throws an Error with `what` beyond the end.
template <class T>
    requires std::is_unsigned_v<T>
T read_at(ByteSpan bytes, std::uint64_t offset, const std::string& who, const char* what) {
    T value;
    std::memcpy(&value, slice(bytes, offset, sizeof(T), who, what).data(), sizeof(T));
    return value;
}

/// Appends the bytes of a number.
template <class T>
    requires std::is_trivially_copyable_v<T>
void append(Bytes& bytes, const T& value) {
    const std::size_t end = bytes.size();
    bytes.resize(end + sizeof(T));
    std::memcpy(bytes.data() + end, &value, sizeof(T));
}
/// Appends bytes.
inline void append(Bytes& bytes, ByteSpan more) {
    bytes.insert(bytes.end(), more.begin(), more.end());
}

/// Returns a * b; throws an Error if the product does not fit 64 bits.
inline std::uint64_t checked_product(std::uint64_t a, std::uint64_t b, const std::string& who) {
    std::uint64_t product = 0;
    if (__builtin_mul_overflow(a, b, &product))
        throw Error(who + ": " + std::to_string(a) + " * " + std::to_string(b) + " overflows");
    return product;
}

/// Returns the size [bytes] of an array of these extents. The product of all extents other than 0
/// must fit an Index, so that extents can be multiplied in any order, with or without those of 0.
template <class Extents>
std::uint64_t checked_size(const Extents& extents, std::uint64_t item, const std::string& who) {
    std::uint64_t size = item;
    bool empty = false;
    for (const auto extent : extents) {
        empty = empty || extent == 0;
        if (extent != 0) size = checked_product(size, static_cast<std::uint64_t>(extent), who);
    }
    require(size <= static_cast<std::uint64_t>(std::numeric_limits<Index>::max()), who,
            "the product of its extents overflows: an array of ", size, " bytes, expected at most ",
            std::numeric_limits<Index>::max());
    return empty ? 0 : size;
}

} // namespace rye
