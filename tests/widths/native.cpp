// SPDX-License-Identifier: Apache-2.0
// The laws of splatting for the instruction set of this machine, and for the narrower ones that it
// has: a processor with AVX-512 runs vectors of 4, 8 and 16 floats.
#include <algorithm>
#include <cstdio>

#include "../support/backends.hpp"
#include "../support/splat_laws.hpp"

namespace rye::test {

RYE_SPLAT_LAWS(ProcessorBackends);

TEST_CASE("widths: vectors as wide as the processor has them") {
    std::size_t widest = 0;
    const auto name = [&]<class B>(B) {
        using Arch = typename B::arch;
        constexpr std::size_t lanes = B::template batch<float>::size;
        std::printf("the processor's own vectors of %zu floats: %s\n", lanes, Arch::name());
        widest = std::max(widest, lanes);
    };
    std::apply([&](auto... backend) { (name(backend), ...); }, ProcessorBackends());
#if defined(__AVX512F__)
    CHECK(widest == 16);
#else
    std::printf("not run: the processor's own vectors of 16 floats, for this build has no AVX-512; "
                "test_widths runs vectors of plain arrays\n");
#if defined(__AVX__)
    CHECK(widest == 8);
#else
    CHECK(widest == 4);
#endif
#endif
}

} // namespace rye::test
