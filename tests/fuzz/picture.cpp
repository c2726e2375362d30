// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/picture.cpp: any bytes as a PNG or JPEG, for the program and for the headers. Corrects the checksums of a PNG's chunks
/// first, so that changed chunks are decoded and not only rejected.
#include "fuzz.hpp"

#include <rye/io/inflate.hpp>
#include <rye/io/png.hpp>

#include "data/picture.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    Bytes bytes(fuzz::bytes_of(data, size).begin(), fuzz::bytes_of(data, size).end());
    const auto big_endian = [&](std::size_t at) {
        return std::uint32_t(data[at]) << 24U | std::uint32_t(data[at + 1]) << 16U |
               std::uint32_t(data[at + 2]) << 8U | data[at + 3];
    };
    for (std::size_t at = 8; size > 8 && data[0] == 0x89 && at + 12 <= size;) {
        const std::size_t length = big_endian(at);
        if (length > size - at - 12) break;
        const std::uint32_t crc = crc32(ByteSpan(bytes).subspan(at + 4, length + 4));
        for (std::size_t i = 0; i < 4; ++i)
            bytes[at + 8 + length + i] = static_cast<std::byte>(crc >> (24 - 8 * i));
        at += 12 + length;
    }
    fuzz::attempt([&] { trainer::decode_image(bytes, fuzz::name, 3); });
    fuzz::attempt([&] { parse_png(bytes, fuzz::name); });
    return 0;
}
