// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/gltf.cpp: any bytes as a .gltf or GLB file, whose other files hold zeros.
#include "fuzz.hpp"

#include <rye/io/gltf.hpp>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    const ByteSpan bytes = fuzz::bytes_of(data, size);
    constexpr std::uint64_t memory = 4U << 20U;
    const auto zeros = [](const std::string&, std::uint64_t wanted, const std::string& who) {
        require(wanted < 4096, who, "no such file");
        return Bytes(static_cast<std::size_t>(wanted));
    };
    fuzz::attempt([&] {
        const auto cloud = parse_gltf<float>(bytes, fuzz::name, memory, zeros);
        fuzz::demand(cloud.count() > 0, "a file has Gaussians");
        GaussianCloud<float>::fields(
            [](const std::string&, const Columns<float>& a) {
                fuzz::demand(a.allFinite(), "numbers are finite");
            },
            cloud);
    });
    return 0;
}
