// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/npz.cpp: any bytes as an npz file, and as a size and a stream of deflate.
#include "fuzz.hpp"

#include <rye/io/npz.hpp>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    const ByteSpan bytes = fuzz::bytes_of(data, size);
    fuzz::attempt([&] {
        std::uint64_t held = 0;
        for (const auto& [key, array] : parse_npz(bytes, fuzz::name)) held += array.bytes.size();
        fuzz::demand(held <= max_deflate_ratio * size, "no more than the file can hold");
    });
    if (size < 4) return 0;
    const auto length = read_at<std::uint32_t>(bytes, 0, fuzz::name, "a size");
    fuzz::attempt([&] {
        const Bytes out = inflate(bytes.subspan(4), length, fuzz::name);
        fuzz::demand(out.size() == length, "as many bytes as declared");
    });
    return 0;
}
