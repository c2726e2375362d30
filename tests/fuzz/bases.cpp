// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/bases.cpp: any bytes as bases of a splat file; what is accepted can be applied.
#include "fuzz.hpp"

#include <rye/io/splat_bases.hpp>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    fuzz::attempt([&] {
        const SplatBases b = parse_bases(fuzz::unchecked(data, size), fuzz::name);
        detail::check_bases(fuzz::name, b);
        fuzz::demand(4 * b.begin.size() + 30 * b.index.size() <= size,
                     "bases are no larger than their file");
    });
    return 0;
}
