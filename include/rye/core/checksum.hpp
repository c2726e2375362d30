// SPDX-License-Identifier: Apache-2.0
/// rye/core/checksum.hpp: the checksum that files are given, CRC-32 as of zip, gzip and PNG. It
/// finds every change of one bit, every change within 32 bits in a row, and all but one in 2^32 of
/// others. The same on every machine; eight bytes a step, by tables.
/// Source: RFC 1952 (the polynomial); Kounavis and Berry, "A Systematic Approach to Building High
/// Performance, Software-based, CRC Generators", 2005 (slicing by 8).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

namespace rye {

namespace detail {

/// Tables of the CRC-32 of a byte followed by 0 to 7 bytes of 0.
inline constexpr auto crc32_tables = [] {
    std::array<std::array<std::uint32_t, 256>, 8> t{};
    for (std::uint32_t i = 0; i < 256; ++i) {
        std::uint32_t c = i;
        for (int k = 0; k < 8; ++k) c = (c >> 1U) ^ ((c & 1U) ? 0xEDB88320U : 0U);
        t[0][i] = c;
    }
    for (std::size_t k = 1; k < 8; ++k)
        for (std::size_t i = 0; i < 256; ++i)
            t[k][i] = (t[k - 1][i] >> 8U) ^ t[0][t[k - 1][i] & 255U];
    return t;
}();

} // namespace detail

/// Returns the CRC-32 of bytes that follow others, whose CRC-32 is `before`.
inline std::uint32_t crc32(std::span<const std::byte> bytes, std::uint32_t before = 0) {
    const auto& t = detail::crc32_tables;
    std::uint32_t crc = ~before;
    const auto at = [&](std::size_t i) { return std::to_integer<std::uint32_t>(bytes[i]); };
    std::size_t i = 0;
    for (; bytes.size() - i >= 8; i += 8) {
        crc ^= at(i) | at(i + 1) << 8U | at(i + 2) << 16U | at(i + 3) << 24U;
        crc = t[7][crc & 255U] ^ t[6][crc >> 8U & 255U] ^ t[5][crc >> 16U & 255U] ^
              t[4][crc >> 24U] ^ t[3][at(i + 4)] ^ t[2][at(i + 5)] ^ t[1][at(i + 6)] ^
              t[0][at(i + 7)];
    }
    for (; i < bytes.size(); ++i) crc = t[0][(crc ^ at(i)) & 255U] ^ (crc >> 8U);
    return ~crc;
}

namespace detail {

/// Number of digits of a checksum in a file.
inline constexpr std::size_t checksum_digits = 8;

} // namespace detail

/// Returns a checksum as files state it: 8 lower-case hexadecimal digits.
inline std::string checksum_text(std::uint32_t crc) {
    std::string text(detail::checksum_digits, '0');
    for (std::size_t k = text.size(); k-- > 0; crc >>= 4U) text[k] = "0123456789abcdef"[crc & 15U];
    return text;
}

} // namespace rye
