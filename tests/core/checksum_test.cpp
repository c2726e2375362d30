// SPDX-License-Identifier: Apache-2.0
#include <rye/core/checksum.hpp>

#include <vector>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>

using namespace rye;

namespace {

std::vector<std::byte> random_bytes(std::size_t count) {
    const Random random{3, 0};
    std::vector<std::byte> bytes;
    for (std::size_t i = 0; i < count; ++i)
        bytes.push_back(static_cast<std::byte>(random.below(i, 256)));
    return bytes;
}

/// The definition: a bit at a time.
std::uint32_t slow_crc32(std::span<const std::byte> bytes) {
    std::uint32_t crc = ~0U;
    for (const std::byte b : bytes) {
        crc ^= std::to_integer<std::uint32_t>(b);
        for (int k = 0; k < 8; ++k) crc = (crc >> 1U) ^ ((crc & 1U) ? 0xEDB88320U : 0U);
    }
    return ~crc;
}

} // namespace

TEST_CASE("crc32: as its definition for each length, whole and in parts") {
    const std::vector<std::byte> bytes = random_bytes(64);
    for (std::size_t n = 0; n <= bytes.size(); ++n) {
        const std::span<const std::byte> part(bytes.data(), n);
        CHECK(crc32(part) == slow_crc32(part));
        CHECK(crc32(part.subspan(n / 3), crc32(part.first(n / 3))) == slow_crc32(part));
    }
    CHECK(checksum_text(0x00abCDefU) == "00abcdef");
}

TEST_CASE("crc32: no flip of one bit passes") {
    std::vector<std::byte> bytes = random_bytes(200);
    const std::uint32_t right = crc32(bytes);
    for (std::size_t bit = 0; bit < 8 * bytes.size(); ++bit) {
        const auto flip = static_cast<std::byte>(1U << (bit % 8));
        bytes[bit / 8] ^= flip;
        CHECK(crc32(bytes) != right);
        bytes[bit / 8] ^= flip;
    }
}
