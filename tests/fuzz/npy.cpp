// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/npy.cpp: any bytes as an npy array; a valid one must survive writing and reading.
#include "fuzz.hpp"

#include <rye/io/npy.hpp>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    fuzz::attempt([&] {
        const NpyArray array = parse_npy(fuzz::bytes_of(data, size), fuzz::name);
        const NpyArray again = parse_npy(npy_bytes(array), fuzz::name);
        fuzz::demand(again.bytes == array.bytes && again.shape == array.shape,
                     "an array that is read comes back when it is written");
        fuzz::attempt([&] { array.values<float>(fuzz::name); });
        fuzz::attempt([&] { array.values<double>(fuzz::name); });
        fuzz::attempt([&] { array.values<int>(fuzz::name); });
    });
    return 0;
}
