// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/splats.cpp: any bytes as a .splat file, as an SPZ file of each version, and as the data
/// inside one, which a search would not find behind gzip's checksum.
#include "fuzz.hpp"

#include <rye/io/splats.hpp>

namespace {

void demand_finite(const rye::GaussianCloud<float>& cloud) {
    using namespace rye;
    GaussianCloud<float>::fields(
        [](const std::string&, const Columns<float>& a) {
            fuzz::demand(a.allFinite(), "numbers are finite");
        },
        cloud);
}

} // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    const ByteSpan bytes = fuzz::bytes_of(data, size);
    fuzz::attempt([&] {
        const auto cloud = parse_splat<float>(bytes, fuzz::name);
        fuzz::demand(static_cast<std::size_t>(cloud.count()) * detail::splat_record == size,
                     "a Gaussian for each record");
        demand_finite(cloud);
    });
    // Four bytes of zstd hold 131072.
    constexpr std::uint64_t memory = 8U << 20U;
    fuzz::attempt([&] {
        demand_finite(is_spz4(bytes) ? parse_spz4<float>(bytes, fuzz::name, memory)
                                     : parse_spz<float>(bytes, fuzz::name));
    });
    fuzz::attempt([&] { demand_finite(parse_spz<float>(gzip_bytes(bytes), fuzz::name)); });
    fuzz::demand(splat_kind(fuzz::name, bytes) != SplatKind::splat, "its name has no extension");
    return 0;
}
